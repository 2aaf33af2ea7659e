"""Noise of functions, estimated from differences between neighbours, and changes beyond noise."""

import numpy as np
from scipy import sparse

from abfm.calculus.operators import adjacency
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh, per_mesh
from abfm.sequences.frames import Frames
from abfm.types import BoolArray, FloatArray

NOISE_FACTOR = 1.3  # largest residual, relative to that of noise, that counts as noise
# A field explains too little if its residual exceeds this share of the initial residual, or of the
# residual of a flattened function.
_RESIDUAL_SHARE_MAX = 0.6
_ROUNDED_RESIDUAL = 1e-9  # smaller residuals are rounding errors, for example of constants
_RESIDUAL_OF_MEAN = 1.0
"""Residual of a source that is constant and equals the mean of the target.

The residual of a bump in the wrong place is larger, and falls to this value if the flow only
flattens the bump.
"""
_ROUNDING = 1e-12  # rounding errors relative to the largest value


def noise(
    mesh: TriangleMesh, functions: FloatArray, compared: BoolArray | slice = slice(None)
) -> FloatArray:
    """Return an estimate (...,) of the standard deviation of noise in functions (..., V).

    The noise is independent at each vertex. The estimate is an upper bound, since curvature of a
    function within single edges adds to it. The difference of a value from the mean of its ``n``
    neighbours has ``1 + 1/n`` times the variance of the noise. See Immerkær, Computer Vision and
    Image Understanding 64 (1996). The median over the compared vertices ignores jumps.
    """
    median = np.median(_neighbour_deviations(mesh, functions)[..., compared], axis=-1)
    return np.asarray(median / 0.6744897501960817)  # median absolute value of a normal variable


def noise_levels(frames: Frames) -> FloatArray:
    """Return the standard deviation of independent noise at each vertex, (C, V).

    Each channel has one level for all compared vertices. The level is 0 at vertices where no frame
    has noise, for example where activity is below a threshold.
    """
    mesh, rows = frames.mesh, [np.ascontiguousarray(frame.T) for frame in frames.values]
    noisy = ~np.logical_and.reduce([is_flat(mesh, row) for row in rows])  # (C, V)
    if frames.mask is not None:
        noisy &= frames.mask > 0
    levels = np.zeros(noisy.shape)
    for channel, compared in enumerate(noisy):
        if compared.any():
            median = np.array([noise(mesh, row[channel], compared) for row in rows])
            levels[channel, compared] = np.sqrt(np.median(median**2))
    return levels


def noise_floor(functions: FunctionTerm, levels: FloatArray) -> float:
    """Return the largest residual that noise in both frames causes.

    ``levels`` (C, V) are the standard deviations of the noise.
    """
    return float(np.sqrt(2) * functions.relative_size(levels))


def explains_too_little(functions: FunctionTerm, levels: FloatArray, residual: float) -> bool:
    """Return whether a field with this residual explains little of the change beyond noise.

    ``levels`` (C, V) are the standard deviations of the noise.
    """
    first = functions.residual(functions.source)
    explained = _RESIDUAL_SHARE_MAX * min(first, _RESIDUAL_OF_MEAN)
    return residual > max(
        NOISE_FACTOR * noise_floor(functions, levels), explained, _ROUNDED_RESIDUAL
    )


def is_flat(mesh: TriangleMesh, functions: FloatArray) -> BoolArray:
    """Return a mask (..., V) of vertices where functions (..., V) equal the mean of the neighbours.

    Noisy values never equal that mean, but values that replace missing ones do.
    """
    sizes = np.abs(functions).max(axis=-1, keepdims=True)
    return np.asarray(_neighbour_deviations(mesh, functions) <= _ROUNDING * sizes)


def means_of_neighbours(mesh: TriangleMesh, functions: FloatArray) -> FloatArray:
    """Return the mean of functions (..., V) over the neighbours of each vertex, (..., V)."""
    rows = functions.reshape(-1, functions.shape[-1])
    return np.asarray((_neighbour_mean_matrix(mesh) @ rows.T).T.reshape(functions.shape))


def _neighbour_deviations(mesh: TriangleMesh, functions: FloatArray) -> FloatArray:
    difference = functions - means_of_neighbours(mesh, functions)
    return np.asarray(np.abs(difference) / np.sqrt(1 + 1 / _valence(mesh)))


@per_mesh
def _valence(mesh: TriangleMesh) -> FloatArray:
    return np.bincount(mesh.edges.ravel(), minlength=len(mesh.vertices)).astype(np.float64)


@per_mesh
def _neighbour_mean_matrix(mesh: TriangleMesh) -> sparse.csr_array:
    return sparse.csr_array(sparse.diags_array(1 / _valence(mesh)) @ adjacency(mesh))
