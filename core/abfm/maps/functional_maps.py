"""Functional maps: maps between surfaces as small matrices in eigenbases, and back [OBC*12].

A point map takes each vertex of one surface, here the target, to a point of another, the source;
composing with it carries functions from source to target. In the first eigenfunctions of both, on
the surfaces scaled to unit area, that is a matrix ``C`` (k_target, k_source).

References
----------
Ovsjanikov, Ben-Chen, Solomon, Butscher, Guibas: Functional Maps, ACM TOG 31(4), 2012.
Melzi, Ren, Rodolà, Sharma, Wonka, Ovsjanikov: ZoomOut, ACM TOG 38(6), 2019.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.calculus.channels import channels
from abfm.calculus.eigenbasis import unit_eigenbasis
from abfm.calculus.operators import vertex_areas
from abfm.errors import ParameterError
from abfm.maps.point_maps import PointMap
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray, IntArray
from abfm.workers.control import checkpoint

_CHUNK = 256  # vertices of the target whose distances are in memory at a time


def spectral_coefficients(mesh: TriangleMesh, h: ArrayLike, k: int) -> FloatArray:
    """Return coefficients (k,) or (k, C) of a function (V,) or (V, C): ``Phi^T M h``."""
    rows = channels(mesh, h, "h")
    areas = vertex_areas(mesh.normalized())[:, None]
    found: FloatArray = _basis(mesh, k).T @ (areas * rows.T)
    return found.reshape(k, *np.shape(h)[1:])


def functional_map(points: PointMap, k: int) -> FloatArray:
    """Return ``Phi_target^+ P Phi_source``, (k, k), of a point map from target to source."""
    return spectral_coefficients(points.domain, points.pull_back(_basis(points.codomain, k)), k)


def transfer(source: TriangleMesh, target: TriangleMesh, C: ArrayLike, h: ArrayLike) -> FloatArray:
    """Carry a function of the source to the target: ``Phi_target C Phi_source^+ h``."""
    matrix = _check(C)
    coefficients = spectral_coefficients(source, h, matrix.shape[1])
    return np.asarray(_basis(target, matrix.shape[0]) @ (matrix @ coefficients))


def point_map(source: TriangleMesh, target: TriangleMesh, C: ArrayLike) -> PointMap:
    """Return the point map of a functional map (k_target, k_source), to a vertex of the source for
    every one of the target: where delta functions of the source arrive [OBC*12, 6.1].

    The delta function at a vertex of the source has its row of ``Phi_source`` as coefficients, and
    ``C`` makes of it that row of ``Phi_source C^T``; each vertex of the target goes to that whose
    carried delta function is nearest to its own row of ``Phi_target``. Looking up rows of
    ``Phi_target C`` among those of ``Phi_source`` instead would transfer back by the adjoint of
    ``C``, which is its inverse only where ``C`` is orthogonal.
    """
    matrix = _check(C)
    rows = nearest_rows(matrix, _basis(source, matrix.shape[1]), _basis(target, matrix.shape[0]))
    return PointMap.of_vertices(target, source, rows)


def zoom_out(
    source: TriangleMesh, target: TriangleMesh, C: ArrayLike, k: int, step: int = 1
) -> FloatArray:
    """Refine a functional map (k_target, k_source) to k eigenfunctions, (k, k), by going to points,
    as by `point_map`, and back, each time with ``step`` more [MRR*19].
    """
    matrix = _check(C)
    if not max(matrix.shape) <= k:
        raise ParameterError(
            f"k is {k}; expected at least the size of the functional map, {max(matrix.shape)}"
        )
    if not step >= 1:
        raise ParameterError(f"step is {step}; expected at least 1")
    rows = nearest_rows(matrix, _basis(source, matrix.shape[1]), _basis(target, matrix.shape[0]))
    sizes = [*range(max(matrix.shape) + step, k, step), k]
    known = _basis(source, k), _basis(target, k), vertex_areas(target.normalized())
    return refined(*known, _fitted(*known, rows, sizes[0]), sizes[1:])


def refined(
    source: FloatArray, target: FloatArray, weights: FloatArray, C: FloatArray, sizes: Iterable[int]
) -> FloatArray:
    """Refine a functional map through sizes [MRR*19], each by the eigenfunctions (P, K) of the
    source, and (Q, K) of the target, at any points of theirs; weights (Q,) are areas of those of
    the target.
    """
    for size in sizes:
        checkpoint()
        rows = nearest_rows(C, source[:, : C.shape[1]], target[:, : C.shape[0]])
        C = _fitted(source, target, weights, rows, size)
    return C


def _fitted(
    source: FloatArray, target: FloatArray, weights: FloatArray, rows: IntArray, size: int
) -> FloatArray:
    """Return the functional map, of a size, of a map from points to points, in least squares."""
    before, after = source[rows, :size], target[:, :size]
    weighted = weights[:, None] * after
    return np.asarray(np.linalg.solve(weighted.T @ after, weighted.T @ before))


def _basis(mesh: TriangleMesh, k: int) -> FloatArray:
    return unit_eigenbasis(mesh, k)[1]


def nearest_rows(C: FloatArray, source: FloatArray, target: FloatArray) -> IntArray:
    """Find, for each vertex of the target, that of the source whose delta function arrives nearest,
    by matrix products: 20 times as fast as a tree where maps are far from isometric.
    """
    return nearest(target, source @ C.T)


def nearest(rows: NDArray[np.floating[Any]], others: NDArray[np.floating[Any]]) -> IntArray:
    """Return the number of the nearest of the others (m, d) for each row (n, d)."""
    sizes = (others**2).sum(axis=1)
    found = np.empty(len(rows), dtype=np.int64)
    for start in range(0, len(rows), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        distances = (-2 * rows[chunk]) @ others.T  # squared, without the row's own part
        distances += sizes
        found[chunk] = distances.argmin(axis=1)
    return found


def _check(C: ArrayLike) -> FloatArray:
    matrix = real_numbers(C, "the functional map", ParameterError)
    if matrix.ndim != 2 or 0 in matrix.shape or not np.isfinite(matrix).all():
        raise ParameterError(
            f"the functional map has shape {matrix.shape} or values that are not finite; expected "
            "a finite matrix (eigenfunctions of the target, eigenfunctions of the source)"
        )
    return matrix
