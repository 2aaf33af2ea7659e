"""Frames in between of known waves: fields that carry them, and the errors of the table."""

import numpy as np
import pytest

from abfm.flow.continuous_flow import ContinuousFlow
from laboratory import in_between
from tests.shapes import icosphere


@pytest.mark.parametrize("kind", in_between.KINDS[:3])
def test_waves_are_carried_by_their_fields(kind):
    mesh = icosphere(3)
    frames, field = in_between.wave(mesh, kind, 1.0)
    flow = ContinuousFlow(mesh, field, 1.0)
    carried = flow.origins().pull_back(frames[0])
    assert np.std(carried - frames[2]) < 0.1 * np.std(frames[0] - frames[2])


def test_the_table_has_the_errors(monkeypatch):
    monkeypatch.setattr(in_between, "KINDS", ("rotating",))
    monkeypatch.setattr(in_between, "DISPLACEMENTS", (1.0,))
    monkeypatch.setattr(in_between, "NOISES", (0.0,))
    [row] = in_between.rows(icosphere(2))
    assert len(row) == len(in_between.HEADS)
    blend, motion, own = map(float, row[3:6])
    assert own <= motion + 1e-9 < blend
