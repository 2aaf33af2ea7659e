"""Alignment of two surfaces in space, and the initial map to the closest points afterwards.

References
----------
Besl, McKay: A Method for Registration of 3-D Shapes, IEEE PAMI 14(2), 1992.
Umeyama: Least-Squares Estimation of Transformation Parameters Between Two Point Patterns, IEEE PAMI
13(4), 1991.
Chetverikov, Stepanov, Krsek: Robust Euclidean Alignment of 3D Point Sets: the Trimmed Iterative
Closest Point Algorithm, Image and Vision Computing 23(3), 2005.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from abfm.errors import ParameterError, brief
from abfm.maps.point_maps import PointMap
from abfm.maps.surface_points import (
    ClosestPoints,
    SurfacePoints,
    points_by_area,
    project_onto_surface,
)
from abfm.maps.symmetry import principal_axes
from abfm.mesh import TriangleMesh
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.types import FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

MotionKind = Literal["similarity", "rigid", "mirror"]
Motion: TypeAlias = tuple[FloatArray, float, FloatArray]  # rotation, scale, translation
KINDS: tuple[MotionKind, ...] = get_args(MotionKind)

_SCREENING_POINTS = 150  # points of each surface for the comparison of starts
_REFINING_POINTS = 2100  # points of each surface for the refinement
_ITERATIONS_MAX = 60  # each iteration finds closest points and then the best motion
_SCREENING_ROUNDS = (0, 16), (8, 3)  # iterations for each start, and number of starts that remain
_FITTED_SHARE = 0.8  # share of the pairs, the closest ones, that a motion is fitted to
_GAIN_SHARE_MIN = 1e-5  # iterations stop if the RMS distance falls by a smaller share
_DISTANCE_RATIO_MAX = 1.1  # the first start is preferred up to this multiple of the least distance
_DISTANCE_MIN = 1e-9  # RMS distance in sqrt(area) at which the search stops
_LANDMARK_WIDTH_MIN = 1e-6  # landmarks within this width, in sqrt(area), lie on a line


@dataclass(frozen=True, eq=False)
class Alignment:
    """The motion ``x -> scale * rotation x + shift`` that aligns B with A."""

    rotation: FloatArray  # (3, 3), orthogonal, with determinant -1 for a mirror image
    scale: float
    shift: FloatArray  # (3,), translation in A's units
    rms: float  # RMS distance between the aligned surfaces, in sqrt(area) of A

    def __call__(self, points: FloatArray) -> FloatArray:
        """Move points (P, 3) from B's position and units to A's."""
        return np.asarray(self.scale * points @ self.rotation.T + self.shift)


@dataclass(frozen=True, eq=False)
class _Closest:
    """The map from points of B to the closest points of A after alignment."""

    a: TriangleMesh
    alignment: Alignment

    def __call__(self, points: SurfacePoints) -> SurfacePoints:
        return project_onto_surface(self.a, self.alignment(points.positions))


def closest_after_alignment(
    a: TriangleMesh,
    b: TriangleMesh,
    kind: MotionKind = "similarity",
    landmarks: Landmarks | None = None,
) -> tuple[PointMap, Alignment]:
    """Align B with A; return the map of B to the closest points of A, and the alignment.

    The ``distances`` of the map are those after the alignment (see `align`), in A's units.
    """
    found = align(a, b, kind, landmarks)
    positions = found(b.vertices)
    points = project_onto_surface(a, positions)
    distances = points.distances_from(positions)
    interior_map = _Closest(a, found)
    return PointMap(b, a, points.faces, points.barycentric, distances, interior_map), found


def align(
    a: TriangleMesh,
    b: TriangleMesh,
    kind: MotionKind = "similarity",
    landmarks: Landmarks | None = None,
) -> Alignment:
    """Find the motion that brings B closest to A.

    The kind is ``rigid``, ``similarity`` (with a scale), or ``mirror`` (a similarity with a
    reflection); raises ParameterError for any other. Three or more landmarks that do not lie on a
    line determine the first motion. Otherwise several motions are tried, which align the centroids.
    One has no rotation. The others align the principal axes, and rotate by the symmetry groups of a
    tetrahedron, a cube and an icosahedron.

    Each motion is refined by iterations. They find the closest points of each surface on the other
    one, and then the best motion for the closest 80% of these pairs. Landmarks weigh as much as all
    pairs together. Points are sampled evenly by area, so the triangulation has no influence.

    The result has the smallest RMS distance. The refined first motion is preferred if its RMS
    distance is at most 10% larger, except for ``mirror``.
    """
    if kind not in KINDS:
        raise ParameterError(
            f"kind of alignment is {brief(kind)}; expected one of {', '.join(map(repr, KINDS))}"
        )
    with step("aligning the surfaces"):
        # A is scaled to unit area, and B also if the motion has a scale
        sizes = a.length_scale, a.length_scale if kind == "rigid" else b.length_scale
        many = _Surfaces.of(a, b, kind, sizes, landmarks)
        if landmarks is not None and _determine_a_motion(landmarks):
            starts = [best_motion(*many.landmarks, kind)]
        else:
            starts = _starts(a, b, kind, sizes)
        motions, few = starts, many.thinned(_REFINING_POINTS // _SCREENING_POINTS)
        for iterations, count in _SCREENING_ROUNDS:
            motions = _best(few, motions, iterations, count)
        motion, least = min(
            (_refined(many, start, _ITERATIONS_MAX) for start in motions),
            key=lambda found: found[1],
        )
        # the first start is preferred unless another one is clearly better
        first, score = _refined(many, starts[0], _ITERATIONS_MAX)
        if kind != "mirror" and score <= _DISTANCE_RATIO_MAX * least:
            motion = first
        rotation, scale, shift = motion
        rms = many.rms(many.distances(motion))
    return Alignment(rotation, scale * sizes[0] / sizes[1], shift * sizes[0], rms)


Pairs: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class _Surfaces(NamedTuple):
    """Points sampled evenly by area on both surfaces, in units that give both a similar size."""

    kind: MotionKind
    on_a: ClosestPoints
    on_b: ClosestPoints
    a: FloatArray  # (P, 3), points of A
    b: FloatArray  # (P, 3), points of B
    landmarks: tuple[FloatArray, FloatArray, FloatArray]  # points of B, of A, and their weights

    @classmethod
    def of(
        cls,
        a: TriangleMesh,
        b: TriangleMesh,
        kind: MotionKind,
        sizes: tuple[float, float],
        landmarks: Landmarks | None,
    ) -> _Surfaces:
        pairs = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        if landmarks is not None:
            positions = landmarks.b.positions / sizes[1], landmarks.a.positions / sizes[0]
            pairs = *positions, landmarks.weights / landmarks.weights.sum()
        sides = zip((a, b), sizes, strict=True)
        unit_a, unit_b = (TriangleMesh(mesh.vertices / size, mesh.faces) for mesh, size in sides)
        on_a, on_b = (points_by_area(unit, _REFINING_POINTS).positions for unit in (unit_a, unit_b))
        return cls(kind, ClosestPoints(unit_a), ClosestPoints(unit_b), on_a, on_b, pairs)

    def thinned(self, by: int) -> _Surfaces:
        return self._replace(a=self.a[::by], b=self.b[::by])

    def distances(self, motion: Motion) -> Pairs:
        """Return pairs of closest points, of B and of A, (2P, 3) each, after a motion of B.

        In the first P pairs, the point of A is the one closest to a sample of B. In the others, the
        point of B is the one closest to a sample of A. Also return both distances, (P,) each.
        """
        rotation, scale, shift = motion
        moved = scale * self.b @ rotation.T + shift
        on_a = self.on_a.to(moved)
        back = (self.a - shift) @ rotation / scale
        on_b = self.on_b.to(back)
        b = np.concatenate([self.b, on_b.positions])
        a = np.concatenate([on_a.positions, self.a])
        return b, a, on_a.distances_from(moved), scale * on_b.distances_from(back)

    def rms(self, pairs: Pairs) -> float:
        return float(np.sqrt(np.mean(np.concatenate(pairs[2:]) ** 2)))

    def score(self, motion: Motion, pairs: Pairs) -> float:
        """Return the RMS distance of surfaces and landmarks after a motion, with equal weights."""
        rotation, scale, shift = motion
        of_b, of_a, weights = self.landmarks
        off = scale * of_b @ rotation.T + shift - of_a
        return float(np.sqrt(self.rms(pairs) ** 2 + weights @ (off**2).sum(axis=1)))

    def next_motion(self, pairs: Pairs) -> Motion:
        b, a, *distances = pairs
        are_close = [gaps <= np.quantile(gaps, _FITTED_SHARE) for gaps in distances]
        chosen = np.concatenate(are_close)
        of_b, of_a, weights = self.landmarks
        shares = np.concatenate([np.full(chosen.sum(), 1 / chosen.sum()), weights])
        ends = np.concatenate([b[chosen], of_b]), np.concatenate([a[chosen], of_a])
        return best_motion(*ends, shares, self.kind)


def _best(surfaces: _Surfaces, motions: list[Motion], iterations: int, count: int) -> list[Motion]:
    """Refine motions; return the ``count`` best ones, or only one if it fits nearly exactly."""
    found: list[tuple[Motion, float]] = []
    for motion in motions:
        checkpoint()
        found.append(_refined(surfaces, motion, iterations))
        if found[-1][1] < _DISTANCE_MIN:
            return [found[-1][0]]
    return [motion for motion, _ in sorted(found, key=lambda each: each[1])[:count]]


def _refined(surfaces: _Surfaces, motion: Motion, iterations: int) -> tuple[Motion, float]:
    """Refine a motion by iterative closest points; return the best motion and its `score`."""
    pairs = surfaces.distances(motion)
    found, least = motion, surfaces.score(motion, pairs)
    for _ in range(iterations):
        checkpoint()
        motion = surfaces.next_motion(pairs)
        pairs = surfaces.distances(motion)
        score = surfaces.score(motion, pairs)
        gained = least - score
        if gained > 0:
            found, least = motion, score
        if gained <= _GAIN_SHARE_MIN * least:
            break
    return found, least


def best_motion(b: FloatArray, a: FloatArray, weights: FloatArray, kind: MotionKind) -> Motion:
    """Return the weighted least-squares motion of points b onto a, (P, 3) [Umeyama 1991]."""
    shares = (weights / weights.sum())[:, None]
    middle_b, middle_a = (shares * b).sum(axis=0), (shares * a).sum(axis=0)
    x, y = b - middle_b, a - middle_a
    left, values, right = np.linalg.svd((shares * y).T @ x)
    side = np.linalg.det(left) * np.linalg.det(right)
    signs = np.array([1.0, 1.0, np.sign(side) * (-1 if kind == "mirror" else 1)])
    rotation = (left * signs) @ right
    spread = float((shares * x**2).sum())
    scale = float(values @ signs) / spread if kind != "rigid" and spread > 0 else 1.0
    # pairs of points of a bad start must not shrink the surface to a point
    scale = max(scale, 0.1) if kind != "rigid" else 1.0
    return rotation, scale, middle_a - scale * rotation @ middle_b


def _starts(
    a: TriangleMesh, b: TriangleMesh, kind: MotionKind, sizes: tuple[float, float]
) -> list[Motion]:
    """Return the motions that `align` tries first; all of them align the centroids."""
    (middle_a, axes_a), (middle_b, axes_b) = principal_axes(a), principal_axes(b)
    expected_side = -1 if kind == "mirror" else 1
    side = expected_side * np.linalg.det(axes_a) * np.linalg.det(axes_b)
    axes_b = axes_b * [[np.sign(side)], [1], [1]]
    groups = Rotation.create_group("T"), Rotation.create_group("O"), Rotation.create_group("I")
    elements = np.concatenate([group.as_matrix() for group in groups])
    first = np.sort(np.unique(np.round(elements, 6), axis=0, return_index=True)[1])
    rotations = [axes_a.T @ element @ axes_b for element in elements[first]]
    if kind != "mirror":
        rotations.insert(0, np.eye(3))
    middle_a, middle_b = middle_a / sizes[0], middle_b / sizes[1]
    return [(rotation, 1.0, middle_a - rotation @ middle_b) for rotation in rotations]


def _determine_a_motion(landmarks: Landmarks) -> bool:
    """Return whether there are three or more landmarks that do not lie on a line."""
    for points in (landmarks.a, landmarks.b):
        offsets = points.positions - points.positions.mean(axis=0)
        widths = np.linalg.svd(offsets, compute_uv=False)
        if len(offsets) < 3 or widths[1] <= _LANDMARK_WIDTH_MIN * points.mesh.length_scale:
            return False
    return True
