"""How far a function is from its target, relative to the target."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import l2_norm
from abfm.errors import ParameterError
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


def vertex_mask(mesh: TriangleMesh, mask: ArrayLike | None) -> FloatArray | None:
    """Weight of the mismatch at each vertex, (V,), given for those of the mesh or of its file; None for 1 everywhere.

    Raises
    ------
    ParameterError
        If it does not fit, a value is negative or not finite, or all are zero.
    """
    if mask is None:
        return None
    of_vertices = np.asarray(mask)
    if of_vertices.shape == (mesh.file_vertex_count,):
        of_vertices = mesh.restrict(of_vertices)
    return _weights(of_vertices, len(mesh.vertices), "mask")


def channel_weights(weights: ArrayLike | None, count: int) -> FloatArray:
    """Weight of each channel's mismatch, (count,); 1 by default.

    Raises
    ------
    ParameterError
        If they do not fit, one is negative or not finite, or all are zero.
    """
    return np.ones(count) if weights is None else _weights(weights, count, "weights")


def _weights(values: ArrayLike, count: int, name: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (count,):
        raise ParameterError(f"{name} has shape {array.shape}; expected ({count},)")
    if not np.isfinite(array).all() or (array < 0).any() or not array.any():
        raise ParameterError(f"{name} must be finite, not negative, and not zero everywhere")
    return array


def relative_mismatch(
    mesh: TriangleMesh,
    found: FloatArray,
    target: FloatArray,
    source: FloatArray,
    mask: FloatArray | None,
    weights: FloatArray,
) -> float:
    """``||found - target|| / ||target||`` in L2 over all channels (C, V), with mask (V,) and weights (C,).

    Relative to the source where the target is 0.
    """
    root = np.sqrt(weights)

    def norm(functions: FloatArray) -> float:
        return l2_norm(mesh, (root[:, None] * functions).T, mask)

    scale = norm(target) or norm(source) or 1.0
    return norm(found - target) / scale
