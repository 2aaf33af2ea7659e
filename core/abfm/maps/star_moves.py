"""Moves of single vertices of a mesh that reduce the energy of the faces around them.

The energy of a face is a sum of products ``D phi(V)``. D is the face's Dirichlet energy, which is
quadratic in the position of a corner. V is the face's area or volume, which is treated as linear,
and phi a function of V. Kernels with two axes work in the plane that the axes span.
"""

from typing import NamedTuple

import numpy as np

from abfm.maps.surface_points import Vector, cross, scalar
from abfm.numerics.kernels import unfused_kernel
from abfm.types import FloatArray, IntArray

_MOLLIFICATION = 0.01  # share of the mean side of a face that is added to its sides (for slivers)
_CURVATURE_SHARE_MIN = 0.01  # smallest curvature of a model, as a share of the largest one
FLAT_VOLUME = 1e-15  # rounding may flip faces with a smaller volume, see `volume`
STEP_FACTOR = 0.4  # factor by which a step is reduced while it does not decrease the energy
STEP_TRIES = 12  # largest number of reductions of a step


class Workspace(NamedTuple):
    """Temporary arrays for the neighbourhood of one vertex of a mesh with V vertices."""

    star: IntArray  # (V,), corners at the vertex
    shapes: FloatArray  # (V, 4), shapes of their faces, see `shape`
    axes: FloatArray  # (2, 3), axes of the plane in which the vertex moves
    model: FloatArray  # (5,), two first derivatives, and second derivatives 11, 12, 22


def allocate_workspace(count: int) -> Workspace:
    star, shapes = np.empty(count, dtype=np.int64), np.empty((count, 4))
    return Workspace(star, shapes, np.empty((2, 3)), np.empty(5))


@unfused_kernel
def difference(a: FloatArray, b: FloatArray) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@unfused_kernel
def normalize(a: FloatArray) -> None:
    a /= np.sqrt(scalar(a, a))


@unfused_kernel
def volume(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Return six times the signed volume of the tetrahedron of a face and the sphere's centre.

    For a small face on the unit sphere, this is twice its area; negative if it is flipped.
    """
    return scalar(a, cross(difference(b, a), difference(c, a)))


@unfused_kernel
def shape(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[float, float, float, float]:
    """Return half the cotangents of the angles of a face, and its area.

    The sides are first lengthened by 1% of their mean, so that results for slivers are finite.
    """
    p, q, r = difference(b, c), difference(c, a), difference(a, b)
    first, second, third = np.sqrt(scalar(p, p)), np.sqrt(scalar(q, q)), np.sqrt(scalar(r, r))
    more = _MOLLIFICATION * (first + second + third) / 3
    u, v, w = (first + more) ** 2, (second + more) ** 2, (third + more) ** 2
    area = 0.25 * np.sqrt(4 * u * v - (u + v - w) ** 2)
    return (v + w - u) / (8 * area), (w + u - v) / (8 * area), (u + v - w) / (8 * area), area


@unfused_kernel
def set_tangents(normal: FloatArray, axes: FloatArray) -> None:
    """Write to ``axes`` two unit vectors that are perpendicular to ``normal`` and to each other."""
    least = np.argmin(np.abs(normal))
    axes[0] = -normal[least] * normal
    axes[0, least] += 1.0
    normalize(axes[0])
    axes[1] = cross(normal, axes[0])


@unfused_kernel
def add_product(
    model: FloatArray,
    dirichlet: tuple[float, float, float],
    metric: tuple[float, float, float],
    logarithm: tuple[float, float],
    phi: tuple[float, float, float],
) -> None:
    """Add the derivatives of ``D phi(V)`` along two axes to ``model`` (5,).

    ``dirichlet`` has D and its first derivatives, ``metric`` the second derivatives of D.
    ``logarithm`` has the first derivatives of ``log V``, and ``phi`` the values ``phi``, ``V phi'``
    and ``V^2 phi''``.
    """
    value, d1, d2 = dirichlet
    v1, v2 = logarithm
    model[0] += d1 * phi[0] + value * phi[1] * v1
    model[1] += d2 * phi[0] + value * phi[1] * v2
    model[2] += metric[0] * phi[0] + 2 * d1 * v1 * phi[1] + value * phi[2] * v1 * v1
    model[3] += metric[1] * phi[0] + (d1 * v2 + d2 * v1) * phi[1] + value * phi[2] * v1 * v2
    model[4] += metric[2] * phi[0] + 2 * d2 * v2 * phi[1] + value * phi[2] * v2 * v2


@unfused_kernel
def step_to_minimum(model: FloatArray) -> tuple[float, float]:
    """Return the step along two axes to the minimum of a quadratic ``model`` (5,).

    The model is made convex by larger second derivatives if necessary.
    """
    g1, g2, h11, h12, h22 = model
    middle, gap = (h11 + h22) / 2, np.hypot((h11 - h22) / 2, h12)
    more = max(0.0, _CURVATURE_SHARE_MIN * (abs(middle) + gap) - (middle - gap))
    h11 += more
    h22 += more
    determinant = h11 * h22 - h12 * h12
    return (h12 * g2 - h22 * g1) / determinant, (h12 * g1 - h11 * g2) / determinant
