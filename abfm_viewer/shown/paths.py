"""Flow lines and the ways of points, from where the user clicked."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abfm.types import FloatArray, IntArray
from abfm_viewer.document.document import EXTRAPOLATION, Point
from abfm_viewer.shown.carried import FlowState
from abfm_viewer.shown.field_parts import Field

if TYPE_CHECKING:
    from abfm.flow.flow_lines import FlowLine


class _Starts(NamedTuple):
    faces: IntArray
    barycentric: FloatArray


def _starts(points: tuple[Point, ...]) -> _Starts:
    return _Starts(np.array([p.face for p in points]), np.array([p.barycentric for p in points]))


def lines_through(field: Field, points: tuple[Point, ...], tau: float) -> list[FlowLine]:
    """Flow lines of one field: against it for tau, and with it for tau."""
    from abfm.flow.flow_lines import flow_lines  # not before: it loads what the first frame does without

    starts = _starts(points)
    return [line for time in (-tau, tau) for line in flow_lines(field.mesh, field.velocity, starts, time)]


def paths_from(flow: FlowState, points: tuple[Point, ...]) -> list[FlowLine]:
    """The ways of points along the flow, to the end of the time bar."""
    from abfm.flow.flow_lines import flow_lines

    tau = flow.parameters.tau
    return flow_lines(flow.mesh, flow.velocity, _starts(points), EXTRAPOLATION * tau, tau)
