"""The side from which a surface is shown: views by name, the best view, and the axis upwards.

Without ``up``, the convention of the file decides, then the shape:

1. z is upwards for hemispheres of known side and for files of brain surfaces (RAS coordinates).
2. y is upwards for glTF files.
3. z is upwards for shapes more than twice as long along z as along x and y, such as a standing
   person.
4. y is upwards for all others, as in most files of computer graphics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.display import BEST_VIEW, UpAxis, ViewName
from abfm.display import ViewSpec as ViewSpec
from abfm.mesh import TriangleMesh
from abfm.reading import side_of
from abfm.types import FloatArray

Triple = tuple[float, float, float]
_BRAIN_SUFFIXES = (".gii", ".asc", ".srf")
_Y_UP_SUFFIXES = (".glb", ".gltf")
_STANDING_RATIO = 2.0  # length along z over those along x and y, above which z is upwards
_FACES_MAX = 10_000  # largest number of faces that are evaluated
_SAMPLES = 8_000  # approximate number of points of the surface for which hidden parts are found
_PIXEL_SPACING = 2.0  # size of a pixel in spacings of the points
_RADIUS_MAX = 200  # of a surface in pixels, which are larger for a thin wire
_AZIMUTHS = np.radians(np.arange(0, 360, 15))
_ELEVATIONS = np.radians([12, 0, 25, -12, 55, -35])
_ELEVATION_COSTS = np.array([0.0, 0.0, 0.0, 0.05, 0.3, 0.4])
"""Smallest gains in the visible share for which each elevation is chosen."""
_FLAT_ELEVATION = np.radians(55)  # from which flat surfaces are seen
_FLAT_COST = 0.2  # of that elevation for flat surfaces
_FLAT_HEIGHT_RATIO = 0.5  # maximum height of a flat surface relative to its smaller width
_AREA_WEIGHT = 0.3  # of the visible area next to the worst visible share
_SIDE_BONUS = np.array([0.001, 0.002, 0.25])
"""Bonus of views from the right, from above and from the front, relative to the best visible area.
The first two only decide between equivalent directions.
"""
_FUNCTIONS_BONUS = 0.2  # share of these bonuses if functions are shown
_MEDIAL_COST = 0.4  # smallest gain in the visible share for which a cortex is seen from inside
_SHARE_DECIMALS = 6  # differences below are rounding errors
_NUMBERS_MAX = 50_000_000  # largest number of values of a sequence that are evaluated


def triple(values: FloatArray) -> Triple:
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True)
class Front:
    """The side of a mesh that faces the viewer: unit vectors (3,) to the viewer and upwards."""

    direction: Triple
    up: Triple

    @property
    def axes(self) -> FloatArray:
        """Directions to the right, up, and towards the viewer, as rows (3, 3)."""
        return np.stack([np.cross(self.up, self.direction), self.up, self.direction])


def front_of(
    mesh: TriangleMesh,
    *functions: FloatArray,
    view: ViewSpec = BEST_VIEW,
    changes: FloatArray | None = None,
) -> Front:
    """Return the front of a mesh for a view.

    The best view is upright, and shows much of the surface and of the features of all functions. A
    feature is a difference of a function (V,) from its median. Without functions, the front of the
    file's convention is preferred. A cortex of known hemisphere is shown from its lateral side, as
    in Connectome Workbench. Its medial side is shown if the functions are seen much better there.

    Front, back, left and right are horizontal. The front is z if y is upwards and -y if z is
    upwards, but anterior (+y) for brains. Right is x, or z if x is upwards.

    Parameters
    ----------
    mesh : TriangleMesh
    *functions : (V,) arrays
    view : ViewSpec
    changes : (V,) array, optional
        Nonnegative changes in time, see `changes_in_time`; they count as a function.
    """
    axes, is_brain = _axes(mesh, view.up)
    if view.name != "best":
        return _named(view.name, axes, is_brain)
    weights = [np.abs(f - np.median(f)) for f in functions]
    if changes is not None and changes.any():
        weights.append(changes)
    side = side_of(mesh.structure)
    if side and is_brain:
        lateral, medial = (_named(name, axes, True) for name in _SIDES[side])
        if not weights:
            return lateral
        shares = _visible_shares(mesh, weights, np.stack([lateral.axes, medial.axes]))
        return medial if shares[1:, 1].min() > shares[1:, 0].min() + _MEDIAL_COST else lateral
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(_AZIMUTHS, _ELEVATIONS))
    around = np.stack([np.sin(azimuth), np.zeros(len(azimuth)), np.cos(azimuth)], axis=1) @ axes
    directions = np.cos(elevation)[:, None] * around + np.sin(elevation)[:, None] * axes[1]
    ups = np.cos(elevation)[:, None] * axes[1] - np.sin(elevation)[:, None] * around
    every = np.stack([np.cross(ups, directions), ups, directions], axis=1)
    shares = _visible_shares(mesh, weights, every)
    costs = np.repeat(_ELEVATION_COSTS, len(_AZIMUTHS))
    width, height, depth = np.ptp(mesh.vertices @ axes.T, axis=0)
    if height < _FLAT_HEIGHT_RATIO * min(width, depth):
        costs[elevation == _FLAT_ELEVATION] = _FLAT_COST
    costs -= (_FUNCTIONS_BONUS if weights else 1.0) * (directions @ (_SIDE_BONUS @ axes))
    scores = np.min(shares, axis=0) + _AREA_WEIGHT * shares[0] - costs
    best = np.argmax(np.round(scores, _SHARE_DECIMALS))
    return Front(triple(directions[best]), triple(ups[best]))


def upward_axis(mesh: TriangleMesh, up: UpAxis = "auto") -> FloatArray:
    """Return the unit vector (3,) that points upwards."""
    return np.asarray(_axes(mesh, up)[0][1])


def same_side(front: Front, mesh: TriangleMesh, other: TriangleMesh, up: UpAxis = "auto") -> Front:
    """Return the front of another mesh whose front and upward axes see it from the same side."""
    rotation = _axes(other, up)[0].T @ _axes(mesh, up)[0]
    return Front(triple(rotation @ front.direction), triple(rotation @ front.up))


_SIDES: dict[str, tuple[ViewName, ViewName]] = {"L": ("left", "right"), "R": ("right", "left")}
"""Lateral and medial view of each hemisphere."""


def _axes(mesh: TriangleMesh, up: UpAxis) -> tuple[FloatArray, bool]:
    """Return axes to the side, up and to the front, as rows (3, 3), and whether they are a brain's.

    The determinant of the axes is 1.
    """
    name = mesh.file_name.lower().removesuffix(".gz")
    is_brain = side_of(mesh.structure) is not None or name.endswith(_BRAIN_SUFFIXES)
    if up == "auto":
        width, depth, height = np.ptp(mesh.vertices, axis=0)
        is_standing = height > _STANDING_RATIO * max(width, depth)
        is_z_up = is_brain or (is_standing and not name.endswith(_Y_UP_SUFFIXES))
        up = "z" if is_z_up else "y"
    x, y, z = np.eye(3)
    if up == "z":
        return np.stack([-x, z, y] if is_brain else [x, z, -y]), is_brain
    return np.stack([x, y, z] if up == "y" else [z, x, y]), False


def _named(name: ViewName, axes: FloatArray, is_brain: bool) -> Front:
    side, up, front = axes
    right = -side if is_brain else side
    directions = {"front": front, "back": -front, "left": -right, "right": right}
    if name in directions:
        return Front(triple(directions[name]), triple(up))
    if name == "top":  # the front is at the lower edge, but that of a brain at the upper one
        return Front(triple(up), triple(front if is_brain else -front))
    return Front(triple(-up), triple(front))


def _visible_shares(mesh: TriangleMesh, weights: list[FloatArray], axes: FloatArray) -> FloatArray:
    """Return visible shares of the area and of each weight (V,) from n views, (1 + weights, n).

    Shares are relative to the largest one of all views. Parts hidden by others are not visible. A
    surface that is inside out is seen from its outside. ``axes`` (n, 3, 3) are those of `Front`.
    """
    points, normals, weighted = _samples(mesh, weights)
    spacing = np.sqrt(np.linalg.norm(normals, axis=1).sum() / len(points))
    from_center = points - points.mean(axis=0)
    radius = np.linalg.norm(from_center, axis=1).max()
    pixel = max(_PIXEL_SPACING * spacing, radius / _RADIUS_MAX)
    places = from_center / pixel
    half = int(np.ceil(radius / pixel)) + 1
    visible = np.empty((len(weighted), len(axes)))
    for number, (right, up, towards) in enumerate(axes):
        columns, rows = (places @ np.stack([right, up], axis=1) + half).astype(np.intp).T
        pixels, depth = columns * (2 * half) + rows, places @ towards
        nearest = np.full(4 * half**2, -np.inf)
        np.maximum.at(nearest, pixels, depth)
        facing = np.maximum(normals @ towards, 0) * (depth > nearest[pixels] - _PIXEL_SPACING)
        visible[:, number] = weighted @ facing
    return np.asarray(visible / np.maximum(visible.max(axis=1, keepdims=True), 1e-300))


def _samples(
    mesh: TriangleMesh, weights: list[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points (N, 3), outward normals times area (N, 3), and 1 and the weights at the points.

    Large faces have several points, at the centroids of a subdivision.
    """
    faces = mesh.faces[:: max(1, len(mesh.faces) // _FACES_MAX)]
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    normals = (-0.5 if mesh.is_inside_out else 0.5) * np.cross(b - a, c - a)
    areas = np.linalg.norm(normals, axis=1)
    parts = np.ceil(np.sqrt(areas * (_SAMPLES / areas.sum()))).astype(int).clip(1)
    found = []
    for count in np.unique(parts):
        chosen = parts == count
        corners = np.concatenate([mesh.vertices, np.stack(weights).T], 1) if weights else None
        values = (mesh.vertices if corners is None else corners)[faces[chosen]]
        inside = np.einsum("sk,fkc->fsc", _centroids(int(count)), values)
        normal = np.repeat(normals[chosen] / count**2, count**2, axis=0)
        found.append(np.concatenate([inside.reshape(-1, values.shape[2]), normal], axis=1))
    table = np.concatenate(found)
    weighted = np.concatenate([np.ones((len(table), 1)), table[:, 3:-3]], axis=1)
    return table[:, :3], table[:, -3:], np.ascontiguousarray(weighted.T)


def _centroids(count: int) -> FloatArray:
    """Return barycentric coordinates of the centroids of count² parts of a face, (count², 3)."""
    i, j = np.indices((count, count))
    upright = np.stack([i, j], axis=2)[i + j < count] + 1 / 3
    turned = np.stack([i, j], axis=2)[i + j < count - 1] + 2 / 3
    two = np.concatenate([upright, turned]) / count
    return np.column_stack([1 - two.sum(axis=1), two])


def changes_in_time(frames: FloatArray) -> FloatArray:
    """Return the variance in time of frames (T, V, C), summed over channels, shape (V,).

    The variance of each channel is divided by its maximum over the vertices. Values that are not
    finite have variance 0. Very long sequences are subsampled.
    """
    shown = frames[:: -(-frames.size // _NUMBERS_MAX)]
    shown = shown if len(shown) > 1 else frames
    with np.errstate(all="ignore"):
        mean = sum(frame / len(shown) for frame in shown)
        variance = np.asarray(sum((frame - mean) ** 2 / len(shown) for frame in shown))
    variance = np.where(np.isfinite(variance), variance, 0.0)
    return np.asarray((variance / np.maximum(variance.max(axis=0), 1e-300)).sum(axis=1))
