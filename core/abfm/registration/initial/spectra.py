"""The first eigenfunctions of two surfaces at some points of both, in which functional maps between
them are looked for, and how near such a map comes to an isometry.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from abfm.calculus.eigenbasis import unit_eigenbasis
from abfm.calculus.operators import face_areas, gradient
from abfm.maps.functional_maps import refined
from abfm.maps.surface_points import points_by_area
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray

BRACKETS = 10  # eigenfunctions whose brackets tell the side
_MEASURED_EIGENFUNCTIONS = 40  # eigenfunctions that these are measured by


class Spectra(NamedTuple):
    """Eigenvalues (K,), eigenfunctions (P, K) at P points, and brackets, of two surfaces A and B of
    unit area.
    """

    values: tuple[FloatArray, FloatArray]
    functions: tuple[FloatArray, FloatArray]
    brackets: tuple[FloatArray, FloatArray]

    @classmethod
    def of(cls, a: TriangleMesh, b: TriangleMesh, k: int, count: int) -> Spectra:
        """Take k eigenfunctions at so many points of A, evenly spread, and at some more of B: the
        same points of the same surface would make its map to itself better than it is.
        """
        (values_a, of_a), (values_b, of_b) = unit_eigenbasis(a, k), unit_eigenbasis(b, k)
        at_a = points_by_area(a, count).pull_back(of_a)
        at_b = points_by_area(b, count + count // 10).pull_back(of_b)
        return cls((values_a, values_b), (at_a, at_b), (_brackets(a, k), _brackets(b, k)))

    def thinned(self, by: int) -> Spectra:
        return self._replace(functions=(self.functions[0][::by], self.functions[1][::by]))

    def refined(self, C: FloatArray, sizes: Iterable[int]) -> FloatArray:
        """Refine a functional map through sizes; see `abfm.maps.functional_maps.refined`."""
        weights = np.full(len(self.functions[1]), 1 / len(self.functions[1]))
        return refined(*self.functions, weights, C, sizes)

    def defect(self, C: FloatArray) -> float:
        """Return how far a functional map (k, k) is from that of an isometry, which is orthogonal
        and commutes with the Laplacian: the sum of what is missing to either, relatively; 0 to
        about 2.
        """
        k = len(C)
        on_a, on_b = self.values[0][:k], self.values[1][:k]
        orthogonal = np.linalg.norm(C.T @ C - np.eye(k)) / np.sqrt(k)
        commuting = np.linalg.norm(C * (on_a - on_b[:, None])) / np.linalg.norm(on_a)
        return float(orthogonal + commuting)

    def side(self, C: FloatArray) -> float:
        """Return 1 for an isometry that keeps the side, -1 for one that turns the surface over, and
        what is between for other maps.

        Carrying the bracket ``<n, grad f x grad g>`` of two functions of A gives the bracket of the
        carried functions, or its opposite: this is the correlation of both.
        """
        count = self.brackets[0].shape[0]
        few, more = min(count, len(C)), min(self.brackets[0].shape[2], len(C))
        pairs = C[:few, :few]
        on_b = self.brackets[1][:few, :few, :more]
        of_carried = np.einsum("ki,lj,klq->ijq", pairs, pairs, on_b, optimize=True)
        carried = self.brackets[0][:few, :few, :more] @ C[:more, :more].T
        sizes = np.linalg.norm(of_carried) * np.linalg.norm(carried)
        return float((of_carried * carried).sum() / sizes) if sizes > 0 else 0.0


@per_mesh
def _brackets(mesh: TriangleMesh, k: int) -> FloatArray:
    """Return the coefficients (n, n, m) of the brackets of the first n of k eigenfunctions."""
    unit = mesh.normalized()
    functions = unit_eigenbasis(mesh, k)[1][:, :_MEASURED_EIGENFUNCTIONS]
    count = min(BRACKETS, k)
    slopes = (gradient(unit) @ functions[:, :count]).reshape(-1, 2, count)
    products = np.einsum("fi,fj->fij", slopes[:, 0], slopes[:, 1])
    brackets = products - products.transpose(0, 2, 1)
    at_faces = functions[unit.faces].mean(axis=1) * face_areas(unit)[:, None]
    return np.asarray(np.einsum("fij,fq->ijq", brackets, at_faces, optimize=True))
