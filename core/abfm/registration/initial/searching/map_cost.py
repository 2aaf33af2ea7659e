"""The cost of a map between two coarse surfaces, for the comparison of candidates.

The cost is the sum of the Dirichlet energies in both directions, the dissimilarity of descriptors,
and the commutator with the Laplacian.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from abfm.functions.local_shape import vertex_normals
from abfm.mesh import TriangleMesh
from abfm.registration.initial.descriptors import dissimilarity
from abfm.registration.initial.searching.coarse_shape import CoarseShape
from abfm.registration.initial.searching.reversible import REVERSIBILITY, TwoWayMap
from abfm.types import FloatArray, IntArray

_COMMUTATOR_WEIGHT = 2.0  # energy and descriptors have weight 1
_WRONG_SIDE_COST = 1.0  # added if the orientation is wrong on most of the surface


class MapCost(NamedTuple):
    """Parts of the cost of a map; an isometry has energy 2, and descriptors and commutator 0."""

    energy: float  # reversible harmonic energy
    descriptors: float  # dissimilarity of descriptors
    commutator: float  # relative commutator with the Laplacian
    side: float  # 1 if the map preserves the orientation everywhere, -1 if it reverses it

    def total(self, side: int = 1) -> float:
        """Return the weighted sum of the parts, plus a penalty for the wrong orientation.

        The correct orientation is ``side``: 1, or -1 for a map onto the mirror image.
        """
        wrong = _WRONG_SIDE_COST * (side * self.side < 0)
        return self.energy + self.descriptors + _COMMUTATOR_WEIGHT * self.commutator + wrong


def map_cost(
    a: CoarseShape,
    b: CoarseShape,
    found: TwoWayMap,
    descriptors: tuple[FloatArray, FloatArray],
    weights: FloatArray,
) -> MapCost:
    """Return the cost of a map, with descriptors (V_A, C) and (V_B, C) and their weights (C,)."""
    on_a, on_b = descriptors
    at_b = dissimilarity(on_a[found.to_a], on_b, b.areas)
    at_a = dissimilarity(on_b[found.to_b], on_a, a.areas)
    commutator = (_commutator(a, b, found.to_a) + _commutator(b, a, found.to_b)) / 2
    return MapCost(
        energy(a, b, found), float(weights @ (at_b + at_a)) / 2, commutator, side(a, b, found.to_a)
    )


def energy(a: CoarseShape, b: CoarseShape, found: TwoWayMap) -> float:
    """Return the reversible harmonic energy of a map, the sum over both directions.

    A direction has the Dirichlet energy, relative to that of the identity map, plus the mean
    squared round-trip distance times `REVERSIBILITY`.
    """

    def one_direction(
        domain: CoarseShape, codomain: CoarseShape, map_: IntArray, back: IntArray
    ) -> float:
        images = codomain.coordinates[map_]
        stretch = float((images * (domain.stiffness @ images)).sum()) / domain.stretch
        gaps = domain.distances[np.arange(len(map_)), back[map_]]
        return stretch + REVERSIBILITY * float(domain.areas @ gaps**2)

    return one_direction(b, a, found.to_a, found.to_b) + one_direction(a, b, found.to_b, found.to_a)


def side(a: CoarseShape, b: CoarseShape, to_a: IntArray) -> float:
    """Return the share of area with preserved minus that with reversed orientation, -1 to 1.

    The weight of a face is the smaller one of its area and the area of its image.
    """

    def area_vectors(mesh: TriangleMesh, faces: IntArray) -> FloatArray:
        first, second, third = mesh.vertices[faces.T]
        return np.cross(second - first, third - first)

    corners = to_a[b.mesh.faces]
    images = area_vectors(a.mesh, corners)
    areas = np.linalg.norm(area_vectors(b.mesh, b.mesh.faces), axis=1)
    sizes = np.minimum(areas, np.linalg.norm(images, axis=1))
    normals = vertex_normals(a.mesh)[corners].sum(axis=1)
    total = float(sizes.sum())
    return float(sizes @ np.sign((images * normals).sum(axis=1))) / total if total > 0 else 0.0


def _commutator(codomain: CoarseShape, domain: CoarseShape, vertices: IntArray) -> float:
    """Return the relative commutator of a vertex map, by its functional map C and Laplacian L.

    It is ``2 |C L - L C| / (|C L| + |L C|)``.
    """
    size = min(len(codomain.eigenvalues), len(domain.eigenvalues))
    transferred = codomain.eigenfunctions[vertices, :size]
    C = domain.eigenfunctions[:, :size].T @ (domain.areas[:, None] * transferred)
    first, second = C * codomain.eigenvalues[:size], domain.eigenvalues[:size, None] * C
    sizes = np.linalg.norm(first) + np.linalg.norm(second)
    return float(2 * np.linalg.norm(first - second) / sizes) if sizes > 0 else 0.0
