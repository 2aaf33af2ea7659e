"""Which points of a surface its other parts hide, as it is seen in parallel projection."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from abfm import TriangleMesh
from abfm.types import FloatArray

_DEPTH_TOLERANCE = 0.01  # of sqrt(area): what is less far behind a face lies on it


def are_hidden(
    mesh: TriangleMesh, places: FloatArray, normals: FloatArray, axes: FloatArray
) -> NDArray[np.bool_]:
    """Tell which of the places (P, 3) with normals (P, 3) have a face before them, or look away on
    a surface without boundary, (P,); axes (3, 3) are what is right, up, and towards the viewer.
    """
    hidden: NDArray[np.bool_] = (normals @ axes[2] <= 0) & mesh.is_closed
    if hidden.all():
        return hidden
    corners = (mesh.vertices @ axes.T)[mesh.faces]
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    nearest = corners[..., 2].max(axis=1)
    for number in np.flatnonzero(~hidden):
        seen = axes @ places[number]
        before = seen[2] + _DEPTH_TOLERANCE * mesh.length_scale
        near = (low <= seen[:2]).all(axis=1) & (high >= seen[:2]).all(axis=1) & (nearest > before)
        around = corners[near] - [*seen[:2], 0]
        # barycentric weights of the place in each face, times twice the face's area, as it is seen
        shares = np.stack([_cross(around[:, k - 2], around[:, k - 1]) for k in range(3)], axis=1)
        whole = shares.sum(axis=1)
        covers = (shares * np.sign(whole)[:, None] >= 0).all(axis=1) & (whole != 0)
        heights = (shares * around[..., 2]).sum(axis=1)[covers] / whole[covers]
        hidden[number] = bool((heights > before).any())
    return hidden


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
