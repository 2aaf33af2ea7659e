"""Fields that the flow's field gives rise to: what commutes with it, and what it carries along."""

from __future__ import annotations

import numpy as np

from abfm import AbfmError
from abfm.types import FloatArray
from abfm_viewer.shown.carried import FlowState

_LARGEST = 15_000  # vertices: twenty seconds, and a gigabyte


def commuting(flow: FlowState, segment: int) -> tuple[FloatArray, float]:
    """The smoothest field (F, 3) that commutes with one of the flow's, and the bracket relative to both.

    Raises
    ------
    AbfmError
        During a run, on a large mesh, or if the field is zero.
    """
    from abfm.calculus.commuting_fields import (  # not before: the first frame does without
        commuting_fields,
        relative_bracket,
    )

    if not flow.final:
        raise AbfmError("the field that commutes is computed when the run has ended")
    count = len(flow.mesh.vertices)
    if count > _LARGEST:
        raise AbfmError(f"commuting fields are computed on up to {_LARGEST:,} vertices; this mesh has {count:,}")
    velocity = flow.velocity[segment]
    if not velocity.any():
        raise AbfmError("the field is zero, with which every field commutes")
    found = commuting_fields(flow.mesh, velocity)[0]
    return found, relative_bracket(flow.mesh, velocity, found)


def carried_gradient(flow: FlowState, function: FloatArray, time: float) -> FloatArray:
    """The gradient of a function (V,), carried along the flow's fields one after the other to a time, (F, 3).

    Raises
    ------
    AbfmError
        If the flow is too long, or the carried field overflows.
    """
    from abfm.calculus.operators import gradient
    from abfm.calculus.vector_fields import pushforward, to_ambient

    field = to_ambient(flow.mesh, (gradient(flow.mesh) @ function).reshape(-1, 2))
    ends = np.linspace(0, flow.parameters.tau, len(flow.velocity) + 1)
    ends[-1] = max(ends[-1], time)  # beyond tau the last field goes on
    for velocity, start, end in zip(flow.velocity, ends, ends[1:], strict=False):
        if time > start:
            field = pushforward(flow.mesh, velocity, field, min(end, time) - start)
    return field
