"""Surfaces on which matches are tried: the bundled ones and generated ones, closed and open, even and not."""

from __future__ import annotations

import numpy as np
import trimesh

from abfm.assets import asset_names, asset_path
from abfm.mesh import TriangleMesh, load_mesh
from abfm.types import FloatArray

_BUMPS = 9
_LIMBS = np.array([[0, 1, 0.1], [-0.8, 0.5, 0.1], [0.9, 0.3, 0], [-0.5, -0.9, 0.2], [0.5, -1, -0.1]])


def success_meshes() -> dict[str, TriangleMesh]:
    """All of them, by name: 300 to 12,300 vertices."""
    return {**_generated(), **{name: load_mesh(asset_path(name)) for name in asset_names() if name.endswith(".off")}}


def _generated() -> dict[str, TriangleMesh]:
    return {
        "sphere": _body(12_000),
        "ellipsoid": _body(5_000, np.array([1, 0.7, 0.45])),
        "bumpy": _bumpy(8_000),
        "limbs": _limbs(5_000),
        "torus": torus(120, 50),
        "square": _square(60),
    }


def _directions(count: int) -> TriangleMesh:
    """Evenly spread points of the unit sphere, and their convex hull."""
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    hull = trimesh.convex.convex_hull(np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1))
    return TriangleMesh(hull.vertices, hull.faces)


def _body(count: int, axes: FloatArray | float = 1.0, radius: FloatArray | float = 1.0) -> TriangleMesh:
    sphere = _directions(count)
    return TriangleMesh(sphere.vertices * np.reshape(radius, (-1, 1)) * axes, sphere.faces)


def _bumpy(count: int) -> TriangleMesh:
    """A sphere with bumps and dents in random places."""
    rng = np.random.default_rng(_BUMPS)
    places = rng.normal(size=(_BUMPS, 3))
    places /= np.linalg.norm(places, axis=1)[:, None]
    heights = rng.uniform(-0.25, 0.5, _BUMPS)
    cosines = _directions(count).vertices @ places.T
    return _body(count, radius=1 + np.exp(12 * (cosines - 1)) @ heights)


def _limbs(count: int) -> TriangleMesh:
    """A flat body with five limbs of different lengths, whose triangles are long and thin."""
    cosines = _directions(count).vertices @ (_LIMBS / np.linalg.norm(_LIMBS, axis=1)[:, None]).T
    radius = 1 + np.exp(8 * (cosines - 1)) @ np.array([1.2, 0.8, 0.9, 1, 1.1])
    return _body(count, np.array([1, 1, 0.7]), radius)


def torus(n: int, m: int, R: float = 1.0, r: float = 0.4) -> TriangleMesh:
    """Torus about the z axis: n vertices around it, m around the tube."""
    u, w = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    around, tube = 2 * np.pi * u / n, 2 * np.pi * w / m
    ring = R + r * np.cos(tube)
    vertices = np.stack([ring * np.cos(around), ring * np.sin(around), r * np.sin(tube)], axis=1)
    a, b, c, d = (((u + p) % n) * m + (w + q) % m for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return TriangleMesh(vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))


def _square(n: int) -> TriangleMesh:
    """Unit square of n x n cells that are smoothly uneven: a surface with a boundary."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    x, y = (
        x + 0.08 * np.sin(np.pi * x) * np.cos(2 * y + 0.3),
        y + 0.06 * np.sin(np.pi * y) * np.sin(3 * x + 0.5),
    )
    i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a, b, c, d = ((i + p) * (n + 1) + j + q for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    even = ((i + j) % 2 == 0)[:, None]  # diagonals alternate
    first = np.where(even, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(even, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return TriangleMesh(vertices, np.concatenate([first, second]))
