"""Extrinsic symmetry: a reflection or rotation that maps a surface to itself."""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from abfm.calculus.operators import face_areas, vertex_areas
from abfm.errors import AbfmError, ParameterError
from abfm.maps.surface_points import ClosestPoints
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import step

SymmetryKind = Literal["mirror", "rotation"]
KINDS: tuple[SymmetryKind, ...] = get_args(SymmetryKind)
TOLERANCE = 0.02

_ROUNDING = 1e-6  # in sqrt(area); points at a smaller distance count as equal
_MOTION_MIN = 1e-3  # smallest RMS displacement, in sqrt(area); excludes planes of flat surfaces
_PARTNERS_MAX = 60  # largest number of vertices that are tried as the image of one vertex
# smallest distance, in sqrt(area), between partners that are chosen by distance only
_PARTNER_DISTANCE_MIN = 0.1
_SCREENING_VERTICES = 64
_REFINING_VERTICES = 400
# axes count as equal up to this value of 1 - cosine of their angle: 0.8 degrees
_AXIS_TOLERANCE = 1e-4
_CANDIDATES_MAX = 12  # number of candidates that are refined
_REFINEMENTS = 8  # iterations of a refinement


@dataclass(frozen=True, eq=False)
class Symmetry:
    """An isometry that maps a surface to itself: ``x -> centre + linear (x - centre)``."""

    kind: SymmetryKind
    order: int  # 2 for a mirror, n for a rotation by ``2 pi / n``
    # (3,), unit normal of the mirror, or axis of the rotation; its largest component is positive
    axis: FloatArray
    centre: FloatArray  # (3,), a point of the mirror's plane or of the axis, in the mesh's units
    linear: FloatArray  # (3, 3), orthogonal, with determinant -1 for a mirror and 1 for a rotation
    vertex_map: IntArray  # (V,), image of each vertex: the nearest vertex of the face closest to it
    # whether the map is a permutation, which it is if the mesh itself has the symmetry
    is_permutation: bool
    error: float  # largest distance of a vertex's image from the surface, in sqrt(area)

    def apply(self, points: FloatArray) -> FloatArray:
        """Return the images of points (P, 3)."""
        return _apply(self.linear, self.centre, points)


class SymmetryError(AbfmError):
    """An error because the surface has no symmetry of the requested kind.

    ``error`` is the error of the best candidate, in sqrt(area).
    """

    def __init__(self, message: str, error: float) -> None:
        super().__init__(message)
        self.error = error


def detect_symmetry(
    mesh: TriangleMesh, kind: SymmetryKind, order: int = 2, tolerance: float = TOLERANCE
) -> Symmetry:
    """Find the mirror plane of a surface, or the axis of a rotation by ``2 pi / order``.

    Candidates are the principal axes of the surface. They are arbitrary if two moments are equal.
    Additional candidates therefore are the symmetries that map one of three vertices to another
    vertex with the same distance from the centroid. The best candidates are refined by iterations:
    find closest points, then fit the axis. Rotations of an order above 2 are not refined. All of
    the best candidates are tested on all vertices. Candidates that permute the vertices are
    preferred. Of those with at most twice the smallest error, the one that moves the vertices
    farthest is returned.

    Raises
    ------
    SymmetryError
        If the error of the best candidate exceeds ``tolerance``, in sqrt(area).
    ParameterError
        If the kind or order is invalid.
    """
    if kind not in KINDS:
        raise ParameterError(f"kind is {kind!r}; expected {' or '.join(map(repr, KINDS))}")
    if order not in (range(2, 3) if kind == "mirror" else range(2, 1001)):
        raise ParameterError(
            f"order is {order!r}; expected 2 for a mirror and 2 to 1000 for a rotation"
        )
    found = _best(mesh, kind, order)
    if not found.error <= tolerance:
        axis = f"axis of rotation by {360 / order:g} degrees"
        what = "mirror plane" if kind == "mirror" else axis
        raise SymmetryError(
            f"the surface has no {what}: the best candidate moves a vertex {found.error:.3g} "
            f"sqrt(area) away from the surface; expected at most {tolerance:g}. If you know the "
            "symmetry, use a file with the number of each vertex's image",
            found.error,
        )
    return found


class _Isometries(NamedTuple):
    """The reflections, or rotations by one angle, that may map a surface of unit area to itself."""

    surface: TriangleMesh
    closest: ClosestPoints
    kind: SymmetryKind
    order: int

    def linear(self, axes: FloatArray) -> FloatArray:
        """Return the matrices (..., 3, 3) of the reflections or rotations with given unit axes."""
        along = axes[..., :, None] * axes[..., None, :]
        if self.kind == "mirror":
            return np.eye(3) - 2 * along
        if self.order == 2:
            return 2 * along - np.eye(3)
        from scipy.spatial.transform import Rotation  # imported late, as in `functions.files`

        rotations = Rotation.from_rotvec(2 * np.pi / self.order * axes.reshape(-1, 3)).as_matrix()
        return rotations.reshape(along.shape)


@per_mesh
def _best(mesh: TriangleMesh, kind: SymmetryKind, order: int) -> Symmetry:
    """Return the best candidate for a symmetry, even if its error is large."""
    with step("searching for symmetries", len(mesh.vertices)):
        return _search(mesh, kind, order)


def _search(mesh: TriangleMesh, kind: SymmetryKind, order: int) -> Symmetry:
    unit = mesh.normalized()
    group = _Isometries(unit, ClosestPoints(unit), kind, order)
    centroid, axes = principal_axes(unit)
    x = unit.vertices - centroid
    # three vertices in independent directions, of which every symmetry moves at least one
    first = int(np.linalg.norm(x, axis=1).argmax())
    second = int(np.linalg.norm(np.cross(x, x[first]), axis=1).argmax())
    third = int(np.abs(x @ np.cross(x[first], x[second])).argmax())
    found = [_axes_between(group, x, p) for p in (first, second, third)]
    axes = np.concatenate([axes, *found])
    by_distance = unit.vertices[np.argsort(np.linalg.norm(x, axis=1), kind="stable")]
    few, many = (
        by_distance[np.linspace(0, len(x) - 1, n).astype(int)]
        for n in (_SCREENING_VERTICES, _REFINING_VERTICES)
    )
    axes = _screened(group, centroid, axes, few)
    axes, centres, errors = _refined(group, axes, np.tile(centroid, (len(axes), 1)), many)
    chosen = [i for i in _distinct(axes, errors) if errors[i] <= max(TOLERANCE, errors.min())]
    tried = [_verified(group, mesh.length_scale, axes[i], centres[i]) for i in chosen]
    exact = [s for s in tried if s.is_permutation and s.error <= TOLERANCE]
    vertices, scale = mesh.vertices, mesh.length_scale

    def gap(s: Symmetry) -> float:
        """Return the error of a symmetry, in sqrt(area); between vertices if they are permuted."""
        offsets = s.apply(vertices) - vertices[s.vertex_map]
        return float(np.linalg.norm(offsets, axis=1).max()) / scale if exact else s.error

    def motion(s: Symmetry) -> float:
        return float(((s.apply(vertices) - vertices) ** 2).sum(axis=1).mean())

    gaps = [gap(s) for s in exact or tried]
    good = [
        s for s, far in zip(exact or tried, gaps, strict=True) if far <= 2 * min(gaps) + _ROUNDING
    ]
    return max(good, key=lambda s: (round(motion(s) / scale**2, 6), -s.error))


def _apply(linear: FloatArray, centre: FloatArray, points: FloatArray) -> FloatArray:
    return np.asarray(centre + (points - centre) @ np.swapaxes(linear, -1, -2))


def principal_axes(mesh: TriangleMesh) -> tuple[FloatArray, FloatArray]:
    """Return the centroid (3,) of a surface, and its principal axes (3, 3) in rows.

    The axes are the unit eigenvectors of the exact second moments.
    """
    corners, areas = mesh.vertices[mesh.faces], face_areas(mesh)
    centroid = np.average(corners.mean(axis=1), axis=0, weights=areas)
    offsets = corners - centroid
    middles = offsets.mean(axis=1)
    moments = np.einsum("f,fcx,fcy->xy", areas, offsets, offsets)
    moments += 9 * np.einsum("f,fx,fy->xy", areas, middles, middles)
    return centroid, np.linalg.eigh(moments)[1].T


def _axes_between(group: _Isometries, x: FloatArray, p: int) -> FloatArray:
    """Return the axes (K, 3) of the symmetries that map vertex ``p`` to one of its partners.

    ``x`` (V, 3) are the vertices relative to the centroid. Partners are vertices whose distance
    from the centroid is similar to that of p. One half of them is spread over the surface; the
    other half have a vertex area similar to that of p.
    """
    distance = np.linalg.norm(x, axis=1)
    difference = np.abs(distance - distance[p])
    spread: list[int] = []
    for q in np.argsort(difference, kind="stable")[: 20 * _PARTNERS_MAX]:
        if all(np.linalg.norm(x[q] - x[r]) > _PARTNER_DISTANCE_MIN for r in spread):
            spread.append(int(q))
    size = np.sqrt(vertex_areas(group.surface))
    same = np.argsort(difference + np.abs(size - size[p]), kind="stable")[:_PARTNERS_MAX]
    to = x[np.concatenate([spread[:_PARTNERS_MAX], same])]
    if group.kind == "mirror":
        return _unit_rows(x[p] - to)
    # An axis a satisfies a.p = a.q, so it lies in the plane of p + q and p x q. The distance of p
    # from the axis follows from |p - q|.
    half = np.linalg.norm(x[p] - to, axis=1) / 2
    middle, normal = (x[p] + to) / 2, np.cross(x[p], to)
    height = np.linalg.norm(middle, axis=1)
    along = np.sqrt(np.maximum(distance[p] ** 2 - (half / np.sin(np.pi / group.order)) ** 2, 0))
    usable = (height > _ROUNDING) & (along <= height * (1 + _ROUNDING))
    cosine = np.minimum(along[usable] / height[usable], 1)[:, None]
    inside = _unit_rows(middle[usable])
    across = normal[usable] / np.maximum(np.linalg.norm(normal[usable], axis=1), _ROUNDING)[:, None]
    signs, sine = (1, -1) if group.order > 2 else (1,), np.sqrt(1 - cosine**2)
    return _unit_rows(np.concatenate([cosine * inside + sign * sine * across for sign in signs]))


def _unit_rows(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors[lengths > _ROUNDING] / lengths[lengths > _ROUNDING, None])


def _screened(
    group: _Isometries, centre: FloatArray, axes: FloatArray, points: FloatArray
) -> FloatArray:
    """Select axes whose symmetries move points, but keep them close to the surface.

    The closest ones come first, and among equally close ones those with larger motions.
    """
    moved = _apply(group.linear(axes), centre, points)
    motion = ((moved - points) ** 2).sum(axis=2).mean(axis=1)
    by_motion = np.argsort(-np.round(motion, 6), kind="stable")
    moving = by_motion[motion[by_motion] > _MOTION_MIN**2]
    axes, moved = axes[moving], moved[moving]
    positions = moved.reshape(-1, 3)
    distances = group.closest.to(positions).distances_from(positions).reshape(len(axes), -1)
    return axes[
        _distinct(axes, np.maximum((distances**2).mean(axis=1), _ROUNDING**2))[:_CANDIDATES_MAX]
    ]


def _distinct(axes: FloatArray, errors: FloatArray) -> list[int]:
    """Return the indices of axes by ascending error, without near duplicates of earlier axes."""
    distinct: list[int] = []
    for i in np.argsort(errors, kind="stable"):
        if (np.abs(axes[distinct] @ axes[i]) < 1 - _AXIS_TOLERANCE).all():
            distinct.append(int(i))
    return distinct


def _refined(
    group: _Isometries, axes: FloatArray, centres: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Refine axes (K, 3) and points on them (K, 3); return both, and the error (K,) of each axis.

    The error is the largest distance of the image of a point from the surface.
    """
    for remaining in reversed(range(_REFINEMENTS if group.order == 2 else 1)):
        moved = _apply(group.linear(axes), centres[:, None], points)
        positions = moved.reshape(-1, 3)
        closest = group.closest.to(positions)
        gaps = closest.distances_from(positions).reshape(len(axes), -1).max(axis=1)
        if not remaining or gaps.max() < _ROUNDING:
            break
        pairs = closest.positions.reshape(moved.shape)
        centres = (points + pairs).mean(axis=1) / 2
        products = np.swapaxes(points - centres[:, None], 1, 2) @ (pairs - centres[:, None])
        vectors = np.linalg.eigh(products + np.swapaxes(products, 1, 2))[1]
        is_inexact = gaps[:, None] > _ROUNDING  # exact axes are not changed
        axes = np.where(is_inexact, vectors[:, :, 0 if group.kind == "mirror" else 2], axes)
    return axes, centres, gaps


def _verified(
    group: _Isometries, length_scale: float, axis: FloatArray, centre: FloatArray
) -> Symmetry:
    """Return the symmetry with a given axis and centre on the unit-area surface, and its error."""
    axis = axis * np.sign(axis[np.abs(axis).argmax()])
    linear = group.linear(axis)
    positions = _apply(linear, centre, group.surface.vertices)
    closest = group.closest.to(positions)
    vertex_map, error = closest.nearest_vertices(), float(closest.distances_from(positions).max())
    is_permutation = bool(np.bincount(vertex_map).max() == 1)
    motion = axis, centre * length_scale, linear
    return Symmetry(group.kind, group.order, *motion, vertex_map, is_permutation, error)
