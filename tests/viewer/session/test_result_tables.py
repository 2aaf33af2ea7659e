from dataclasses import replace
from pathlib import Path

import numpy as np

from abfm.batch import Ledger, Row
from abfm.outcome import Facts, Outcome
from abfm.population import Channel as PopulationChannel
from abfm_viewer.document.document import Channel, Surface
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.document.result_table import PopulationTable, ResultRow, ResultTable, as_text
from abfm_viewer.files.documents import document_of_sequence
from abfm_viewer.files.result_tables import _texts
from abfm_viewer.session.result_tables import document_of_subject
from tests.core.sequences.rotating_sphere import solved
from tests.shapes import icosphere

_MATCHED = Facts(Outcome.MATCHED, "matched")


def test_sequence_has_the_name_of_its_row():
    path = Path("85b823f4.npz")
    row = ResultRow(0, "f1", _MATCHED, path)
    document = row.label_document(document_of_sequence(solved(), path))
    assert document.name == "f1"
    assert not document.is_outdated


def test_functions_of_a_row_have_the_names_of_the_table(tmp_path):
    given = {"a": "a.off", "b": "b.off", "source": "curvature:mean", "target": "file:b.npy"}
    texts = _texts(Ledger(tmp_path).entry(Row("r", given)))
    assert texts == (("curvature:mean", "file:b.npy"),)
    assert _texts(Ledger(tmp_path).entry(Row("f", {"mesh": "a.off", "frames": "f.npy"}))) == ()
    row = ResultRow(0, "r", _MATCHED, Path("e11a.npz"), texts)
    opened = MatchDocument((Surface(icosphere(1), "e11a.npz"),), (Channel("one", "two"),))
    names = {"one": "curvature:mean", "two": "file:b.npy"}
    assert row.label_document(opened).display_names == names
    two = replace(row, texts=(*texts, *texts))  # a row with another number of channels
    assert two.label_document(opened).display_names == {}


def test_search_finds_a_phrase_or_all_words():
    reason = "the residual fell from 1.2 to 0.01 (0.021 by flow lines)"
    facts = replace(_MATCHED, reason=reason)
    names = [f"alpha {a}, sigma {s}" for a in (0.01, 0.1) for s in (0.02, 0.1)]
    rows = tuple(ResultRow(i, name, facts) for i, name in enumerate(names))
    table = ResultTable(Path("out"), "sweep", rows)

    def found(search):
        return sorted(row.number for row in table.shown("verdict", False, search))

    assert found("") == found("  ") == [0, 1, 2, 3]
    # rows that have 0.021 in their reason do not match
    assert found("sigma 0.02") == found(" Sigma  0.02 ") == [0, 2]
    assert found("alpha 0.1, sigma 0.1") == [3]
    assert found("0.02 alpha") == found("matched sigma") == [0, 1, 2, 3]
    assert found("sigma 0.3") == []


class _Population:
    def __init__(self):
        self.template = icosphere(1)
        count = len(self.template.vertices)
        self.channels = tuple(map(PopulationChannel, ("sulc", "curv", "thick")))
        self.values = np.random.default_rng(0).normal(size=(2, count, 3))
        self.masks, self.template_mask = np.ones((2, count)), np.ones(count)
        self.channel_weights = np.ones(3)

    def mean_of_others(self, subject, channel):
        return self.values[1 - subject, :, channel]


def test_channels_of_a_subject_have_their_names():
    table = PopulationTable(Path("pop"), "population pop", (), _Population())
    row = ResultRow(0, "sub-0", Facts(Outcome.REGISTERED, "registered"))
    document, _ = document_of_subject(table, row, "difference")
    names = [[document.display_names[spec] for spec in each.specs] for each in document.channels]
    assert names == [[name, name] for name in ("sulc", "curv", "thick")]


def test_copied_rows_are_cells_separated_by_tabs():
    rows = [
        ResultRow(
            0, "a\tname", replace(_MATCHED, reason="two\nlines", numbers={"residual": 0.0123})
        ),
        ResultRow(1, "b", _MATCHED),
    ]
    copied = as_text(("name", "residual", "reason"), rows)
    assert copied == "name\tresidual\treason\na name\t1.23%\ttwo lines\nb\t\t"
