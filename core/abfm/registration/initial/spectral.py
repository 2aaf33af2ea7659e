"""Initial maps between nearly isometric surfaces, by their eigenfunctions.

References
----------
Ovsjanikov, Ben-Chen, Solomon, Butscher, Guibas: Functional Maps, ACM TOG 31(4), 2012.
Nogneng, Ovsjanikov: Informative Descriptor Preservation via Commutativity for Shape Matching, CGF
36(2), 2017.
Ren, Poulenard, Wonka, Ovsjanikov: Continuous and Orientation-preserving Correspondences via
Functional Maps, ACM TOG 37(6), 2018.
Melzi, Ren, Rodolà, Sharma, Wonka, Ovsjanikov: ZoomOut, ACM TOG 38(6), 2019.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.calculus.eigenbasis import unit_eigenbasis
from abfm.calculus.operators import vertex_areas
from abfm.errors import AbfmError, FunctionError
from abfm.maps.functional_maps import nearest_rows, point_map, refined, spectral_coefficients
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import points_by_area, project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import coarsened
from abfm.registration.initial.descriptors import Hints, curvature_coefficients, map_of_descriptors
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.sign_search import candidates
from abfm.registration.initial.spectra import Spectra
from abfm.types import FloatArray, IntArray
from abfm.wording import counted
from abfm.workers.progress import step

VERTICES_MAX = 5000  # larger meshes are coarsened for the search
VERTICES_MIN = 60  # smaller meshes have too few eigenfunctions
_K_FINAL = 120  # eigenfunctions of the final map
_K_COMPARED = 40  # eigenfunctions for the comparison of candidates
_K_DESCRIBED = 20  # eigenfunctions of the map by descriptors
_REFINING_SAMPLES = 1200  # points of each surface for the refinement
_SEARCH_SAMPLES = 300  # points of each surface for the search
_REFINED_CANDIDATES = 24  # candidates that are refined and compared
_FINAL_ITERATIONS = 2  # iterations with all vertices
# Weights relative to the defect of a map as an isometry. With them, the correct one of nearly
# symmetric maps was chosen for all of 22 pairs of bodies in different poses. In 21 of these pairs,
# the bodies are of different people.
_SIDE_WEIGHT = 0.2
_BENDING_WEIGHT = 0.5
_LANDMARK_WEIGHT = 5.0  # weight of a landmark error of sqrt(area)


class SpectralSearch:
    """Functional maps from A to B that are nearly isometries and agree with given data.

    The search compares distances along the surfaces, not their bending. If a surface is nearly
    symmetric, several maps are nearly isometries. Maps that preserve the orientation rank first,
    which distinguishes left from right. Maps with smaller differences of mean curvature rank first,
    which distinguishes front from back.

    One or two ``landmarks`` help to choose between maps; three or more also determine a start of
    the search. ``functions``, (V_A,) or (V_A, C) and (V_B,) or (V_B, C), have equal values at
    corresponding points. The attribute ``maps`` has functional maps (k, k) in the first
    eigenfunctions of the meshes, or of coarser meshes. Raises AbfmError if a mesh has too few
    vertices, or a function does not fit its mesh.
    """

    maps: list[FloatArray]

    def __init__(
        self,
        a: TriangleMesh,
        b: TriangleMesh,
        landmarks: Landmarks | None = None,
        functions: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        self._meshes = a, b
        with step("searching for a map by eigenfunctions") as done:
            coarse_a, coarse_b = self._coarse = _coarser(a, "A"), _coarser(b, "B")
            k = self._size = min(_K_FINAL, len(coarse_a.vertices) // 3, len(coarse_b.vertices) // 3)
            spectra = self._spectra = Spectra.of(coarse_a, coarse_b, k, _REFINING_SAMPLES)
            done(0.3)
            hints = _hints((a, b), (coarse_a, coarse_b), k, landmarks, functions)
            size = min(_K_COMPARED, k)
            places = points_by_area(coarse_a, _REFINING_SAMPLES).positions[::2] / a.length_scale
            few = spectra.thinned(_REFINING_SAMPLES // _SEARCH_SAMPLES)
            starts = [map_of_descriptors(coarse_a, coarse_b, hints, min(_K_DESCRIBED, k))]
            found = candidates(few, starts, _REFINED_CANDIDATES)
            done(0.7)
            of_a, of_b = (curvature_coefficients(mesh, size) for mesh in (coarse_a, coarse_b))
            criteria = _Criteria(spectra.thinned(2), hints, places, (of_a, of_b))
            refined = criteria.spectra.refined
            self._criteria = criteria
            self.maps = [refined(C, [*range(len(C) + 2, size, 2), size]) for C in found]

    def ranked(self, side: int) -> list[FloatArray]:
        """Return `maps` by ascending `defect`; ``side`` is 1, or -1 for the mirror image of A."""
        return sorted(self.maps, key=lambda C: self.defect(C, side))

    def defect(self, C: FloatArray, side: int) -> float:
        """Return the sum of the errors of a map: as an isometry, at landmarks and of functions."""
        return self._criteria.defect(C, side)

    def side(self, C: FloatArray) -> float:
        """Return 1 for an isometry and -1 for one onto the mirror image, see `Spectra.side`."""
        return self._spectra.side(C)

    def nearest(self, C: FloatArray, on_a: FloatArray, on_b: FloatArray) -> IntArray:
        """Return the index of the point of A, (Q,), for each point of B by a functional map.

        The points are positions on A, (P, 3), and on B, (Q, 3), scaled to unit area.
        """
        rows = []
        for mesh, fine, places in zip(self._coarse, self._meshes, (on_a, on_b), strict=True):
            points = project_onto_surface(mesh, places * fine.length_scale)
            rows.append(points.pull_back(unit_eigenbasis(mesh, self._size)[1][:, : len(C)]))
        return nearest_rows(C, *rows)

    def finished(self, C: FloatArray) -> tuple[PointMap, FloatArray]:
        """Refine a map with all eigenfunctions; return the point map and the functional map."""
        k, (coarse_a, coarse_b) = self._size, self._coarse
        C = self._spectra.refined(C, [*range(len(C) + 4, k, 4), k])
        bases = [unit_eigenbasis(mesh, k)[1] for mesh in (coarse_a, coarse_b)]
        C = refined(
            bases[0], bases[1], vertex_areas(coarse_b.normalized()), C, [k] * _FINAL_ITERATIONS
        )
        return _point_map(*self._meshes, coarse_a, coarse_b, C), C


class _Criteria(NamedTuple):
    """Data and criteria for the comparison of functional maps."""

    spectra: Spectra
    hints: Hints
    places: FloatArray  # (P, 3), the points of the spectra on A, in sqrt(area)
    curvatures: tuple[FloatArray, FloatArray]  # coefficients (k,) of the mean curvature

    def defect(self, C: FloatArray, side: int) -> float:
        found = self.spectra.defect(C)
        found += _SIDE_WEIGHT * (1 - side * self.spectra.side(C))
        found += _BENDING_WEIGHT * _relative_error(C, *self.curvatures)
        if len(self.hints.places):
            rows = self.hints.at_landmarks[1][:, : len(C)]
            gaps = np.linalg.norm(self._images(C, rows) - self.hints.places, axis=1)
            found += _LANDMARK_WEIGHT * float(np.average(gaps, weights=self.hints.weights))
        return found + _relative_error(C, *self.hints.functions)

    def _images(self, C: FloatArray, rows: FloatArray) -> FloatArray:
        return self.places[nearest_rows(C, self.spectra.functions[0][:, : len(C)], rows)]


def _relative_error(C: FloatArray, of_a: FloatArray, of_b: FloatArray) -> float:
    """Return the relative error of functions of A, transferred to B; 0 without functions.

    The functions are given by their coefficients.
    """
    off, size = C @ of_a[: len(C)] - of_b[: len(C)], np.linalg.norm(of_b[: len(C)])
    return float(np.linalg.norm(off) / size) if size > 0 else 0.0


def _coarser(mesh: TriangleMesh, which: str) -> TriangleMesh:
    """Return a mesh, coarsened if it is too fine for the search; AbfmError if it is too coarse."""
    if len(mesh.vertices) < VERTICES_MIN:
        raise AbfmError(
            f"{which} has {len(mesh.vertices)} vertices; a map by eigenfunctions needs at least "
            f"{VERTICES_MIN}. Use a finer mesh, or landmarks"
        )
    if len(mesh.vertices) <= 1.5 * VERTICES_MAX:
        return mesh
    return coarsened(mesh, VERTICES_MAX) or mesh


def _hints(
    meshes: tuple[TriangleMesh, TriangleMesh],
    coarse: tuple[TriangleMesh, TriangleMesh],
    k: int,
    landmarks: Landmarks | None,
    functions: tuple[ArrayLike, ArrayLike] | None,
) -> Hints:
    bases = [unit_eigenbasis(mesh, k)[1] for mesh in coarse]
    places, weights = np.zeros((0, 3)), np.zeros(0)
    at = [np.zeros((0, k))] * 2
    if landmarks is not None:
        places = landmarks.a.positions / meshes[0].length_scale
        weights = landmarks.weights / landmarks.weights.mean()
        sides = zip(coarse, bases, (landmarks.a, landmarks.b), strict=True)
        at = [project_onto_surface(mesh, p.positions).pull_back(basis) for mesh, basis, p in sides]
    of = [np.zeros((k, 0))] * 2
    if functions is not None:
        rows = [
            channels(mesh, f, "a function").T for mesh, f in zip(meshes, functions, strict=True)
        ]
        if rows[0].shape[1] != rows[1].shape[1]:
            raise FunctionError(
                f"A has {counted(rows[0].shape[1], 'function')} and B has {rows[1].shape[1]}; "
                "expected equal numbers"
            )
        on_coarse = [
            f if fine is mesh else project_onto_surface(fine, mesh.vertices).pull_back(f)
            for fine, mesh, f in zip(meshes, coarse, rows, strict=True)
        ]
        of = [spectral_coefficients(mesh, f, k) for mesh, f in zip(coarse, on_coarse, strict=True)]
        size = np.sqrt(sum((f**2).sum(axis=0) for f in of) / 2)
        of = [f / np.where(size > 0, size, 1) for f in of]
    return Hints(places, (at[0], at[1]), weights, (of[0], of[1]))


def _point_map(
    a: TriangleMesh, b: TriangleMesh, coarse_a: TriangleMesh, coarse_b: TriangleMesh, C: FloatArray
) -> PointMap:
    """Return the point map from B to A of a functional map C between their coarser meshes."""
    found = point_map(coarse_a, coarse_b, C)
    if a is coarse_a and b is coarse_b:
        return found
    positions = found.positions
    if b is not coarse_b:
        positions = project_onto_surface(coarse_b, b.vertices).pull_back(positions)
    return PointMap.project(b, a, positions)
