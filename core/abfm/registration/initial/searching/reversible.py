"""Reversible harmonic maps between two coarse surfaces: both ways of a map at once, moved to less
Dirichlet energy while each leads back to where the other came from.

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

REVERSIBILITY = 100.0  # weight of the distances there and back, squared, by area


class TwoWayMap(NamedTuple):
    """A map of vertices to vertices both ways, and its images in coordinates before rounding."""

    there: IntArray  # (V_B,), a vertex of A for each of B
    back: IntArray  # (V_A,)
    images: FloatArray  # (V_B, 8), in coordinates of A


def two_way_map(a: CoarseShape, b: CoarseShape, there: IntArray) -> TwoWayMap:
    """Complete a map from B to A by the vertices of B whose images are nearest."""
    images = a.coordinates[there]
    return TwoWayMap(there, nearest(a.coordinates, images), images)


def relax(
    a: CoarseShape,
    b: CoarseShape,
    start: TwoWayMap,
    descriptors: tuple[FloatArray, FloatArray],
    *,
    weight: float,
    penalties: Iterable[float],
    turns: int,
) -> TwoWayMap:
    """Relax a map by alternating minimisation: of images in coordinates, by a linear system each
    way, and of the vertices that these are rounded to.

    Parameters
    ----------
    descriptors : (V_A, C) and (V_B, C) arrays
        Functions that rounding shall keep.
    weight : float
        Of the squared difference of these.
    penalties : iterable of float
        Weights of the distance between images and the vertices they are rounded to, ascending,
        relative to `REVERSIBILITY`.
    """
    (there, back, images), on_a, on_b = start, *descriptors
    mixed = np.sqrt(weight)
    for penalty in REVERSIBILITY * np.asarray(list(penalties)):
        solve_b, solve_a = _System(b, penalty), _System(a, penalty)
        of_images, of_places = np.sqrt(penalty), np.sqrt(REVERSIBILITY)
        for _ in range(turns):
            checkpoint()
            images = solve_b.images(a, there, back)
            images_back = solve_a.images(b, back, there)
            rows_a = [of_places * images_back, of_images * a.coordinates, mixed * on_a]
            rows_b = [of_places * b.coordinates, of_images * images, mixed * on_b]
            there = _nearest(rows_b, rows_a)
            rows_a = [of_places * a.coordinates, of_images * images_back, mixed * on_a]
            rows_b = [of_places * images, of_images * b.coordinates, mixed * on_b]
            back = _nearest(rows_a, rows_b)
    return TwoWayMap(there, back, images)


class _System:
    """The linear system of images of one surface's vertices, for one penalty."""

    def __init__(self, shape: CoarseShape, penalty: float) -> None:
        self._shape, self._penalty = shape, penalty
        fixed = 2 / shape.stretch * shape.stiffness
        self._matrix = sparse.csc_array(fixed + sparse.diags_array(penalty * shape.areas))
        columns = np.repeat(np.arange(len(shape.areas)), np.diff(self._matrix.indptr))
        self._diagonal = np.flatnonzero(self._matrix.indices == columns)
        self._fixed = self._matrix.data[self._diagonal]

    def images(self, other: CoarseShape, there: IntArray, back: IntArray) -> FloatArray:
        """Return the images (V, 8) in coordinates of the other surface, whose vertices ``back``
        takes to these.
        """
        count = len(self._shape.areas)
        weights = REVERSIBILITY * other.areas
        right = self._penalty * self._shape.areas[:, None] * other.coordinates[there]
        np.add.at(right, back, weights[:, None] * other.coordinates)
        self._matrix.data[self._diagonal] = self._fixed + np.bincount(back, weights, count)
        options = {"SymmetricMode": True}
        solve = splu(self._matrix, "MMD_AT_PLUS_A", 0.0, options=options)
        return np.asarray(solve.solve(right))


def _nearest(rows: list[FloatArray], others: list[FloatArray]) -> IntArray:
    """Return the numbers of the nearest others; in single precision, which is enough."""
    one, other = (np.hstack(parts).astype(np.float32) for parts in (rows, others))
    return nearest(one, other)
