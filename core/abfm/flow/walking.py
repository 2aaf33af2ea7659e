"""Numba kernels that read a continuous field, and go straight over the edges of the faces."""

from __future__ import annotations

from abfm.flow.smooth_flow import SmoothFlow
from abfm.numerics.kernels import kernel

_CROSSINGS = 64  # edges that a step may meet before the walk counts as caught at a vertex


@kernel
def vector_at(flow: SmoothFlow, f: int, x: float, y: float) -> tuple[float, float]:
    """The field at a place, in the face's frame."""
    w = flow.vectors
    return w[f, 0, 0] + x * w[f, 1, 0] + y * w[f, 2, 0], w[f, 0, 1] + x * w[f, 1, 1] + y * w[f, 2, 1]


@kernel
def walk_straight(
    flow: SmoothFlow, f: int, x: float, y: float, u: float, v: float, slide: bool = False
) -> tuple[int, float, float, float, float]:
    """Go a way (u, v) from a place, unfolding the faces that it leads over.

    Returns the place, with face -1 at a boundary, and the way as it is seen there; or, to ``slide``, goes on along the
    boundary with the part of the way that leads along it.
    """
    left, entered = 1.0, -1
    for _ in range(_CROSSINGS):
        leave, used = -1, left
        for i in range(3):
            rate = flow.gradients[f, i, 0] * u + flow.gradients[f, i, 1] * v
            if rate < 0.0 and i != entered:
                weight = flow.gradients[f, i, 0] * x + flow.gradients[f, i, 1] * y + (1.0 if i == 0 else 0.0)
                if weight + rate * used < 0.0:
                    leave, used = i, max(weight, 0.0) / -rate
        x, y = x + used * u, y + used * v
        if leave < 0:
            return f, x, y, u, v
        left -= used
        slot = flow.neighbours[f, leave]
        if slot < 0:
            if not slide:
                return -1, x, y, u, v
            p, q = flow.gradients[f, leave, 0], flow.gradients[f, leave, 1]
            along = (p * v - q * u) / (p * p + q * q)
            u, v, entered = -q * along, p * along, leave
            continue
        c, s = flow.unfolding[f, leave, 0], flow.unfolding[f, leave, 1]
        x, y = c * x - s * y + flow.unfolding[f, leave, 2], s * x + c * y + flow.unfolding[f, leave, 3]
        u, v = c * u - s * v, s * u + c * v
        f, entered = slot // 3, slot % 3
    return f if slide else -1, x, y, u, v
