"""Functional maps: maps between surfaces as small matrices in eigenbases, and the way back to points [OBC*12].

A point map takes each vertex of one surface, here the target, to a point of another, the source; composing with it
carries functions from source to target. In the first eigenfunctions of both, that is a matrix ``C`` (k_target,
k_source). Bases are those of the surfaces scaled to unit area, so that ``C`` has no unit and keeps the constant.

References
----------
Ovsjanikov, Ben-Chen, Solomon, Butscher, Guibas: Functional Maps, ACM TOG 31(4), 2012.
Melzi, Ren, Rodolà, Sharma, Wonka, Ovsjanikov: ZoomOut, ACM TOG 38(6), 2019.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from abfm.calculus.channels import channels
from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.operators import vertex_areas
from abfm.errors import ParameterError
from abfm.maps.surface_points import SurfacePoints, pull_back, vertex_points
from abfm.mesh import TriangleMesh
from abfm.real_numbers import real_numbers
from abfm.types import FloatArray


def spectral_coefficients(mesh: TriangleMesh, h: ArrayLike, k: int) -> FloatArray:
    """Coefficients (k,) or (k, C) of a function (V,) or (V, C) in the first k eigenfunctions: ``Phi^T M h``.

    ``Phi^T M`` is the pseudoinverse of ``Phi`` in L2.

    Raises
    ------
    FunctionError
        If ``h`` does not fit the mesh, or there are no k eigenfunctions.
    """
    unit = mesh.normalized()
    rows = channels(mesh, h, "h")
    found: FloatArray = eigenbasis(unit, k)[1].T @ (vertex_areas(unit)[:, None] * rows.T)
    return found.reshape(k, *np.shape(h)[1:])


def functional_map(source: TriangleMesh, target: TriangleMesh, points: SurfacePoints, k: int) -> FloatArray:
    """Functional map of a point map: ``Phi_target^+ P Phi_source``, (k, k).

    Parameters
    ----------
    source, target : TriangleMesh
    points : SurfacePoints
        Where on the source each vertex of the target goes.
    k : int
        How many eigenfunctions of each.

    Raises
    ------
    FunctionError
        If there are no k eigenfunctions, or not one point per vertex of the target.
    """
    return spectral_coefficients(target, pull_back(source, points, eigenbasis(source.normalized(), k)[1]), k)


def carry(source: TriangleMesh, target: TriangleMesh, C: ArrayLike, h: ArrayLike) -> FloatArray:
    """Carry a function of the source, of one channel or several, to the target: ``Phi_target C Phi_source^+ h``.

    Raises
    ------
    AbfmError
        If ``C`` or ``h`` does not fit.
    """
    matrix = _check(C)
    basis = eigenbasis(target.normalized(), matrix.shape[0])[1]
    return np.asarray(basis @ (matrix @ spectral_coefficients(source, h, matrix.shape[1])))


def point_map(source: TriangleMesh, target: TriangleMesh, C: ArrayLike) -> SurfacePoints:
    """Point map of a functional map: where the delta functions of the source's vertices arrive [OBC*12, 6.1].

    The delta function at a vertex of the source has its row of ``Phi_source`` as coefficients, and ``C`` makes of it
    that row of ``Phi_source C^T``. Each vertex of the target goes to the vertex of the source whose carried delta
    function is nearest to its own, a row of ``Phi_target``. Looking up rows of ``Phi_target C`` among those of
    ``Phi_source`` instead would carry the target's delta functions back by the adjoint of ``C``, which is its inverse
    only where ``C`` is orthogonal. Nothing makes that map continuous.

    Parameters
    ----------
    C : (k_target, k_source) array

    Returns
    -------
    SurfacePoints
        A vertex of the source for every vertex of the target.

    Raises
    ------
    ParameterError
        If ``C`` is not a finite matrix.
    FunctionError
        If there are not so many eigenfunctions.
    """
    matrix = _check(C)
    arrived = eigenbasis(source.normalized(), matrix.shape[1])[1] @ matrix.T
    asked = eigenbasis(target.normalized(), matrix.shape[0])[1]
    return vertex_points(source, np.asarray(cKDTree(arrived).query(asked)[1], dtype=np.int64))


def zoom_out(source: TriangleMesh, target: TriangleMesh, C: ArrayLike, k: int, step: int = 1) -> FloatArray:
    """Refine a functional map to k eigenfunctions, (k, k), by going to points and back with ever more [MRR*19].

    The way to points is `point_map`: by the adjoint, errors of the start stay.

    Parameters
    ----------
    C : (k_target, k_source) array
        The start, no larger than k.
    k : int
    step : int
        How many eigenfunctions come in at a time.

    Raises
    ------
    ParameterError
        If ``C`` is not a finite matrix, larger than k, or ``step`` is below 1.
    FunctionError
        If there are no k eigenfunctions.
    """
    matrix = _check(C)
    if not max(matrix.shape) <= k:
        raise ParameterError(f"k is {k}; expected at least the size of the functional map, {max(matrix.shape)}")
    if not step >= 1:
        raise ParameterError(f"step is {step}; expected at least 1")
    sizes = [*range(max(matrix.shape) + step, k, step), k] if max(matrix.shape) < k else [k]
    for size in sizes:
        matrix = functional_map(source, target, point_map(source, target, matrix), size)
    return matrix


def _check(C: ArrayLike) -> FloatArray:
    matrix = real_numbers(C, "the functional map", ParameterError)
    if matrix.ndim != 2 or 0 in matrix.shape or not np.isfinite(matrix).all():
        raise ParameterError(
            f"the functional map has shape {matrix.shape} or values that are not finite; expected a finite matrix "
            "(eigenfunctions of the target, eigenfunctions of the source)"
        )
    return matrix
