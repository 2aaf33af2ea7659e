"""Extrinsic symmetry: the mirror plane or rotation that carries a surface to itself."""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from abfm.calculus.operators import face_areas, vertex_areas
from abfm.errors import AbfmError, ParameterError
from abfm.maps.surface_points import ClosestPoints
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import step

SymmetryKind = Literal["mirror", "rotation"]
KINDS: tuple[SymmetryKind, ...] = get_args(SymmetryKind)
TOLERANCE = 0.02

_ROUNDING = 1e-6  # of sqrt(area): what is nearer is the same place
_NO_MOTION = 1e-3  # of sqrt(area), root mean square: the plane of a flat surface is no mirror
_PARTNERS = 60  # vertices that one vertex may be carried to
_PARTNER_DISTANCE_MIN = 0.1  # of sqrt(area): partners that do not look alike
# vertices that candidates are screened, and refined, on
_SCREENED_COUNT = 64
_REFINED_COUNT = 400
_AXIS_TOLERANCE = 1e-4  # 1 - cosine of axes: 0.8 degrees
_CANDIDATES = 12  # candidates that are refined
_REFINEMENTS = 8


@dataclass(frozen=True, eq=False)
class Symmetry:
    """An isometry that carries a surface to itself: ``x -> centre + linear (x - centre)``."""

    kind: SymmetryKind
    # after how many times everything is back: 2 for a mirror, n for a rotation by ``2 pi / n``
    order: int
    # (3,), unit normal of the mirror, or axis of the rotation; its largest component is positive
    axis: FloatArray
    centre: FloatArray  # (3,), a point of the mirror's plane or of the axis, in the mesh's units
    linear: FloatArray  # (3, 3), orthogonal, with determinant -1 for a mirror and 1 for a rotation
    # (V,), where each vertex is carried; to the nearest on the face where it lands, if to none
    vertex_map: IntArray
    # whether the map takes every vertex once, as where the mesh itself has the symmetry
    is_permutation: bool
    # how far from the surface the worst vertex is carried, as a fraction of sqrt(area)
    error: float

    def apply(self, points: FloatArray) -> FloatArray:
        return _apply(self.linear, self.centre, points)


class SymmetryError(AbfmError):
    """No symmetry of this kind; `error` is that of the best candidate."""

    def __init__(self, message: str, error: float) -> None:
        super().__init__(message)
        self.error = error


def detect_symmetry(
    mesh: TriangleMesh, kind: SymmetryKind, order: int = 2, tolerance: float = TOLERANCE
) -> Symmetry:
    """Find the mirror plane, or the axis of a rotation by ``2 pi / order``, of a surface, made once
    per mesh; a SymmetryError says how far the best one is off if that is more than a tolerance.

    Candidates are the principal axes of the surface and, as these say nothing where two moments are
    equal, the mirrors and rotations that carry one of three vertices to another one as far from the
    centroid. The best are refined by turns of closest points and best axes (not for orders above
    2), then tried on all vertices. Permutations of the vertices go before others, then smaller
    errors before larger ones, then the one that moves the surface most is chosen.
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
            f"the surface has no {what}: the best one found carries a vertex {found.error:.3g} "
            f"sqrt(area) away from the surface, and {tolerance:g} is allowed; a symmetry may also "
            "be given as a file of vertex numbers",
            found.error,
        )
    return found


class _Isometries(NamedTuple):
    """The mirrors, or rotations by one angle, that may carry a surface of unit area to itself."""

    surface: TriangleMesh
    closest: ClosestPoints
    kind: SymmetryKind
    order: int

    def linear(self, axes: FloatArray) -> FloatArray:
        """Return mirrors or rotations (..., 3, 3) by their unit axes (..., 3)."""
        along = axes[..., :, None] * axes[..., None, :]
        if self.kind == "mirror":
            return np.eye(3) - 2 * along
        if self.order == 2:
            return 2 * along - np.eye(3)
        rotations = Rotation.from_rotvec(2 * np.pi / self.order * axes.reshape(-1, 3)).as_matrix()
        return rotations.reshape(along.shape)


@per_mesh
def _best(mesh: TriangleMesh, kind: SymmetryKind, order: int) -> Symmetry:
    """Find the symmetry to choose, whatever its error."""
    with step("looking for symmetries", len(mesh.vertices)):
        return _chosen(mesh, kind, order)


def _chosen(mesh: TriangleMesh, kind: SymmetryKind, order: int) -> Symmetry:
    unit = mesh.normalized()
    group = _Isometries(unit, ClosestPoints(unit), kind, order)
    centroid, axes = principal_axes(unit)
    x = unit.vertices - centroid
    # three vertices in independent directions, not all left in place by a symmetry
    first = int(np.linalg.norm(x, axis=1).argmax())
    second = int(np.linalg.norm(np.cross(x, x[first]), axis=1).argmax())
    third = int(np.abs(x @ np.cross(x[first], x[second])).argmax())
    found = [_axes_between(group, x, p) for p in (first, second, third)]
    axes = np.concatenate([axes, *found])
    by_distance = unit.vertices[np.argsort(np.linalg.norm(x, axis=1), kind="stable")]
    few, many = (
        by_distance[np.linspace(0, len(x) - 1, n).astype(int)]
        for n in (_SCREENED_COUNT, _REFINED_COUNT)
    )
    axes = _screened(group, centroid, axes, few)
    axes, centres, errors = _refined(group, axes, np.tile(centroid, (len(axes), 1)), many)
    chosen = [i for i in _distinct(axes, errors) if errors[i] <= max(TOLERANCE, errors.min())]
    tried = [_verified(group, mesh.length_scale, axes[i], centres[i]) for i in chosen]
    exact = [s for s in tried if s.is_permutation and s.error <= TOLERANCE]
    vertices, scale = mesh.vertices, mesh.length_scale

    def gap(s: Symmetry) -> float:
        """How far the worst vertex is carried from that of the map, in sqrt(area)."""
        offsets = s.apply(vertices) - vertices[s.vertex_map]
        return float(np.linalg.norm(offsets, axis=1).max()) / scale if exact else s.error

    def motion(s: Symmetry) -> float:
        """How far the symmetry moves vertices, squared, on average."""
        return float(((s.apply(vertices) - vertices) ** 2).sum(axis=1).mean())

    gaps = [gap(s) for s in exact or tried]
    good = [
        s for s, far in zip(exact or tried, gaps, strict=True) if far <= 2 * min(gaps) + _ROUNDING
    ]
    return max(good, key=lambda s: (round(motion(s) / scale**2, 6), -s.error))


def _apply(linear: FloatArray, centre: FloatArray, points: FloatArray) -> FloatArray:
    return np.asarray(centre + (points - centre) @ np.swapaxes(linear, -1, -2))


def principal_axes(mesh: TriangleMesh) -> tuple[FloatArray, FloatArray]:
    """Return the centroid (3,), and unit eigenvectors of the exact second moments in rows."""
    corners, areas = mesh.vertices[mesh.faces], face_areas(mesh)
    centroid = np.average(corners.mean(axis=1), axis=0, weights=areas)
    offsets = corners - centroid
    middles = offsets.mean(axis=1)
    moments = np.einsum("f,fcx,fcy->xy", areas, offsets, offsets)
    moments += 9 * np.einsum("f,fx,fy->xy", areas, middles, middles)
    return centroid, np.linalg.eigh(moments)[1].T


def _axes_between(group: _Isometries, x: FloatArray, p: int) -> FloatArray:
    """Return axes (K, 3) of symmetries that carry vertex p to one as far out, alike or apart."""
    distance = np.linalg.norm(x, axis=1)
    unlike = np.abs(distance - distance[p])
    spread: list[int] = []
    for q in np.argsort(unlike, kind="stable")[: 20 * _PARTNERS]:
        if all(np.linalg.norm(x[q] - x[r]) > _PARTNER_DISTANCE_MIN for r in spread):
            spread.append(int(q))
    size = np.sqrt(vertex_areas(group.surface))
    same = np.argsort(unlike + np.abs(size - size[p]), kind="stable")[:_PARTNERS]
    to = x[np.concatenate([spread[:_PARTNERS], same])]
    if group.kind == "mirror":
        return _unit_rows(x[p] - to)
    # An axis a keeps a.p = a.q, so it lies in the plane of p + q and p x q; |p - q| says how far p
    # is from it.
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
    """Return those that are not zero, scaled to length 1."""
    lengths = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors[lengths > _ROUNDING] / lengths[lengths > _ROUNDING, None])


def _screened(
    group: _Isometries, centre: FloatArray, axes: FloatArray, points: FloatArray
) -> FloatArray:
    """Select axes that carry points nearest to the surface, but move them, most before less."""
    carried = _apply(group.linear(axes), centre, points)
    motion = ((carried - points) ** 2).sum(axis=2).mean(axis=1)
    most = np.argsort(-np.round(motion, 6), kind="stable")
    moving = most[motion[most] > _NO_MOTION**2]
    axes, carried = axes[moving], carried[moving]
    places = carried.reshape(-1, 3)
    distances = group.closest.to(places).distances_from(places).reshape(len(axes), -1)
    return axes[
        _distinct(axes, np.maximum((distances**2).mean(axis=1), _ROUNDING**2))[:_CANDIDATES]
    ]


def _distinct(axes: FloatArray, errors: FloatArray) -> list[int]:
    """Return axes by ascending error, without those that are like an earlier one."""
    kept: list[int] = []
    for i in np.argsort(errors, kind="stable"):
        if (np.abs(axes[kept] @ axes[i]) < 1 - _AXIS_TOLERANCE).all():
            kept.append(int(i))
    return kept


def _refined(
    group: _Isometries, axes: FloatArray, centres: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move axes (K, 3) and points on them so that gaps to the surface shrink; returns all three."""
    for left in reversed(range(_REFINEMENTS if group.order == 2 else 1)):
        carried = _apply(group.linear(axes), centres[:, None], points)
        places = carried.reshape(-1, 3)
        landed = group.closest.to(places)
        gaps = landed.distances_from(places).reshape(len(axes), -1).max(axis=1)
        if not left or gaps.max() < _ROUNDING:
            break
        pairs = landed.positions.reshape(carried.shape)
        centres = (points + pairs).mean(axis=1) / 2
        products = np.swapaxes(points - centres[:, None], 1, 2) @ (pairs - centres[:, None])
        vectors = np.linalg.eigh(products + np.swapaxes(products, 1, 2))[1]
        rough = gaps[:, None] > _ROUNDING  # what is exact stays as it is
        axes = np.where(rough, vectors[:, :, 0 if group.kind == "mirror" else 2], axes)
    return axes, centres, gaps


def _verified(
    group: _Isometries, length_scale: float, axis: FloatArray, centre: FloatArray
) -> Symmetry:
    """Try the symmetry by its axis and a point on it, both for unit area, on all vertices."""
    axis = axis * np.sign(axis[np.abs(axis).argmax()])
    linear = group.linear(axis)
    places = _apply(linear, centre, group.surface.vertices)
    landed = group.closest.to(places)
    vertex_map, error = landed.nearest_vertices(), float(landed.distances_from(places).max())
    is_permutation = bool(np.bincount(vertex_map).max() == 1)
    placed = axis, centre * length_scale, linear
    return Symmetry(group.kind, group.order, *placed, vertex_map, is_permutation, error)
