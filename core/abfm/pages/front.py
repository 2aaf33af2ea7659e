"""The side from which a surface is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.mesh import TriangleMesh
from abfm.reading import side_of
from abfm.types import FloatArray

Triple = tuple[float, float, float]
_FACES_LOOKED_AT = 10_000
_AZIMUTHS = np.radians(np.arange(0, 360, 10))
_ELEVATIONS = np.radians([0, 12, 25, -12, 55])
_STEEP_ELEVATION = np.radians(30)  # above it only flat surfaces are seen from,
_STEEP_COST = 0.2  # and only if much more of them is visible
_FLAT_HEIGHT_RATIO = 0.5  # of its smaller width: what is lower lies flat
_SIDES = np.array([0.001, 0.002, 0.25])
"""What looking from the right, from above and at the face is worth, of the surface that the best
direction shows. The first two only decide between directions that show alike."""
_NUMBERS_MAX = 50_000_000  # numbers of a film


def triple(values: FloatArray) -> Triple:
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True)
class Front:
    """The side of the mesh that faces the viewer: two unit vectors (3,)."""

    direction: Triple
    up: Triple

    @property
    def axes(self) -> FloatArray:
        """Return what is to the right, up, and towards the viewer, as rows (3, 3)."""
        return np.stack([np.cross(self.up, self.direction), self.up, self.direction])


def best_front(
    mesh: TriangleMesh,
    *functions: FloatArray,
    up: str | None = None,
    changes: FloatArray | None = None,
) -> Front:
    """Look from where much surface is seen, and of every function (V,) its remarkable part; at a
    cortex of known hemisphere as Connectome Workbench does, from the side with z upwards.

    It is so unless another axis is `up`; other surfaces have y upwards by default. Remarkable is
    where a function differs from its median; hiding behind another part is not considered, but of
    a surface that is inside out the outside is looked at. Without functions rather from the side
    that most meshes have in front, z where y is `up`: as much of a closed surface is seen from
    behind. Of a film its `changes` (V,) are seen, 0 or more, see `changes_in_time`.
    """
    side = side_of(mesh.structure)
    if side and up in (None, "z"):
        return Front((-1.0 if side == "L" else 1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    up = up or "y"
    axes = np.roll(np.eye(3), 1 - "xyz".index(up), axis=0)  # sideways, up, to the front
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(_AZIMUTHS, _ELEVATIONS))
    around = np.stack([np.sin(azimuth), np.zeros(len(azimuth)), np.cos(azimuth)], axis=1) @ axes
    directions = np.cos(elevation)[:, None] * around + np.sin(elevation)[:, None] * axes[1]
    ups = np.cos(elevation)[:, None] * axes[1] - np.sin(elevation)[:, None] * around
    faces = mesh.faces[:: max(1, len(mesh.faces) // _FACES_LOOKED_AT)]
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    outward = -1 if mesh.is_inside_out else 1
    facing = np.maximum(outward * np.cross(b - a, c - a) @ directions.T, 0)
    weights = [np.abs(f - np.median(f))[faces].mean(axis=1) for f in functions]
    if changes is not None and changes.any():
        weights.append(changes[faces].mean(axis=1))
    # how much of them each direction shows, relative to the best one
    seen = [weight @ facing for weight in (np.ones(len(faces)), *weights)]
    shares = [each / max(float(each.max()), 1e-300) for each in seen]
    width, height, depth = np.ptp(mesh.vertices @ axes.T, axis=0)
    steep_cost = _STEEP_COST if height < _FLAT_HEIGHT_RATIO * min(width, depth) else np.inf
    costs = np.where(elevation > _STEEP_ELEVATION, steep_cost, 0.0)
    costs -= 0.0 if weights else directions @ (_SIDES @ axes)
    best = np.argmax(np.min(shares, axis=0) + 0.2 * shares[0] - costs)
    return Front(triple(directions[best]), triple(ups[best]))


def changes_in_time(frames: FloatArray) -> FloatArray:
    """Return the variance in time of frames (T, V, C), (V,): of each channel as a share of its
    largest, and of none that is not finite. Of very long films only some frames count.
    """
    shown = frames[:: -(-frames.size // _NUMBERS_MAX)]
    shown = shown if len(shown) > 1 else frames
    with np.errstate(all="ignore"):
        mean = sum(frame / len(shown) for frame in shown)
        variance = np.asarray(sum((frame - mean) ** 2 / len(shown) for frame in shown))
    variance = np.where(np.isfinite(variance), variance, 0.0)
    return np.asarray((variance / np.maximum(variance.max(axis=0), 1e-300)).sum(axis=1))
