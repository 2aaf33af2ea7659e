"""How much of a function is noise, by what no neighbour knows of it; and how much of what changes
a motion explains beyond noise.
"""

import numpy as np
from scipy import sparse

from abfm.calculus.operators import adjacency
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh, per_mesh
from abfm.sequences.frames import Frames
from abfm.types import BoolArray, FloatArray

NOISE_FACTOR = 1.3
"""Times what noise leaves, within which nothing but noise is left."""
# of what differed at first, or would if all were squeezed away: more is left where motion
# explains little
_EXPLAINED_SHARE_MIN = 0.6
_ROUNDED_RESIDUAL = 1e-9  # a residual that is rounding, as of constants
_RESIDUAL_OF_MEAN = 1.0
"""Residual of a constant, the mean of the target: that of a bump in the wrong place is larger, and
falls to this if the flow only flattens it."""
_ROUNDING = 1e-12  # of the largest value: less is rounding


def noise(
    mesh: TriangleMesh, functions: FloatArray, seen: BoolArray | slice = slice(None)
) -> FloatArray:
    """Estimate the standard deviation of independent noise on vertices, for functions (..., V),
    (...,): an upper bound, to which what is bent over single edges adds; by the vertices seen.

    What a value differs from the mean of its ``n`` neighbours has the variance ``1 + 1/n`` of the
    noise [after Immerkær, Computer Vision and Image Understanding 64 (1996)]; the median over
    vertices is taken, so that jumps do not count.
    """
    usual = np.median(_alone(mesh, functions)[..., seen], axis=-1)
    return np.asarray(usual / 0.6744897501960817)  # of a normal distribution's deviation


def noise_levels(frames: Frames) -> FloatArray:
    """Return the standard deviation of independent noise of each channel at each vertex, (C, V):
    one for all that are compared, and 0 where no frame has any, as activity below a threshold.
    """
    mesh, rows = frames.mesh, [np.ascontiguousarray(frame.T) for frame in frames.values]
    noisy = ~np.logical_and.reduce([is_flat(mesh, row) for row in rows])  # (C, V)
    if frames.mask is not None:
        noisy &= frames.mask > 0
    levels = np.zeros(noisy.shape)
    for channel, seen in enumerate(noisy):
        if seen.any():
            usual = np.array([noise(mesh, row[channel], seen) for row in rows])
            levels[channel, seen] = np.sqrt(np.median(usual**2))
    return levels


def noise_floor(functions: FunctionTerm, levels: FloatArray) -> float:
    """Return what noise of levels (C, V) leaves between two frames, at most, as a mismatch: the
    root of 2, as both have it.
    """
    return float(np.sqrt(2) * functions.relative_size(levels))


def explains_too_little(functions: FunctionTerm, levels: FloatArray, left: float) -> bool:
    """Return whether a field with such a residual explains little of the change beyond noise of
    levels (C, V).
    """
    first = functions.residual(functions.source)
    explained = _EXPLAINED_SHARE_MIN * min(first, _RESIDUAL_OF_MEAN)
    return left > max(NOISE_FACTOR * noise_floor(functions, levels), explained, _ROUNDED_RESIDUAL)


def is_flat(mesh: TriangleMesh, functions: FloatArray) -> BoolArray:
    """Return where functions (..., V) are as their neighbours, (..., V): noise never is, but what
    was put in place of values is.
    """
    sizes = np.abs(functions).max(axis=-1, keepdims=True)
    return np.asarray(_alone(mesh, functions) <= _ROUNDING * sizes)


def means_of_neighbours(mesh: TriangleMesh, functions: FloatArray) -> FloatArray:
    """Return at each vertex the mean of functions (..., V) over its neighbours, (..., V)."""
    rows = functions.reshape(-1, functions.shape[-1])
    return np.asarray((_means(mesh) @ rows.T).T.reshape(functions.shape))


def _alone(mesh: TriangleMesh, functions: FloatArray) -> FloatArray:
    apart = functions - means_of_neighbours(mesh, functions)
    return np.asarray(np.abs(apart) / np.sqrt(1 + 1 / _neighbours(mesh)))


@per_mesh
def _neighbours(mesh: TriangleMesh) -> FloatArray:
    return np.bincount(mesh.edges.ravel(), minlength=len(mesh.vertices)).astype(np.float64)


@per_mesh
def _means(mesh: TriangleMesh) -> sparse.csr_array:
    return sparse.csr_array(sparse.diags_array(1 / _neighbours(mesh)) @ adjacency(mesh))
