import pytest

from abfm import AbfmError, batch
from abfm.batch import Cluster
from abfm.batch.ledger import Record
from abfm.experiments import (
    FigureSetup,
    findings_of,
    matches_of,
    requested_matches,
    rows_of,
    script,
)
from tests.core.experiments.small import values
from tests.messages import raises
from tests.shapes import torus

MESH = torus(16, 8)


@pytest.fixture
def requesting():
    """Return a script with several stages, and its requested matches."""
    figure_script = script(1, FigureSetup(MESH, small=True))
    return figure_script, requested_matches(figure_script)


def test_findings_of_loaded_matches_are_equal(requesting, tmp_path):
    figure_script, requested = requesting
    rows = rows_of(1, requested, tmp_path)
    entries = batch.run(rows, tmp_path, Cluster(jobs=1))
    assert entries[0].digest == requested[0].problem.digest
    matches = matches_of(requested, entries)
    assert matches[0].problem is requested[0].problem
    found = values(findings_of(figure_script, matches))
    assert sum(name.startswith("drift of the mass at tau") for name in found) == 2
    assert found == values(findings_of(script(1, FigureSetup(MESH, small=True))))


def test_missing_match_is_reported(requesting, tmp_path):
    _, requested = requesting
    rows, ledger = rows_of(1, requested, tmp_path), batch.Ledger(tmp_path)
    ledger.make()
    with raises(AbfmError):
        matches_of(requested, ledger.entries(rows))
    lost = ledger.record(rows[0], Record(reason="no memory"))
    with raises(AbfmError):
        matches_of(requested, [lost])
