"""The front of a surface: the side from which it is shown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.mesh import TriangleMesh
from abfm.reading import side_of
from abfm.types import FloatArray

Triple = tuple[float, float, float]
_FACES_MAX = 10_000  # largest number of faces that are evaluated
_AZIMUTHS = np.radians(np.arange(0, 360, 10))
_ELEVATIONS = np.radians([0, 12, 25, -12, 55])
_STEEP_ELEVATION = np.radians(30)  # higher elevations are only for flat surfaces
_STEEP_COST = 0.2  # smallest gain in visible area for which a steep view is chosen
_FLAT_HEIGHT_RATIO = 0.5  # maximum height of a flat surface relative to its smaller width
_SIDE_BONUS = np.array([0.001, 0.002, 0.25])
"""Bonus of views from the right, from above and from the front, relative to the best visible area.
The first two only decide between equivalent directions.
"""
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


def best_front(
    mesh: TriangleMesh,
    *functions: FloatArray,
    up: str | None = None,
    changes: FloatArray | None = None,
) -> Front:
    """Return the front with the most visible surface and the most visible features of functions.

    A cortex of known hemisphere is shown from its lateral side with z upwards, as in Connectome
    Workbench, unless ``up`` is another axis. For other surfaces y is upwards by default.

    A feature is a difference of a function (V,) from its median. Occlusion by other parts is
    ignored. A surface that is inside out is shown from its outside. Both sides of a closed surface
    show equal areas. Without functions, the usual front of meshes is therefore preferred, which is
    z if y points upwards.

    Parameters
    ----------
    mesh : TriangleMesh
    *functions : (V,) arrays
    up : str, optional
        Axis that points upwards, "x", "y" or "z".
    changes : (V,) array, optional
        Nonnegative changes in time, see `changes_in_time`; they count as a function.
    """
    side = side_of(mesh.structure)
    if side and up in (None, "z"):
        return Front((-1.0 if side == "L" else 1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    up = up or "y"
    axes = np.roll(np.eye(3), 1 - "xyz".index(up), axis=0)  # axes to the right, up and to the front
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(_AZIMUTHS, _ELEVATIONS))
    around = np.stack([np.sin(azimuth), np.zeros(len(azimuth)), np.cos(azimuth)], axis=1) @ axes
    directions = np.cos(elevation)[:, None] * around + np.sin(elevation)[:, None] * axes[1]
    ups = np.cos(elevation)[:, None] * axes[1] - np.sin(elevation)[:, None] * around
    faces = mesh.faces[:: max(1, len(mesh.faces) // _FACES_MAX)]
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    outward = -1 if mesh.is_inside_out else 1
    facing = np.maximum(outward * np.cross(b - a, c - a) @ directions.T, 0)
    weights = [np.abs(f - np.median(f))[faces].mean(axis=1) for f in functions]
    if changes is not None and changes.any():
        weights.append(changes[faces].mean(axis=1))
    # visible share of each weight by direction, relative to the best direction
    visible = [weight @ facing for weight in (np.ones(len(faces)), *weights)]
    shares = [each / max(float(each.max()), 1e-300) for each in visible]
    width, height, depth = np.ptp(mesh.vertices @ axes.T, axis=0)
    steep_cost = _STEEP_COST if height < _FLAT_HEIGHT_RATIO * min(width, depth) else np.inf
    costs = np.where(elevation > _STEEP_ELEVATION, steep_cost, 0.0)
    costs -= 0.0 if weights else directions @ (_SIDE_BONUS @ axes)
    best = np.argmax(np.min(shares, axis=0) + 0.2 * shares[0] - costs)
    return Front(triple(directions[best]), triple(ups[best]))


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
