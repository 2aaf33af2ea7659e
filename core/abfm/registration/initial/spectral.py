"""The initial map of two surfaces that are nearly isometric, by their eigenfunctions.

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
from abfm.registration.initial.descriptors import Hints, bending, map_of_descriptors
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.sign_search import candidates
from abfm.registration.initial.spectra import Spectra
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import step

# vertices of the meshes that a map is looked for on: coarser ones of larger meshes
VERTICES_MAX = 5000
VERTICES_MIN = 60  # vertices without which there are too few eigenfunctions
# eigenfunctions: in the end, to choose by, at first
_K = 120
_K_COMPARED = 40
_K_DESCRIBED = 20
# points of each surface to refine by, and to search by
_SAMPLES = 1200
_FEW_SAMPLES = 300
_REFINED_CANDIDATES = 24  # candidates that are refined and compared
_TURNS = 2  # of all vertices in the end
# Weights beside the defect of a map as an isometry: with these all of 22 pairs of bodies in
# different poses, 21 of different people, are mapped to the right one of nearly symmetric maps
_PER_SIDE = 0.2
_PER_BENDING = 0.5
_PER_LANDMARK = 5.0  # of the defect, for a distance of sqrt(area) between landmarks


class SpectralSearch:
    """Functional maps from A to B that are nearly isometries and agree with what is known.

    Distances along the surfaces count, not how they are bent. If a surface is nearly symmetric,
    several maps are nearly isometries: those that keep the side rank before others, which
    distinguishes left from right, and smaller differences of mean curvature before larger ones,
    which distinguishes front from back.

    Parameters
    ----------
    landmarks : Landmarks, optional
        One or two choose between maps, three or more give a start.
    functions : pair of (V_A,) or (V_A, C) and (V_B,) or (V_B, C) arrays, optional
        That have the same values at corresponding points.

    Attributes
    ----------
    maps : list of (k, k) arrays
        In the first eigenfunctions of the meshes, or of coarser ones.

    Raises
    ------
    AbfmError
        If a mesh has too few vertices, or functions do not fit.
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
        with step("searching a map by eigenfunctions") as done:
            coarse_a, coarse_b = self._coarse = _coarser(a, "A"), _coarser(b, "B")
            k = self._size = min(_K, len(coarse_a.vertices) // 3, len(coarse_b.vertices) // 3)
            spectra = self._spectra = Spectra.of(coarse_a, coarse_b, k, _SAMPLES)
            done(0.3)
            hints = _hints((a, b), (coarse_a, coarse_b), k, landmarks, functions)
            size = min(_K_COMPARED, k)
            places = points_by_area(coarse_a, _SAMPLES).positions[::2] / a.length_scale
            few = spectra.thinned(_SAMPLES // _FEW_SAMPLES)
            starts = [map_of_descriptors(coarse_a, coarse_b, hints, min(_K_DESCRIBED, k))]
            found = candidates(few, starts, _REFINED_CANDIDATES)
            done(0.7)
            bent = bending(coarse_a, size), bending(coarse_b, size)
            compared = self._compared = _Compared(spectra.thinned(2), hints, places, bent)
            self.maps = [
                compared.spectra.refined(C, [*range(len(C) + 2, size, 2), size]) for C in found
            ]

    def ranked(self, side: int) -> list[FloatArray]:
        """Return all maps (k, k), the one of least defect first; side is 1 or, for maps onto the
        mirror image, -1.
        """
        return sorted(self.maps, key=lambda C: self.defect(C, side))

    def defect(self, C: FloatArray, side: int) -> float:
        """Return how far a map is from an isometry, and from landmarks and functions."""
        return self._compared.defect(C, side)

    def side(self, C: FloatArray) -> float:
        """Return 1 for an isometry, -1 for one onto the mirror image, see `Spectra.side`."""
        return self._spectra.side(C)

    def nearest(self, C: FloatArray, on_a: FloatArray, on_b: FloatArray) -> IntArray:
        """Return the number of one of P places on A for each of Q on B, in space at unit area:
        where a map takes it.
        """
        rows = [
            project_onto_surface(mesh, places * fine.length_scale).pull_back(
                unit_eigenbasis(mesh, self._size)[1][:, : len(C)]
            )
            for mesh, fine, places in zip(self._coarse, self._meshes, (on_a, on_b), strict=True)
        ]
        return nearest_rows(C, *rows)

    def finished(self, C: FloatArray) -> tuple[PointMap, FloatArray]:
        """Refine a map by more eigenfunctions; return the points of it, and itself."""
        k, (coarse_a, coarse_b) = self._size, self._coarse
        C = self._spectra.refined(C, [*range(len(C) + 4, k, 4), k])
        bases = [unit_eigenbasis(mesh, k)[1] for mesh in (coarse_a, coarse_b)]
        C = refined(bases[0], bases[1], vertex_areas(coarse_b.normalized()), C, [k] * _TURNS)
        return _point_map(*self._meshes, coarse_a, coarse_b, C), C


class _Compared(NamedTuple):
    """What candidates are compared by."""

    spectra: Spectra
    hints: Hints
    places: FloatArray  # (P, 3), the points of the spectra on A, in sqrt(area)
    bent: tuple[FloatArray, FloatArray]  # coefficients (k,) of the mean curvature

    def defect(self, C: FloatArray, side: int) -> float:
        """Return how far a map is from what is wanted."""
        found = self.spectra.defect(C)
        found += _PER_SIDE * (1 - side * self.spectra.side(C))
        found += _PER_BENDING * _missed(C, *self.bent)
        if len(self.hints.places):
            rows = self.hints.at_landmarks[1][:, : len(C)]
            gaps = np.linalg.norm(self._images(C, rows) - self.hints.places, axis=1)
            found += _PER_LANDMARK * float(np.average(gaps, weights=self.hints.weights))
        return found + _missed(C, *self.hints.functions)

    def _images(self, C: FloatArray, rows: FloatArray) -> FloatArray:
        return self.places[nearest_rows(C, self.spectra.functions[0][:, : len(C)], rows)]


def _missed(C: FloatArray, of_a: FloatArray, of_b: FloatArray) -> float:
    """Return the norm of what functions of B differ by from the carried ones of A, over their own;
    0 where there are none.
    """
    off, size = C @ of_a[: len(C)] - of_b[: len(C)], np.linalg.norm(of_b[: len(C)])
    return float(np.linalg.norm(off) / size) if size > 0 else 0.0


def _coarser(mesh: TriangleMesh, which: str) -> TriangleMesh:
    """Return a mesh of the surface that is not too fine, or refuse one that is too coarse."""
    if len(mesh.vertices) < VERTICES_MIN:
        raise AbfmError(
            f"{which} has {len(mesh.vertices)} vertices; expected at least {VERTICES_MIN} for a "
            "map by "
            "eigenfunctions: give a finer mesh, or landmarks"
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
    """Say in eigenfunctions of the coarse meshes what is known."""
    bases = [unit_eigenbasis(mesh, k)[1] for mesh in coarse]
    places, weights = np.zeros((0, 3)), np.zeros(0)
    at = [np.zeros((0, k))] * 2
    if landmarks is not None:
        places = landmarks.a.positions / meshes[0].length_scale
        weights = landmarks.weights / landmarks.weights.mean()
        at = [
            project_onto_surface(mesh, points.positions).pull_back(basis)
            for mesh, basis, points in zip(coarse, bases, (landmarks.a, landmarks.b), strict=True)
        ]
    of = [np.zeros((k, 0))] * 2
    if functions is not None:
        rows = [
            channels(mesh, f, "a function").T for mesh, f in zip(meshes, functions, strict=True)
        ]
        if rows[0].shape[1] != rows[1].shape[1]:
            raise FunctionError(
                f"A has {rows[0].shape[1]} functions, B has {rows[1].shape[1]}; expected as many"
            )
        carried = [
            f if fine is mesh else project_onto_surface(fine, mesh.vertices).pull_back(f)
            for fine, mesh, f in zip(meshes, coarse, rows, strict=True)
        ]
        of = [spectral_coefficients(mesh, f, k) for mesh, f in zip(coarse, carried, strict=True)]
        size = np.sqrt(sum((f**2).sum(axis=0) for f in of) / 2)
        of = [f / np.where(size > 0, size, 1) for f in of]
    return Hints(places, (at[0], at[1]), weights, (of[0], of[1]))


def _point_map(
    a: TriangleMesh, b: TriangleMesh, coarse_a: TriangleMesh, coarse_b: TriangleMesh, C: FloatArray
) -> PointMap:
    """Return where the vertices of B go: those of a coarser mesh, then what is between."""
    found = point_map(coarse_a, coarse_b, C)
    if a is coarse_a and b is coarse_b:
        return found
    positions = found.positions
    if b is not coarse_b:
        positions = project_onto_surface(coarse_b, b.vertices).pull_back(positions)
    return PointMap.project(b, a, positions)
