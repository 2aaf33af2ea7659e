"""What all experiments share."""

from __future__ import annotations

import math

import pytest

from abfm.errors import MeshError
from abfm.experiments.experiment import Measure, affordable_iterations
from tests.shapes import icosphere


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_cannot_be_measured_is_said(value: float) -> None:
    with pytest.raises(MeshError, match=f"'length, m' came out as {value}"):
        Measure("length, m", value)


def test_fine_meshes_have_fewer_iterations_within_limits() -> None:
    counts = [affordable_iterations(icosphere(level), 300) for level in (2, 5, 6)]
    assert counts[0] == 300
    assert 60 < counts[1] < 300
    assert counts[2] == 60
