"""Two surfaces laid on each other by a rotation or reflection, a scale and a shift, and the initial
map that takes each point of B to the closest one of A then.

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
Motion: TypeAlias = tuple[FloatArray, float, FloatArray]  # rotation, scale, shift
KINDS: tuple[MotionKind, ...] = get_args(MotionKind)

# points of each surface that starts are compared by, and refined by
_COMPARING_POINTS = 150
_REFINING_POINTS = 2100
_TURNS_MAX = 60  # of closest points and best motions
_SCREENING_ROUNDS = (0, 16), (8, 3)  # turns for each start, and how many of the best go on
_FITTED_SHARE = 0.8  # share of the pairs, those closest to each other, that a motion is fitted to
_GAIN_SHARE_MIN = 1e-5  # of the RMS distance: turns that gain less end
_DISTANCE_RATIO_MAX = 1.1  # times the least RMS distance
_DISTANCE_MIN = 1e-9  # RMS distance, in sqrt(area), below which nothing better is looked for
_ON_A_LINE = 1e-6  # width of landmarks, in sqrt(area), that leaves a rotation open


@dataclass(frozen=True, eq=False)
class Alignment:
    """What lays B on A: ``x -> scale * rotation x + shift``."""

    rotation: FloatArray  # (3, 3), orthogonal, with determinant -1 for a mirror image
    scale: float
    shift: FloatArray  # (3,), in A's units
    # of the distances of either surface from the other one afterwards, in sqrt(area) of A
    rms: float

    def __call__(self, points: FloatArray) -> FloatArray:
        """Move points (P, 3) in B's units to where they lie beside A, in A's."""
        return np.asarray(self.scale * points @ self.rotation.T + self.shift)


@dataclass(frozen=True, eq=False)
class _Closest:
    """Takes points of B to the closest ones of A, once they are aligned."""

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
    """Align B with A (see `align`); return the map to the closest points then, and the alignment.

    The distances of the map are those between the aligned surfaces, in A's units.
    """
    found = align(a, b, kind, landmarks)
    places = found(b.vertices)
    points = project_onto_surface(a, places)
    distances = points.distances_from(places)
    carried = _Closest(a, found)
    return PointMap(b, a, points.faces, points.barycentric, distances, carried), found


def align(
    a: TriangleMesh,
    b: TriangleMesh,
    kind: MotionKind = "similarity",
    landmarks: Landmarks | None = None,
) -> Alignment:
    """Find the motion that lays B nearest to A: ``rigid``, a ``similarity``, which may scale, or a
    ``mirror``, a similarity that turns B inside out.

    Three landmarks and more that lie on no line give the start. Else it is searched: both
    surfaces stand as they are, or their principal axes are laid on each other, and turned by the
    rotations of a cube and of an icosahedron. From every start turns of closest points, of either
    surface on the other one, and of the best motion for the nearest 80% of these pairs follow; the
    result is the one with the smallest RMS distance, or the one from where the surfaces stand if
    that comes within a tenth of it. Points are spread by area, so that triangles do not count.
    Landmarks weigh as much as all pairs together.

    Raises
    ------
    ParameterError
        If there is no such kind.
    """
    if kind not in KINDS:
        raise ParameterError(
            f"kind of alignment is {brief(kind)}; expected {', '.join(map(repr, KINDS))}"
        )
    with step("aligning the surfaces"):
        # A has unit area, and B, too, where it may be scaled
        sizes = a.length_scale, a.length_scale if kind == "rigid" else b.length_scale
        many = _Surfaces.of(a, b, kind, sizes, landmarks)
        if landmarks is not None and _fix_a_motion(landmarks):
            starts = [best_motion(*many.marks, kind)]
        else:
            starts = _starts(a, b, kind, sizes)
        motions, few = starts, many.thinned(_REFINING_POINTS // _COMPARING_POINTS)
        for turns, kept in _SCREENING_ROUNDS:
            motions = _best(few, motions, turns, kept)
        motion, least = min(
            (_refined(many, start, _TURNS_MAX) for start in motions), key=lambda found: found[1]
        )
        # as the surfaces stand, or landmarks lay them, if nothing is clearly better
        first, score = _refined(many, starts[0], _TURNS_MAX)
        if kind != "mirror" and score <= _DISTANCE_RATIO_MAX * least:
            motion = first
        rotation, scale, shift = motion
        rms = many.rms(many.distances(motion))
    return Alignment(rotation, scale * sizes[0] / sizes[1], shift * sizes[0], rms)


Pairs: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class _Surfaces(NamedTuple):
    """Points of both, spread by area, in units in which they are about as large."""

    kind: MotionKind
    on_a: ClosestPoints
    on_b: ClosestPoints
    a: FloatArray  # (P, 3)
    b: FloatArray  # (P, 3)
    marks: tuple[FloatArray, FloatArray, FloatArray]  # landmarks of B, of A, and their weights

    @classmethod
    def of(
        cls,
        a: TriangleMesh,
        b: TriangleMesh,
        kind: MotionKind,
        sizes: tuple[float, float],
        landmarks: Landmarks | None,
    ) -> _Surfaces:
        marks = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        if landmarks is not None:
            places = landmarks.b.positions / sizes[1], landmarks.a.positions / sizes[0]
            marks = *places, landmarks.weights / landmarks.weights.sum()
        unit_a, unit_b = (
            TriangleMesh(mesh.vertices / size, mesh.faces)
            for mesh, size in zip((a, b), sizes, strict=True)
        )
        return cls(
            kind,
            ClosestPoints(unit_a),
            ClosestPoints(unit_b),
            points_by_area(unit_a, _REFINING_POINTS).positions,
            points_by_area(unit_b, _REFINING_POINTS).positions,
            marks,
        )

    def thinned(self, by: int) -> _Surfaces:
        return self._replace(a=self.a[::by], b=self.b[::by])

    def distances(self, motion: Motion) -> Pairs:
        """Return pairs of a point of B (2P, 3) and of A (2P, 3), closest to each other after the
        motion: those closest to the points of B, then those of A; and the distances of both.
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
        """Return the root mean square of the distances of either surface from the other one."""
        return float(np.sqrt(np.mean(np.concatenate(pairs[2:]) ** 2)))

    def score(self, motion: Motion, pairs: Pairs) -> float:
        """Return the RMS distance of the surfaces and, weighing as much, of the landmarks."""
        rotation, scale, shift = motion
        of_b, of_a, weights = self.marks
        off = scale * of_b @ rotation.T + shift - of_a
        return float(np.sqrt(self.rms(pairs) ** 2 + weights @ (off**2).sum(axis=1)))

    def next_motion(self, pairs: Pairs) -> Motion:
        """Return the motion that brings the nearest pairs, and the landmarks, together."""
        b, a, *distances = pairs
        near = [gaps <= np.quantile(gaps, _FITTED_SHARE) for gaps in distances]
        chosen = np.concatenate(near)
        of_b, of_a, weights = self.marks
        return best_motion(
            np.concatenate([b[chosen], of_b]),
            np.concatenate([a[chosen], of_a]),
            np.concatenate([np.full(chosen.sum(), 1 / chosen.sum()), weights]),
            self.kind,
        )


def _best(surfaces: _Surfaces, motions: list[Motion], turns: int, kept: int) -> list[Motion]:
    """Refine motions by so many turns and return the best ones, or one alone that fits exactly."""
    found: list[tuple[Motion, float]] = []
    for motion in motions:
        checkpoint()
        found.append(_refined(surfaces, motion, turns))
        if found[-1][1] < _DISTANCE_MIN:
            return [found[-1][0]]
    return [motion for motion, _ in sorted(found, key=lambda each: each[1])[:kept]]


def _refined(surfaces: _Surfaces, motion: Motion, turns: int) -> tuple[Motion, float]:
    """Return the best motion of so many turns of closest points and best motions; its score."""
    pairs = surfaces.distances(motion)
    found, least = motion, surfaces.score(motion, pairs)
    for _ in range(turns):
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
    """Return the motion of a kind that takes points b (P, 3) nearest to a (P, 3), in weighted least
    squares [Umeyama 1991].
    """
    shares = (weights / weights.sum())[:, None]
    middle_b, middle_a = (shares * b).sum(axis=0), (shares * a).sum(axis=0)
    x, y = b - middle_b, a - middle_a
    left, values, right = np.linalg.svd((shares * y).T @ x)
    side = np.linalg.det(left) * np.linalg.det(right)
    signs = np.array([1.0, 1.0, np.sign(side) * (-1 if kind == "mirror" else 1)])
    rotation = (left * signs) @ right
    spread = float((shares * x**2).sum())
    scale = float(values @ signs) / spread if kind != "rigid" and spread > 0 else 1.0
    # nothing is to vanish, whatever the pairs of a bad start are
    scale = max(scale, 0.1) if kind != "rigid" else 1.0
    return rotation, scale, middle_a - scale * rotation @ middle_b


def _starts(
    a: TriangleMesh, b: TriangleMesh, kind: MotionKind, sizes: tuple[float, float]
) -> list[Motion]:
    """Return motions that lay the centroids on each other: as the surfaces stand, which is first
    where several fit as well, and the principal axes, turned.
    """
    (middle_a, axes_a), (middle_b, axes_b) = principal_axes(a), principal_axes(b)
    wanted = -1 if kind == "mirror" else 1
    side = wanted * np.linalg.det(axes_a) * np.linalg.det(axes_b)
    axes_b = axes_b * [[np.sign(side)], [1], [1]]
    groups = Rotation.create_group("T"), Rotation.create_group("O"), Rotation.create_group("I")
    turns = np.concatenate([group.as_matrix() for group in groups])
    first = np.sort(np.unique(np.round(turns, 6), axis=0, return_index=True)[1])
    rotations = [axes_a.T @ turn @ axes_b for turn in turns[first]]
    if kind != "mirror":
        rotations.insert(0, np.eye(3))
    middle_a, middle_b = middle_a / sizes[0], middle_b / sizes[1]
    return [(rotation, 1.0, middle_a - rotation @ middle_b) for rotation in rotations]


def _fix_a_motion(landmarks: Landmarks) -> bool:
    """Whether the landmarks lie on no line, on either surface."""
    for points in (landmarks.a, landmarks.b):
        places = points.positions - points.positions.mean(axis=0)
        widths = np.linalg.svd(places, compute_uv=False)
        if len(places) < 3 or widths[1] <= _ON_A_LINE * points.mesh.length_scale:
            return False
    return True
