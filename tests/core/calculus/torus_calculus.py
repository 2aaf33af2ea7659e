"""Exact calculus in the angles of a torus: ``u`` about the z axis, ``v`` around the tube.

The meshes of `tests.shapes.torus` vary smoothly, without the irregular vertices of a sphere, so
they show orders of convergence. A field is ``a d/du + b d/dv``. In these components, the Lie
bracket is ``[X, Y] = X(Y) - Y(X)``.
"""

import numpy as np

from tests.core.fields import tangent
from tests.shapes import torus

MAJOR, MINOR = 1.0, 0.4


def refined(levels, coarsest=24):
    counts = [coarsest * 2**level for level in range(levels)]
    return [torus(count, count // 2, MAJOR, MINOR) for count in counts]


def angles(points):
    """Return ``u`` and ``v`` of points (n, 3) near the torus."""
    x, y, z = points.T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y) - MAJOR)


def ring(v):
    """Return the distance from the z axis, the length of ``d/du``; ``d/dv`` has length MINOR."""
    return MAJOR + MINOR * np.cos(v)


def vectors(points, a, b):
    """Return ``a d/du + b d/dv`` at points (n, 3), as vectors in space."""
    u, v = angles(points)
    along = np.stack([-np.sin(u), np.cos(u), 0 * u], axis=1) * (a(u, v) * ring(v))[:, None]
    around = np.stack([-np.sin(v) * np.cos(u), -np.sin(v) * np.sin(u), np.cos(v)], axis=1)
    return along + around * (MINOR * b(u, v) * np.ones_like(u))[:, None]


def face_field(mesh, a, b):
    """Return ``a d/du + b d/dv`` at face centres, (F, 3)."""
    return tangent(mesh, vectors(mesh.vertices[mesh.faces].mean(axis=1), a, b))
