from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from abfm_viewer.document.document import Identity, Point
from abfm_viewer.files.documents import document_of_sequence
from abfm_viewer.session.saving.exporter import Exporter
from tests.core.sequences.rotating_sphere import solved


@pytest.fixture
def sequence_session(session):
    """Return a session with a sequence whose fields are not saved."""
    found = document_of_sequence(solved(), Path("sequence.npz"))
    session.restore(replace(found, result=None), {}, None)
    session.reset_history()
    session.editor.change("match all frames", result=found.result)
    assert session.saves.changes(session.document) == ("result",)
    return session


def export(sequence_session, path):
    reports = []
    exporter = Exporter(lambda text, failed: reports.append((text, failed)))
    document, saves = sequence_session.document, sequence_session.saves
    exporter.save_result(path, document.result, partial(saves.record_export, document))
    exporter.wait()
    assert reports == [(f"saved {path}", False)]


def test_exported_sequence_file_counts_as_saved(sequence_session, tmp_path):
    export(sequence_session, tmp_path / "sequence-lh.stc")
    assert sequence_session.saves.unsaved
    export(sequence_session, tmp_path / "sequence.npz")
    assert not sequence_session.saves.unsaved
    assert sequence_session.saves.unsaved_documents == ()
    sequence_session.restore(replace(sequence_session.document, identity=Identity()), {}, None)
    assert sequence_session.saves.unsaved_documents == ()


def test_parts_missing_in_a_sequence_file_are_unsaved(sequence_session, tmp_path):
    export(sequence_session, tmp_path / "sequence.npz")
    sequence_session.editor.set_sequence_settings(gamma=3.0)
    assert sequence_session.saves.changes(sequence_session.document) == ("settings",)
    # the file has the settings of the fields, not the changed ones
    sequence_session.saves.record_export(sequence_session.document)
    assert sequence_session.saves.changes(sequence_session.document) == ("settings",)
    sequence_session.undo()
    sequence_session.editor.change("place a point", lines=(Point(0, (1.0, 0.0, 0.0)),))
    assert sequence_session.saves.changes(sequence_session.document) == ("lines",)


def test_recovered_sequence_is_saved_by_an_export(sequence_session, tmp_path):
    document = replace(sequence_session.document, identity=Identity())
    sequence_session.restore(document, {}, None, saved=False)
    assert sequence_session.saves.unsaved
    export(sequence_session, tmp_path / "sequence.npz")
    assert not sequence_session.saves.unsaved
