"""Flow lines and the ways of points, from where the user clicked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import abfm
from abfm.types import FloatArray, IntArray
from abfm_viewer.document.document import EXTRAPOLATION, Point
from abfm_viewer.shown.carried import FlowState
from abfm_viewer.shown.field_parts import Field


class _Starts(NamedTuple):
    faces: IntArray
    barycentric: FloatArray


def _starts(points: tuple[Point, ...]) -> _Starts:
    return _Starts(np.array([p.face for p in points]), np.array([p.barycentric for p in points]))


def lines_through(field: Field, points: tuple[Point, ...], tau: float) -> list[abfm.flow.FlowLine]:
    """Flow lines of one field: against it for tau, and with it for tau."""
    starts = _starts(points)
    return [line for time in (-tau, tau) for line in abfm.flow.flow_lines(field.mesh, field.velocity, starts, time)]


def paths_from(flow: FlowState, points: tuple[Point, ...]) -> list[abfm.flow.FlowLine]:
    """The ways of points along the flow, to the end of the time bar."""
    tau = flow.parameters.tau
    return abfm.flow.flow_lines(flow.mesh, flow.velocity, _starts(points), EXTRAPOLATION * tau, tau)
