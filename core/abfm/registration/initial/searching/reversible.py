"""Reversible harmonic maps between two coarse surfaces.

Maps in both directions are optimised together. Both get a small Dirichlet energy, and their
composition stays close to the identity.

References
----------
Ezuz, Solomon, Ben-Chen: Reversible Harmonic Maps between Discrete Surfaces, ACM TOG 38(2), 2019.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from abfm.maps.functional_maps import nearest
from abfm.registration.initial.searching.coarse_shape import CoarseShape
from abfm.types import FloatArray, IntArray
from abfm.workers.control import checkpoint

REVERSIBILITY = 100.0  # weight of squared round-trip distances, integrated over area


class TwoWayMap(NamedTuple):
    """Vertex maps in both directions, and the images before rounding to vertices."""

    to_a: IntArray  # (V_B,), a vertex of A for each of B
    to_b: IntArray  # (V_A,), a vertex of B for each of A
    images: FloatArray  # (V_B, 8), images of B's vertices, in coordinates of A


def two_way_map(a: CoarseShape, b: CoarseShape, to_a: IntArray) -> TwoWayMap:
    """Return the map to A, given by the vertices ``to_a`` (V_B,), with a map back to B.

    The map back takes each vertex of A to the vertex of B with the closest image.
    """
    images = a.coordinates[to_a]
    return TwoWayMap(to_a, nearest(a.coordinates, images), images)


def relax(
    a: CoarseShape,
    b: CoarseShape,
    start: TwoWayMap,
    descriptors: tuple[FloatArray, FloatArray],
    *,
    weight: float,
    penalties: Iterable[float],
    iterations: int,
) -> TwoWayMap:
    """Reduce the reversible harmonic energy of a map by alternating minimisation.

    One step minimises over the images in coordinates, by a linear system in each direction. The
    other step minimises over the vertices to which the images are rounded. Both are repeated
    ``iterations`` times for each penalty. The ``penalties`` are ascending weights of the distance
    between images and the vertices to which they are rounded, relative to `REVERSIBILITY`. The
    squared difference of the ``descriptors``, (V_A, C) and (V_B, C), has the weight ``weight``.
    """
    (to_a, to_b, images), on_a, on_b = start, *descriptors
    of_descriptors = np.sqrt(weight)
    for penalty in REVERSIBILITY * np.asarray(list(penalties)):
        solve_b, solve_a = _System(b, penalty), _System(a, penalty)
        of_images, of_places = np.sqrt(penalty), np.sqrt(REVERSIBILITY)
        for _ in range(iterations):
            checkpoint()
            images = solve_b.images(a, to_a, to_b)
            images_on_b = solve_a.images(b, to_b, to_a)
            rows_a = [of_places * images_on_b, of_images * a.coordinates, of_descriptors * on_a]
            rows_b = [of_places * b.coordinates, of_images * images, of_descriptors * on_b]
            to_a = _nearest(rows_b, rows_a)
            rows_a = [of_places * a.coordinates, of_images * images_on_b, of_descriptors * on_a]
            rows_b = [of_places * images, of_images * b.coordinates, of_descriptors * on_b]
            to_b = _nearest(rows_a, rows_b)
    return TwoWayMap(to_a, to_b, images)


class _System:
    """The linear system for the images of a surface's vertices at one penalty, see `relax`."""

    def __init__(self, shape: CoarseShape, penalty: float) -> None:
        self._shape, self._penalty = shape, penalty
        fixed = 2 / shape.stretch * shape.stiffness
        self._matrix = sparse.csc_array(fixed + sparse.diags_array(penalty * shape.areas))
        columns = np.repeat(np.arange(len(shape.areas)), np.diff(self._matrix.indptr))
        self._diagonal = np.flatnonzero(self._matrix.indices == columns)
        self._fixed = self._matrix.data[self._diagonal]

    def images(self, other: CoarseShape, to_other: IntArray, from_other: IntArray) -> FloatArray:
        """Return the images (V, 8) of the vertices, in coordinates of the other surface.

        ``to_other`` and ``from_other`` are the vertex maps in both directions.
        """
        count = len(self._shape.areas)
        weights = REVERSIBILITY * other.areas
        right = self._penalty * self._shape.areas[:, None] * other.coordinates[to_other]
        np.add.at(right, from_other, weights[:, None] * other.coordinates)
        self._matrix.data[self._diagonal] = self._fixed + np.bincount(from_other, weights, count)
        options = {"SymmetricMode": True}
        solve = splu(self._matrix, "MMD_AT_PLUS_A", 0.0, options=options)
        return np.asarray(solve.solve(right))


def _nearest(rows: list[FloatArray], others: list[FloatArray]) -> IntArray:
    """Return the index of the row of ``others`` nearest to each row, in single precision.

    Both arguments are lists of blocks of columns.
    """
    one, other = (np.hstack(parts).astype(np.float32) for parts in (rows, others))
    return nearest(one, other)
