"""The cost of a map between two coarse surfaces, by which candidates are compared: Dirichlet energy
there and back, dissimilarity of descriptors, and the commutator with the Laplacian.
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

_COMMUTATOR = 2.0  # weight of the commutator next to the energy and the descriptors
_WRONG_SIDE = 1.0  # cost of a map that turns most of the surface over


class MapCost(NamedTuple):
    """Parts of the cost of a map; isometries cost 2 in energy, and nothing else."""

    energy: float
    descriptors: float
    commutator: float
    side: float  # 1 where B's faces lie on A with the same side up, -1 with the other one

    def total(self, side: int = 1) -> float:
        """Return the sum, with a penalty if the map has not the side that is wanted, 1 or -1."""
        wrong = _WRONG_SIDE * (side * self.side < 0)
        return self.energy + self.descriptors + _COMMUTATOR * self.commutator + wrong


def map_cost(
    a: CoarseShape,
    b: CoarseShape,
    found: TwoWayMap,
    descriptors: tuple[FloatArray, FloatArray],
    weights: FloatArray,
) -> MapCost:
    """Return the cost of a map; descriptors (V_A, C) and (V_B, C) are compared by weights (C,)."""
    on_a, on_b = descriptors
    there = dissimilarity(on_a[found.there], on_b, b.areas)
    back = dissimilarity(on_b[found.back], on_a, a.areas)
    commutator = (_commutator(a, b, found.there) + _commutator(b, a, found.back)) / 2
    return MapCost(
        energy(a, b, found),
        float(weights @ (there + back)) / 2,
        commutator,
        side(a, b, found.there),
    )


def energy(a: CoarseShape, b: CoarseShape, found: TwoWayMap) -> float:
    """Return the reversible harmonic energy: Dirichlet energies both ways, relative to those of the
    surfaces' own coordinates, and the mean squared distance of points from themselves there and
    back.
    """

    def one_way(
        domain: CoarseShape, codomain: CoarseShape, map_: IntArray, back: IntArray
    ) -> float:
        images = codomain.coordinates[map_]
        stretch = float((images * (domain.stiffness @ images)).sum()) / domain.stretch
        count = np.arange(len(map_))
        gaps = domain.distances[count, back[map_]]
        return stretch + REVERSIBILITY * float(domain.areas @ gaps**2)

    return one_way(b, a, found.there, found.back) + one_way(a, b, found.back, found.there)


def side(a: CoarseShape, b: CoarseShape, there: IntArray) -> float:
    """Return the share of the area that keeps its side less that which is turned over, -1 to 1. A
    face counts as much as the smaller one of itself and its image.
    """

    def area_vectors(mesh: TriangleMesh, faces: IntArray) -> FloatArray:
        first, second, third = mesh.vertices[faces.T]
        return np.cross(second - first, third - first)

    corners = there[b.mesh.faces]
    images = area_vectors(a.mesh, corners)
    own = np.linalg.norm(area_vectors(b.mesh, b.mesh.faces), axis=1)
    sizes = np.minimum(own, np.linalg.norm(images, axis=1))
    normals = vertex_normals(a.mesh)[corners].sum(axis=1)
    total = float(sizes.sum())
    return float(sizes @ np.sign((images * normals).sum(axis=1))) / total if total > 0 else 0.0


def _commutator(codomain: CoarseShape, domain: CoarseShape, there: IntArray) -> float:
    """Return ``2 |C L - L C| / (|C L| + |L C|)`` of the functional map of a map of vertices."""
    size = min(len(codomain.eigenvalues), len(domain.eigenvalues))
    carried = codomain.eigenfunctions[there, :size]
    C = domain.eigenfunctions[:, :size].T @ (domain.areas[:, None] * carried)
    first, second = C * codomain.eigenvalues[:size], domain.eigenvalues[:size, None] * C
    sizes = np.linalg.norm(first) + np.linalg.norm(second)
    return float(2 * np.linalg.norm(first - second) / sizes) if sizes > 0 else 0.0
