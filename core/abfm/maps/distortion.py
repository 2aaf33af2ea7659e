"""Distortion of maps: changes of lengths, areas, angles and orientation of faces."""

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
"""Share of the faces that must satisfy a bound; a few others, as at creases, may exceed it."""
CUT_FACES_MAX = 2048  # default of the largest number of faces that are subdivided
_PARTS = 8  # parts along each side of a subdivided face
# A face is folded if more than this share of its parts is flipped. In slivers along a bent surface,
# about half of the parts seem flipped. In 36 of 38 maps of flows, it was not more than this share.
# In folded faces, nearly all parts are flipped.
_FLIPPED_SHARE_MIN = 0.75
_INWARD_SHARE = 1e-6  # points move toward the centroid by this share, so none lies on two faces
_AREA_ROUNDING = 1e-12  # a part whose area shrinks to a smaller share is collapsed, not flipped
_COLLAPSED_AREA_MAX = 1e-9  # a face whose area shrinks to at most this share is collapsed
_CHUNK = 4096  # number of faces that are subdivided at a time, with 184,320 points in total
_STRETCH_MIN = 1e-6  # smaller stretches are clipped before taking logarithms
# A face is measured in parts if its stretch exceeds the first number and the surface is bent below
# it. Then the mean unit normal at its corners is shorter than the second number (about 30 degrees)
_LONG_STRETCH = 2.0
_BENT_NORMAL_LENGTH = 0.95
SurfaceMap = Callable[[SurfacePoints], SurfacePoints]


class Log2Statistics(NamedTuple):
    """Statistics over a surface of the absolute value of a base-2 logarithm, weighted by area."""

    mean: float
    p95: float  # 95th percentile; p98 is the 98th
    p98: float
    maximum: float

    def report(self) -> str:
        return (
            f"mean {self.mean:.3f}, 95% {self.p95:.2f}, 98% {self.p98:.2f}, max {self.maximum:.2f}"
        )


class Bound(NamedTuple):
    """A bound of the distortion of faces by a map, and how the map satisfies it.

    It bounds ``|log2 J|`` and ``|log2 R|`` of each face. J is the ratio of areas, and R the ratio
    of the largest to the smallest stretch.
    """

    max_distortion: float
    share: float  # share of the faces, 0 to 1, that satisfy the bound
    largest: float  # smallest bound that 99% of the faces satisfy
    folded: int  # number of folded faces

    @classmethod
    def of(cls, numbers: ArrayLike) -> Bound:
        """Return the bound from four numbers in the order of the fields, as files store them."""
        most, share, largest, folded = np.asarray(numbers).tolist()
        return cls(most, share, largest, int(folded))

    @property
    def is_satisfied(self) -> bool:
        """Whether 99% of the faces satisfy the bound and none is folded."""
        return self.share >= BOUNDED_SHARE and not self.folded


@dataclass(frozen=True, eq=False, repr=False)
class Distortion:
    """Distortion of each of F faces by a map, see `abfm.PointMap.distortion`."""

    singular_values: FloatArray  # (F, 2), largest and smallest stretch ``s_1 >= s_2 >= 0``
    area: FloatArray  # (F,), ``J = s_1 s_2``: mapped area over area
    conformal: FloatArray  # (F,), ``R = s_1 / s_2 >= 1``; inf if a face collapses
    flipped: BoolArray  # (F,), whether the map reverses the orientation of the face
    weights: FloatArray  # (F,), areas of the faces before mapping

    @property
    def folded(self) -> int:
        """The number of flipped faces."""
        return int(self.flipped.sum())

    @property
    def collapsed(self) -> int:
        """The number of faces whose images are a line or a point."""
        return int((self.area <= _COLLAPSED_AREA_MAX).sum())

    @property
    def log2_area(self) -> Log2Statistics:
        """Statistics of ``|log2 J|``, the change of areas, as in the pipelines of HCP and MSM."""
        return self._log2(self.area)

    @property
    def log2_shape(self) -> Log2Statistics:
        """Statistics of ``|log2 R|``, the change of shapes, as in the pipelines of HCP and MSM."""
        return self._log2(self.conformal)

    def share_within(self, most: float) -> float:
        """Return the share of faces, 0 to 1, with ``|log2 J|`` and ``|log2 R|`` up to ``most``."""
        logs = np.log2(np.clip([self.area, self.conformal], _STRETCH_MIN, 1 / _STRETCH_MIN))
        return float((np.abs(logs) <= most).all(axis=0).mean())

    def bound_of(self, share: float) -> float:
        """Return the smallest bound of ``|log2 J|`` and ``|log2 R|`` for a share of the faces."""
        logs = np.log2(np.clip([self.area, self.conformal], _STRETCH_MIN, 1 / _STRETCH_MIN))
        largest = np.sort(np.abs(logs).max(axis=0))
        return float(largest[max(int(np.ceil(share * len(largest))), 1) - 1])

    def bound(self, most: float) -> Bound:
        """Return the bound ``most`` of ``|log2 J|`` and ``|log2 R|``, and how well it holds."""
        return Bound(most, self.share_within(most), self.bound_of(BOUNDED_SHARE), self.folded)

    def scaled(self, factor: float) -> Distortion:
        """Return the distortion with all stretches multiplied by a factor, as if units changed."""
        values = factor * self.singular_values
        return Distortion(values, factor**2 * self.area, self.conformal, self.flipped, self.weights)

    def report(self) -> str:
        """Return the statistics and the number of folded faces as one line of text."""
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
    """Measure the distortion of a map that is linear on faces, from the images of the vertices.

    The map takes each vertex to its position in ``mapped_positions`` (V, 3), on the surface
    ``onto``, by default the mesh itself. The stretches are the singular values ``s_1 >= s_2`` of
    each face's Jacobian ``J = sum_i x_i (grad phi_i)^T`` with the mapped corners ``x_i``. A face is
    flipped if its mapped normal makes an obtuse angle with the normal of ``onto`` at the point
    closest to its mapped centroid. For maps of flows the error is of first order in the edge
    length.
    """
    mapped = finite_points(mapped_positions)
    if len(mapped) != len(mesh.vertices):
        raise AbfmError(
            f"there are {len(mapped)} mapped positions, but the mesh has {len(mesh.vertices)} "
            "vertices; expected one row per vertex"
        )
    return _of_corners(mesh, np.arange(len(mesh.faces)), mapped[mesh.faces], onto or mesh)


def log2_changes(
    mesh: TriangleMesh, faces: IntArray, corners: FloatArray
) -> tuple[float, float, float]:
    """Return statistics of a map that is linear on S faces, given the images (S, 3, 3) of corners.

    They are the mean and the 95th percentile of ``|log2 J|`` (areas), and the mean of
    ``|log2 R|`` (shapes), all weighted by area.
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
    """Measure the distortion of faces (S,) by a map that is known at corners and inside faces.

    ``corners`` (3 S,) are the images of the faces' corners. The triangle between them is a bad
    approximation of the mapped face in two cases. It may seem flipped because a smooth flow makes
    slivers of faces, or it is stretched along a bent surface. Such faces are divided into 64 parts,
    which are mapped separately. Their stretches are the geometric means over the parts, and
    `folded_shares` defines whether they are flipped. Other faces are measured as in
    `chord_distortion`.
    """
    chords = _of_corners(mesh, faces, corners.positions.reshape(-1, 3, 3), corners.mesh)
    normals = face_normals(corners.mesh)[corners.faces].reshape(-1, 3, 3).mean(axis=1)
    bent = np.linalg.norm(normals, axis=1) < _BENT_NORMAL_LENGTH
    cut = np.flatnonzero(chords.flipped | (bent & (chords.singular_values[:, 0] > _LONG_STRETCH)))
    shares, stretches = stretches_by_parts(mesh, interior_map, faces[cut])
    flipped, values = chords.flipped.copy(), chords.singular_values.copy()
    flipped[cut] &= shares > _FLIPPED_SHARE_MIN
    values[cut] = stretches
    return _of_stretches(values, flipped, chords.weights)


def _of_corners(
    mesh: TriangleMesh, faces: IntArray, corners: FloatArray, onto: TriangleMesh
) -> Distortion:
    flipped = flipped_triangles(onto, corners)
    stretches = _stretches(corners, hat_gradients(mesh)[faces])
    return _of_stretches(stretches, flipped, face_areas(mesh)[faces])


def _of_stretches(values: FloatArray, flipped: BoolArray, weights: FloatArray) -> Distortion:
    largest, smallest = values.T
    conformal = np.divide(largest, smallest, out=np.full_like(largest, np.inf), where=smallest > 0)
    return Distortion(values, largest * smallest, conformal, flipped, weights)


def _stretches(corners: FloatArray, gradients: FloatArray) -> FloatArray:
    """Return the singular values (..., 2) of linear maps of triangles to corners (..., 3, 3).

    ``gradients`` (..., 3, 2) are the gradients of the hat functions on the triangles.
    """
    jacobian = np.einsum("...cx,...ck->...xk", corners - corners[..., :1, :], gradients)
    first, second = jacobian[..., 0], jacobian[..., 1]
    area = np.linalg.norm(np.cross(first, second), axis=-1)
    a, b, c = ((x * y).sum(axis=-1) for x, y in ((first, first), (first, second), (second, second)))
    largest = np.sqrt(0.5 * (a + c + np.hypot(a - c, 2 * b)))
    smallest = np.divide(area, largest, out=np.zeros_like(area), where=largest > 0)
    return np.stack([largest, np.minimum(smallest, largest)], axis=-1)


def flipped_triangles(mesh: TriangleMesh, corners: FloatArray) -> BoolArray:
    """Return a mask (S,) of the triangles (S, 3, 3) in space that are flipped.

    The normal of a flipped triangle is opposite to that of the surface near its centroid.
    """
    closest = project_onto_surface(mesh, corners.mean(axis=1))
    return np.asarray((_areas(corners) * face_normals(mesh)[closest.faces]).sum(axis=1) < 0)


def folded_shares(
    mesh: TriangleMesh,
    interior_map: SurfaceMap,
    faces: IntArray,
    corners: FloatArray,
    most: int = CUT_FACES_MAX,
) -> tuple[float, float]:
    """Return the share of S faces that a map folds, and the share with flipped triangles.

    The triangle of a face lies between its mapped corners (S, 3, 3). If a smooth flow stretches
    faces to slivers, several percent of these triangles seem flipped. A face is therefore folded
    only if more than three quarters of its 64 parts, mapped separately, are also flipped. At most
    ``most`` flipped faces, evenly chosen, are divided.
    """
    flipped = faces[flipped_triangles(mesh, corners)]
    if not len(flipped):
        return 0.0, 0.0
    share = len(flipped) / len(faces)
    chosen = np.linspace(0, len(flipped) - 1, min(len(flipped), most)).astype(np.int64)
    shares, _ = stretches_by_parts(mesh, interior_map, flipped[chosen])
    return share * float((shares > _FLIPPED_SHARE_MIN).mean()), share


def stretches_by_parts(
    mesh: TriangleMesh, interior_map: SurfaceMap, faces: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Divide S faces into 64 parts each, and measure a map of the parts.

    Return the share (S,) of flipped parts, and the geometric means (S, 2) of the parts' stretches.
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
    """Return the points of a grid on a face, as barycentric weights, and the grid's n^2 triangles.

    Each side has n steps. All triangles have the orientation of the face.
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
