"""Functional maps: maps between surfaces as small matrices in eigenbases [OBC*12].

A point map takes each vertex of one surface, the target, to a point of another surface, the source.
Composition with it transfers functions from the source to the target. In the first eigenfunctions
of both surfaces, scaled to unit area, the composition is a matrix ``C`` (k_target, k_source).

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

_CHUNK = 256  # rows whose distances are in memory at a time


def spectral_coefficients(mesh: TriangleMesh, h: ArrayLike, k: int) -> FloatArray:
    """Return the coefficients (k,) or (k, C) of a function ``h`` in the first k eigenfunctions.

    They are ``Phi^T M h``, where ``Phi`` has the eigenfunctions and ``M`` the vertex areas of the
    mesh scaled to unit area. The function has shape (V,) or (V, C).
    """
    rows = channels(mesh, h, "h")
    areas = vertex_areas(mesh.normalized())[:, None]
    found: FloatArray = _basis(mesh, k).T @ (areas * rows.T)
    return found.reshape(k, *np.shape(h)[1:])


def functional_map(points: PointMap, k: int) -> FloatArray:
    """Return a point map as a functional map of k eigenfunctions, shape (k, k).

    It is ``Phi_target^+ P Phi_source``. ``P`` is the matrix of the point map from the target, its
    domain, to the source, its codomain. ``Phi`` has the eigenfunctions of a surface.
    """
    return spectral_coefficients(points.domain, points.pull_back(_basis(points.codomain, k)), k)


def transfer(source: TriangleMesh, target: TriangleMesh, C: ArrayLike, h: ArrayLike) -> FloatArray:
    """Transfer a function ``h`` from the source to the target by a functional map ``C``.

    The result is ``Phi_target C Phi_source^+ h``, where ``Phi`` has a surface's eigenfunctions.
    """
    matrix = _check(C)
    coefficients = spectral_coefficients(source, h, matrix.shape[1])
    return np.asarray(_basis(target, matrix.shape[0]) @ (matrix @ coefficients))


def point_map(source: TriangleMesh, target: TriangleMesh, C: ArrayLike) -> PointMap:
    """Return the point map of a functional map (k_target, k_source) [OBC*12, 6.1].

    The point map takes every vertex of the target to a vertex of the source. ``Phi_source`` and
    ``Phi_target`` have the values of the eigenfunctions, one row per vertex. The delta function at
    a vertex of the source has its row of ``Phi_source`` as coefficients. ``C`` transfers it to the
    same row of ``Phi_source C^T``. A vertex of the target is mapped to the vertex of the source
    whose row there is closest to its row of ``Phi_target``.

    Searching rows of ``Phi_target C`` among those of ``Phi_source`` would use the adjoint of ``C``,
    which is its inverse only if ``C`` is orthogonal.
    """
    matrix = _check(C)
    rows = nearest_rows(matrix, _basis(source, matrix.shape[1]), _basis(target, matrix.shape[0]))
    return PointMap.of_vertices(target, source, rows)


def zoom_out(
    source: TriangleMesh, target: TriangleMesh, C: ArrayLike, k: int, step: int = 1
) -> FloatArray:
    """Refine a functional map of shape (k_target, k_source) to the shape (k, k) [MRR*19].

    Each iteration converts the functional map to a point map, as `point_map` does. The point map is
    then converted to a functional map with ``step`` more eigenfunctions.
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
    data = _basis(source, k), _basis(target, k), vertex_areas(target.normalized())
    return refined(*data, _fitted(*data, rows, sizes[0]), sizes[1:])


def refined(
    source: FloatArray, target: FloatArray, weights: FloatArray, C: FloatArray, sizes: Iterable[int]
) -> FloatArray:
    """Refine a functional map iteratively to each of the matrix sizes ``sizes`` [MRR*19].

    ``source`` (P, K) and ``target`` (Q, K) are eigenfunctions at any points of both surfaces.
    ``weights`` (Q,) are the areas of the target's points.
    """
    for size in sizes:
        checkpoint()
        rows = nearest_rows(C, source[:, : C.shape[1]], target[:, : C.shape[0]])
        C = _fitted(source, target, weights, rows, size)
    return C


def _fitted(
    source: FloatArray, target: FloatArray, weights: FloatArray, rows: IntArray, size: int
) -> FloatArray:
    before, after = source[rows, :size], target[:, :size]
    weighted = weights[:, None] * after
    return np.asarray(np.linalg.solve(weighted.T @ after, weighted.T @ before))


def _basis(mesh: TriangleMesh, k: int) -> FloatArray:
    return unit_eigenbasis(mesh, k)[1]


def nearest_rows(C: FloatArray, source: FloatArray, target: FloatArray) -> IntArray:
    """Return, for each row of ``target``, the index of the closest row of ``source C^T``.

    ``source`` and ``target`` have the values of eigenfunctions, one row per point. If ``C`` is far
    from isometric, matrix products are 20 times as fast as a search tree.
    """
    return nearest(target, source @ C.T)


def nearest(rows: NDArray[np.floating[Any]], others: NDArray[np.floating[Any]]) -> IntArray:
    """Return, for each of the rows (n, d), the index of the closest row of ``others`` (m, d)."""
    sizes = (others**2).sum(axis=1)
    found = np.empty(len(rows), dtype=np.int64)
    for start in range(0, len(rows), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        distances = (-2 * rows[chunk]) @ others.T  # squared, minus the squared norm of the row
        distances += sizes
        found[chunk] = distances.argmin(axis=1)
    return found


def _check(C: ArrayLike) -> FloatArray:
    matrix = real_numbers(C, "the functional map", ParameterError)
    if matrix.ndim != 2 or 0 in matrix.shape:
        raise ParameterError(
            f"the functional map has shape {matrix.shape}; expected (k_target, k_source), at least "
            "(1, 1)"
        )
    if not np.isfinite(matrix).all():
        raise ParameterError(
            "the functional map has values that are not finite; expected finite values"
        )
    return matrix
