"""What maps do to lengths, areas, angles and sides of faces, and which part they turn over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_areas, face_normals, hat_gradients
from abfm.errors import AbfmError
from abfm.maps.surface_points import SurfacePoints, finite_points, project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.types import BoolArray, FloatArray, IntArray

BOUNDED_SHARE = 0.99
"""Share of the faces that keep a bound: single ones, as at the ends of creases, may exceed it."""
CUT_FACES_MAX = 2048  # faces that are looked at closely, unless said
_PARTS = 8  # along each side
# Share of a face's parts beyond which it is folded: of slivers along a bent surface about half look
# turned over, in 36 of 38 maps of flows never more than this; of folded faces nearly all.
_TURNED_SHARE_MIN = 0.75
_INWARD_SHARE = 1e-6  # of the way to the centre, so that no point lies on two faces
# of its size before: a part that has less area now has collapsed, not turned over
_AREA_ROUNDING = 1e-12
_COLLAPSED_AREA_MAX = 1e-9  # of a face's area: less is left by rounding
_CHUNK = 4096  # faces that are cut at once, 184,320 points
_STRETCH_MIN = 1e-6  # of a stretch: logarithms of less are those of this
# A triangle between mapped corners says little where it is stretched this much and the surface's
# normals at its corners have a mean this short: they are about 30 degrees apart
_LONG_STRETCH = 2.0
_BENT_NORMAL_LENGTH = 0.95
SurfaceMap = Callable[[SurfacePoints], SurfacePoints]


class Log2Statistics(NamedTuple):
    """The absolute value of a logarithm to base 2 over a surface, by area."""

    mean: float
    p95: float  # percentiles
    p98: float
    maximum: float

    def report(self) -> str:
        """Return the numbers in a few words."""
        return (
            f"mean {self.mean:.3f}, 95% {self.p95:.2f}, 98% {self.p98:.2f}, most {self.maximum:.2f}"
        )


class Bound(NamedTuple):
    """How a map keeps a bound of ``|log2 J|`` and ``|log2 R|``."""

    max_distortion: float
    share: float  # of the faces, 0 to 1, that are within it
    largest: float  # what 99% of the faces are within
    folded: int  # faces

    @classmethod
    def of(cls, numbers: ArrayLike) -> Bound:
        """Return the bound of four numbers, as files hold them."""
        most, share, largest, folded = np.asarray(numbers).tolist()
        return cls(most, share, largest, int(folded))

    @property
    def is_kept(self) -> bool:
        """Return whether 99% of the faces are within the bound, and none is folded."""
        return self.share >= BOUNDED_SHARE and not self.folded


@dataclass(frozen=True, eq=False, repr=False)
class Distortion:
    """What a map does to each of F faces; see `chord_distortion` and `PointMap.distortion`."""

    singular_values: FloatArray  # (F, 2), largest and smallest stretch ``s_1 >= s_2 >= 0``
    area: FloatArray  # (F,), ``J = s_1 s_2``: mapped area over area
    conformal: FloatArray  # (F,), ``R = s_1 / s_2 >= 1``; inf where a face collapses
    # (F,), True where the mapped face looks against the surface that it landed on
    flipped: BoolArray
    weights: FloatArray  # (F,), the faces' own areas

    @property
    def folded(self) -> int:
        """The number of flipped faces."""
        return int(self.flipped.sum())

    @property
    def collapsed(self) -> int:
        """The number of faces that are mapped to a line or a point."""
        return int((self.area <= _COLLAPSED_AREA_MAX).sum())

    @property
    def log2_area(self) -> Log2Statistics:
        """``|log2 J|``, as HCP's and MSM's pipelines tell how much areas change."""
        return self._log2(self.area)

    @property
    def log2_shape(self) -> Log2Statistics:
        """``|log2 R|``, as they tell how much shapes change."""
        return self._log2(self.conformal)

    def share_within(self, most: float) -> float:
        """Return the share of the faces, 0 to 1, with neither ``|log2 J|`` nor ``|log2 R|`` above
        ``most``.
        """
        logs = np.log2(np.clip([self.area, self.conformal], _STRETCH_MIN, 1 / _STRETCH_MIN))
        return float((np.abs(logs) <= most).all(axis=0).mean())

    def bound_of(self, share: float) -> float:
        """Return the least ``most`` that this share of the faces keeps, see `share_within`."""
        logs = np.log2(np.clip([self.area, self.conformal], _STRETCH_MIN, 1 / _STRETCH_MIN))
        largest = np.sort(np.abs(logs).max(axis=0))
        return float(largest[max(int(np.ceil(share * len(largest))), 1) - 1])

    def bound(self, most: float) -> Bound:
        """Return how a bound of ``|log2 J|`` and ``|log2 R|`` is kept."""
        return Bound(most, self.share_within(most), self.bound_of(BOUNDED_SHARE), self.folded)

    def scaled(self, factor: float) -> Distortion:
        """Return it with all stretches times a factor, as of surfaces in other units of length."""
        values = factor * self.singular_values
        return Distortion(values, factor**2 * self.area, self.conformal, self.flipped, self.weights)

    def report(self) -> str:
        """Return the numbers in a line."""
        return (
            f"|log2 J| of areas: {self.log2_area.report()}; |log2 R| of shapes: "
            f"{self.log2_shape.report()}; folded faces: {self.folded} of {len(self.area)}"
        )

    def _log2(self, ratios: FloatArray) -> Log2Statistics:
        values = np.abs(np.log2(np.clip(ratios, _STRETCH_MIN, 1 / _STRETCH_MIN)))
        areas = self.weights
        p95, p98 = np.percentile(values, (95, 98), method="inverted_cdf", weights=areas)
        mean = np.average(values, weights=areas)
        return Log2Statistics(float(mean), float(p95), float(p98), float(values.max()))


def chord_distortion(
    mesh: TriangleMesh, mapped_positions: ArrayLike, onto: TriangleMesh | None = None
) -> Distortion:
    """Measure the map that is linear on faces and takes each vertex to its position (V, 3) on a
    surface, by default the mesh itself: by the singular values ``s_1 >= s_2`` of each face's
    Jacobian, ``J = sum_i x_i (grad phi_i)^T`` with ``x_i`` the mapped corners. A face is flipped
    where its mapped normal makes an obtuse angle with the surface's normal at the point closest to
    its mapped centroid. For flow maps the error is of first order in the edge length.
    """
    mapped = finite_points(mapped_positions)
    if len(mapped) != len(mesh.vertices):
        raise AbfmError(
            f"{len(mapped)} mapped positions for {len(mesh.vertices)} vertices: give one row per "
            "vertex"
        )
    return _of_corners(mesh, np.arange(len(mesh.faces)), mapped[mesh.faces], onto or mesh)


def log2_changes(
    mesh: TriangleMesh, faces: IntArray, corners: FloatArray
) -> tuple[float, float, float]:
    """Return the mean and the 95th percentile of ``|log2 J|`` and the mean of ``|log2 R|``, by
    area, over some faces (S,), by number, whose corners are mapped to (S, 3, 3), with triangles
    between these.
    """
    found = np.maximum(_stretches(corners, hat_gradients(mesh)[faces]), _STRETCH_MIN)
    logs, areas = np.log2(found), face_areas(mesh)[faces]
    area, shape = np.abs(logs[:, 0] + logs[:, 1]), logs[:, 0] - logs[:, 1]
    p95 = np.percentile(area, 95, method="inverted_cdf", weights=areas)
    means = (np.average(area, weights=areas), np.average(shape, weights=areas))
    return float(means[0]), float(p95), float(means[1])


def distortion_of_flow(
    mesh: TriangleMesh, faces: IntArray, corners: SurfacePoints, interior_map: SurfaceMap
) -> Distortion:
    """Measure what a map that is known inside faces, too, does to some faces (S,), by number, whose
    corners it takes to points (3 S,).

    Faces that triangles between their mapped corners measure badly are cut into 64 parts, each
    mapped by itself: those that look turned over, as smooth flows make slivers of faces, and those
    that are stretched along a bent surface. Their stretches are the geometric means over the parts,
    and they are flipped by the rule of `folded_shares`. The others are measured as in
    `chord_distortion`.
    """
    chords = _of_corners(mesh, faces, corners.positions.reshape(-1, 3, 3), corners.mesh)
    normals = face_normals(corners.mesh)[corners.faces].reshape(-1, 3, 3).mean(axis=1)
    bent = np.linalg.norm(normals, axis=1) < _BENT_NORMAL_LENGTH
    cut = np.flatnonzero(chords.flipped | (bent & (chords.singular_values[:, 0] > _LONG_STRETCH)))
    turned, stretches = stretches_by_parts(mesh, interior_map, faces[cut])
    flipped, values = chords.flipped.copy(), chords.singular_values.copy()
    flipped[cut] &= turned > _TURNED_SHARE_MIN
    values[cut] = stretches
    return _of_stretches(values, flipped, chords.weights)


def _of_corners(
    mesh: TriangleMesh, faces: IntArray, corners: FloatArray, onto: TriangleMesh
) -> Distortion:
    flipped, stretches = (
        flipped_triangles(onto, corners),
        _stretches(corners, hat_gradients(mesh)[faces]),
    )
    return _of_stretches(stretches, flipped, face_areas(mesh)[faces])


def _of_stretches(values: FloatArray, flipped: BoolArray, weights: FloatArray) -> Distortion:
    largest, smallest = values.T
    conformal = np.divide(largest, smallest, out=np.full_like(largest, np.inf), where=smallest > 0)
    return Distortion(values, largest * smallest, conformal, flipped, weights)


def _stretches(corners: FloatArray, gradients: FloatArray) -> FloatArray:
    """Return singular values (..., 2) of maps of triangles to corners (..., 3, 3), by gradients
    (..., 3, 2) of the hat functions there.
    """
    jacobian = np.einsum("...cx,...ck->...xk", corners - corners[..., :1, :], gradients)
    first, second = jacobian[..., 0], jacobian[..., 1]
    area = np.linalg.norm(np.cross(first, second), axis=-1)
    a, b, c = ((x * y).sum(axis=-1) for x, y in ((first, first), (first, second), (second, second)))
    largest = np.sqrt(0.5 * (a + c + np.hypot(a - c, 2 * b)))
    smallest = np.divide(area, largest, out=np.zeros_like(area), where=largest > 0)
    return np.stack([largest, np.minimum(smallest, largest)], axis=-1)


def flipped_triangles(mesh: TriangleMesh, corners: FloatArray) -> BoolArray:
    """Say which triangles (S, 3, 3) look against the surface closest to their middles, (S,)."""
    landed = project_onto_surface(mesh, corners.mean(axis=1))
    return np.asarray((_areas(corners) * face_normals(mesh)[landed.faces]).sum(axis=1) < 0)


def folded_shares(
    mesh: TriangleMesh,
    interior_map: SurfaceMap,
    faces: IntArray,
    corners: FloatArray,
    most: int = CUT_FACES_MAX,
) -> tuple[float, float]:
    """Return the shares of some faces (S,), by number, that a map folds, and that its mapped
    vertices alone, ``corners`` (S, 3, 3), turn over.

    Smooth flows that stretch faces to slivers seem to turn several percent of them over. So a face
    is folded where more than three quarters of its 64 parts, each mapped by itself, are turned
    over, too. Of more than ``most`` faces to cut, evenly chosen ones stand for all.
    """
    overturned = faces[flipped_triangles(mesh, corners)]
    if not len(overturned):
        return 0.0, 0.0
    share = len(overturned) / len(faces)
    chosen = np.linspace(0, len(overturned) - 1, min(len(overturned), most)).astype(np.int64)
    turned, _ = stretches_by_parts(mesh, interior_map, overturned[chosen])
    return share * float((turned > _TURNED_SHARE_MIN).mean()), share


def stretches_by_parts(
    mesh: TriangleMesh, interior_map: SurfaceMap, faces: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the share of the 64 parts of each of S faces that a map turns over, (S,), and the
    geometric means of the parts' stretches.
    """
    weights, parts = _grid(_PARTS)
    weights = (1 - _INWARD_SHARE) * weights + _INWARD_SHARE / 3
    shares, stretches = np.empty(len(faces)), np.empty((len(faces), 2))
    for begin in range(0, len(faces), _CHUNK):
        chunk = slice(begin, begin + _CHUNK)
        cut = faces[chunk]
        start = SurfacePoints(mesh, np.repeat(cut, len(weights)), np.tile(weights, (len(cut), 1)))
        end, shape = interior_map(start), (len(cut), len(weights), 3)
        before, after = (points.positions.reshape(shape)[:, parts] for points in (start, end))
        normals = face_normals(end.mesh)[end.faces].reshape(shape)[:, parts].mean(axis=2)
        least = -_AREA_ROUNDING * np.linalg.norm(_areas(before), axis=-1)
        shares[chunk] = ((_areas(after) * normals).sum(axis=-1) < least).mean(axis=1)
        gradients = _PARTS / (1 - _INWARD_SHARE) * hat_gradients(mesh)[cut, None]
        found = np.maximum(_stretches(after, gradients), _STRETCH_MIN)
        stretches[chunk] = np.exp(np.log(found).mean(axis=1))
    return shares, stretches


def _areas(corners: FloatArray) -> FloatArray:
    return np.cross(
        corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    )


def _grid(n: int) -> tuple[FloatArray, IntArray]:
    """Return barycentric weights of a grid with n steps a side, and its n^2 triangles, like the
    face or turned by half a turn, with corners in its order.
    """
    steps = np.indices((n + 1, n + 1)).reshape(2, -1)
    second, third = steps[:, steps.sum(axis=0) <= n]
    number = np.full((n + 2, n + 2), -1)
    number[second, third] = np.arange(len(second))
    here, right = number[second, third], number[second + 1, third]
    above, across = number[second, third + 1], number[second + 1, third + 1]
    triangles = np.concatenate(
        [np.stack(t, axis=1) for t in ((here, right, above), (across, above, right))]
    )
    inside = triangles[(triangles >= 0).all(axis=1)]
    return np.stack([n - second - third, second, third], axis=1) / n, inside
