"""Where to look from: a direction that shows a mesh, and functions on it."""

import numpy as np

from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.document.document import Front, triple

_FACES_LOOKED_AT = 10_000
_ELEVATIONS = np.radians([0, 12, 25, -12, 55])
# only for what lies flat, and only where it shows much more
_STEEP, _STEEP_COSTS = np.radians(30), 0.2
_FLAT = 0.5  # of its smaller width: what is lower lies flat
_AZIMUTHS = np.radians(np.arange(0, 360, 10))
_SIDES = np.array([0.001, 0.002, 0.25])
"""What looking from the right, from above and at the face is worth, of the surface that the best
direction shows. The first two only decide between directions that show alike."""


def best_front(mesh: TriangleMesh, *functions: FloatArray, up: str = "y") -> Front:
    """Look from where much surface is seen, and of every function (V,) its remarkable part; `up` is
    x, y or z.

    A function's remarkable part is where it differs from its median; hiding behind another part is
    not considered, but of a surface that is inside out the outside is looked at. Without functions
    rather from the side that most meshes have in front, z where y is up: as much of a closed
    surface is seen from behind.
    """
    axes = np.roll(np.eye(3), 1 - "xyz".index(up), axis=0)  # sideways, up, to the front
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(_AZIMUTHS, _ELEVATIONS))
    around = np.stack([np.sin(azimuth), np.zeros(len(azimuth)), np.cos(azimuth)], axis=1) @ axes
    directions = np.cos(elevation)[:, None] * around + np.sin(elevation)[:, None] * axes[1]
    ups = np.cos(elevation)[:, None] * axes[1] - np.sin(elevation)[:, None] * around
    faces = mesh.faces[:: max(1, len(mesh.faces) // _FACES_LOOKED_AT)]
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    outward = -1 if mesh.is_inside_out else 1
    facing = np.maximum(outward * np.cross(b - a, c - a) @ directions.T, 0)
    surface = _share(facing, np.ones(len(faces)))
    shares = [_share(facing, np.abs(f - np.median(f))[faces].mean(axis=1)) for f in functions]
    width, height, depth = np.ptp(mesh.vertices @ axes.T, axis=0)
    costs = np.where(
        elevation > _STEEP, _STEEP_COSTS if height < _FLAT * min(width, depth) else np.inf, 0.0
    )
    costs -= 0.0 if functions else directions @ (_SIDES @ axes)
    best = np.argmax(np.min([surface, *shares], axis=0) + 0.2 * surface - costs)
    return Front(triple(directions[best]), triple(ups[best]))


def _share(facing: FloatArray, weights: FloatArray) -> FloatArray:
    """For each direction how much of a weight on faces is seen, relative to the best direction."""
    seen: FloatArray = weights @ facing
    return seen / max(float(seen.max()), 1e-300)
