"""What a script waits for, matched by a batch: the same findings, bit for bit."""

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
def waiting():
    """A script with several stages, and what it waits for."""
    whole = script(1, FigureSetup(MESH, small=True))
    return whole, requested_matches(whole)


def test_findings_do_not_tell_whether_a_match_was_read(waiting, tmp_path):
    whole, requested = waiting
    rows = rows_of(1, requested, tmp_path)
    entries = batch.run(rows, tmp_path, Cluster(jobs=1))
    assert entries[0].digest == requested[0].problem.digest
    matches = matches_of(requested, entries)
    assert matches[0].problem is requested[0].problem
    found = values(findings_of(whole, matches))
    assert sum(name.startswith("drift of the mass at tau") for name in found) == 2
    assert found == values(findings_of(script(1, FigureSetup(MESH, small=True))))


def test_what_was_not_matched_is_told(waiting, tmp_path):
    _, requested = waiting
    rows, ledger = rows_of(1, requested, tmp_path), batch.Ledger(tmp_path)
    ledger.make()
    with raises(AbfmError):
        matches_of(requested, ledger.entries(rows))
    lost = ledger.record(rows[0], Record(reason="no memory"))
    with raises(AbfmError):
        matches_of(requested, [lost])
