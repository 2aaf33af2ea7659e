"""Spectra of two surfaces, and measures of how isometric a functional map is."""

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

BRACKETS = 10  # eigenfunctions whose brackets decide between a map and a mirrored one
_BRACKET_COEFFICIENTS = 40  # eigenfunctions in which brackets are expanded


class Spectra(NamedTuple):
    """Spectra of surfaces A and B, both scaled to unit area; each field is a pair, for A and B."""

    values: tuple[FloatArray, FloatArray]  # (K,), eigenvalues
    functions: tuple[FloatArray, FloatArray]  # (P, K), eigenfunctions at P points
    brackets: tuple[FloatArray, FloatArray]  # (n, n, m), coefficients, see `side`

    @classmethod
    def of(cls, a: TriangleMesh, b: TriangleMesh, k: int, count: int) -> Spectra:
        """Evaluate k eigenfunctions at ``count`` evenly spread points of A and 10% more of B.

        Different points are needed: with the same points on the same surface, its map to itself
        would seem more accurate than it is.
        """
        (values_a, of_a), (values_b, of_b) = unit_eigenbasis(a, k), unit_eigenbasis(b, k)
        at_a = points_by_area(a, count).pull_back(of_a)
        at_b = points_by_area(b, count + count // 10).pull_back(of_b)
        return cls((values_a, values_b), (at_a, at_b), (_brackets(a, k), _brackets(b, k)))

    def thinned(self, by: int) -> Spectra:
        return self._replace(functions=(self.functions[0][::by], self.functions[1][::by]))

    def refined(self, C: FloatArray, sizes: Iterable[int]) -> FloatArray:
        """Refine a functional map at each of ``sizes``, see `abfm.maps.functional_maps.refined`."""
        weights = np.full(len(self.functions[1]), 1 / len(self.functions[1]))
        return refined(*self.functions, weights, C, sizes)

    def defect(self, C: FloatArray) -> float:
        """Return the defect of a functional map (k, k) as an isometry, 0 to about 2.

        The map of an isometry is orthogonal and commutes with the Laplacian. The defect is the sum
        of the relative deviations from both properties.
        """
        k = len(C)
        on_a, on_b = self.values[0][:k], self.values[1][:k]
        orthogonal = np.linalg.norm(C.T @ C - np.eye(k)) / np.sqrt(k)
        commuting = np.linalg.norm(C * (on_a - on_b[:, None])) / np.linalg.norm(on_a)
        return float(orthogonal + commuting)

    def side(self, C: FloatArray) -> float:
        """Return 1 for an isometry that preserves the orientation, and -1 for one that reverses it.

        Other maps have values between. An isometry transfers the bracket ``<n, grad f x grad g>``
        of two functions of A to the bracket of the transferred functions, or to its negative. The
        result is the correlation of transferred brackets with brackets of transferred functions.
        """
        count = self.brackets[0].shape[0]
        few, more = min(count, len(C)), min(self.brackets[0].shape[2], len(C))
        pairs = C[:few, :few]
        on_b = self.brackets[1][:few, :few, :more]
        of_transferred = np.einsum("ki,lj,klq->ijq", pairs, pairs, on_b, optimize=True)
        transferred = self.brackets[0][:few, :few, :more] @ C[:more, :more].T
        sizes = np.linalg.norm(of_transferred) * np.linalg.norm(transferred)
        return float((of_transferred * transferred).sum() / sizes) if sizes > 0 else 0.0


@per_mesh
def _brackets(mesh: TriangleMesh, k: int) -> FloatArray:
    """Return the coefficients (n, n, m) of brackets of n eigenfunctions, see `Spectra.side`."""
    unit = mesh.normalized()
    functions = unit_eigenbasis(mesh, k)[1][:, :_BRACKET_COEFFICIENTS]
    count = min(BRACKETS, k)
    slopes = (gradient(unit) @ functions[:, :count]).reshape(-1, 2, count)
    products = np.einsum("fi,fj->fij", slopes[:, 0], slopes[:, 1])
    brackets = products - products.transpose(0, 2, 1)
    at_faces = functions[unit.faces].mean(axis=1) * face_areas(unit)[:, None]
    return np.asarray(np.einsum("fij,fq->ijq", brackets, at_faces, optimize=True))
