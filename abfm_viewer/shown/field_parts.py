"""Parts of the flow's field that can be drawn, coloured and traced, and related fields."""

from dataclasses import dataclass, field

import numpy as np

import abfm
from abfm import AbfmError
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import HODGE_PARTS, FieldPart
from abfm_viewer.shown.carried import FlowState

# vertices of a mesh whose commuting fields are computed: twenty seconds, and a gigabyte
_LARGEST = 15_000


@dataclass(frozen=True, eq=False)
class Field:
    """One part of one of the flow's fields, or a field that belongs to it.

    `shares` are those of each Helmholtz-Hodge part in the whole field's squared norm, empty unless
    asked for.
    """

    mesh: TriangleMesh
    velocity: FloatArray  # (F, 3), in the input's units
    speed: FloatArray  # (F,)
    shares: dict[FieldPart, float] = field(default_factory=dict)
    unit: str = "the mesh's length per time"  # of the speed
    note: str = ""  # what else is to be said, if anything
    dimension: int = 1  # the power of a length in the unit

    def relative_speed(self) -> tuple[FloatArray, str]:
        """Return the speed (F,) with sqrt(area) as the unit of length, and its unit."""
        unit = self.unit.replace("the mesh's length", "length").replace("length", "sqrt(area)")
        return self.speed * self.mesh.length_scale**-self.dimension, unit


def acting_segment(flow: FlowState, time: float) -> int:
    """Return which of N fields acts at a time."""
    count = flow.parameters.segments
    return min(int(time / flow.parameters.tau * count * (1 - 1e-12)), count - 1)


def field_part(flow: FlowState, segment: int, part: FieldPart) -> Field:
    """A part of one of the flow's fields, or the field that commutes with it (see `commuting`)."""
    velocity, shares, note = flow.velocity[segment], {}, ""
    if part == "commuting":
        velocity, bracket = commuting(flow, segment)
        note = f"norm of the bracket relative to both fields: {bracket:.3g}, 0 if they commute"
    elif part != "whole":
        found = abfm.calculus.helmholtz_hodge(flow.mesh, velocity)
        parts, areas = (
            dict(zip(HODGE_PARTS, found, strict=True)),
            abfm.calculus.face_areas(flow.mesh),
        )
        norms = {name: float(areas @ (v**2).sum(axis=1)) for name, v in parts.items()}
        shares = {name: norm / max(sum(norms.values()), 1e-300) for name, norm in norms.items()}
        velocity = parts[part]
    return Field(flow.mesh, velocity, np.linalg.norm(velocity, axis=1), shares, note=note)


def carried_part(flow: FlowState, function: FloatArray, time: float) -> Field:
    """Carry the gradient of a function (V,) along the flow to a time (see `carried_gradient`)."""
    velocity = carried_gradient(flow, function, time)
    speed = np.linalg.norm(velocity, axis=1)
    return Field(flow.mesh, velocity, speed, unit="the source's unit per length", dimension=-1)


def commuting(flow: FlowState, segment: int) -> tuple[FloatArray, float]:
    """The smoothest field (F, 3) that commutes with one of the flow's, and the bracket relative to
    both.

    During a run, on a large mesh and of a field that is zero an `AbfmError` says why there is none.
    """
    if not flow.final:
        raise AbfmError("the field that commutes is computed when the run has ended")
    count = len(flow.mesh.vertices)
    if count > _LARGEST:
        raise AbfmError(
            f"commuting fields are computed on up to {_LARGEST:,} vertices; this mesh has {count:,}"
        )
    velocity = flow.velocity[segment]
    if not velocity.any():
        raise AbfmError("the field is zero, with which every field commutes")
    found = abfm.calculus.commuting_fields(flow.mesh, velocity)[0]
    return found, abfm.calculus.relative_bracket(flow.mesh, velocity, found)


def carried_gradient(flow: FlowState, function: FloatArray, time: float) -> FloatArray:
    """The gradient of a function (V,), carried along the flow's fields one after the other to a
    time, (F, 3).

    A flow that is too long and a field that overflows are an `AbfmError`.
    """
    field = abfm.calculus.to_ambient(
        flow.mesh, (abfm.calculus.gradient(flow.mesh) @ function).reshape(-1, 2)
    )
    ends = np.linspace(0, flow.parameters.tau, len(flow.velocity) + 1)
    ends[-1] = max(ends[-1], time)  # beyond tau the last field goes on
    for velocity, start, end in zip(flow.velocity, ends, ends[1:], strict=False):
        if time > start:
            field = abfm.calculus.pushforward(flow.mesh, velocity, field, min(end, time) - start)
    return field


def derivative(field: Field, kind: str) -> FloatArray:
    """Divergence or curl at the vertices, (V,)."""
    calculus = abfm.calculus
    operator = calculus.divergence if kind == "divergence" else calculus.curl
    return np.asarray(
        operator(field.mesh) @ abfm.calculus.to_frame(field.mesh, field.velocity).ravel()
    )
