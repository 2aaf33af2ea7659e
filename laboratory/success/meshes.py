"""Surfaces on which matches are tried: the bundled ones and generated ones, closed and open,
even and not.
"""

import numpy as np

from abfm.assets import asset_names, asset_path
from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.shapes import even_sphere, five_limbs, grid

_BUMPS = 9


def success_meshes() -> dict[str, TriangleMesh]:
    """Return all of them, by name: 300 to 12,300 vertices."""
    ball = even_sphere(5_000)
    return {
        "sphere": even_sphere(12_000),
        "ellipsoid": TriangleMesh(ball.vertices * [1, 0.7, 0.45], ball.faces),
        "bumpy": _bumpy(8_000),
        "limbs": five_limbs(5_000),
        "torus": torus(120, 50),
        "square": _square(60),
        **{name: load_mesh(asset_path(name)) for name in asset_names() if name.endswith(".off")},
    }


def _bumpy(count: int) -> TriangleMesh:
    """Return a sphere with bumps and dents in random places."""
    rng = np.random.default_rng(_BUMPS)
    places = rng.normal(size=(_BUMPS, 3))
    places /= np.linalg.norm(places, axis=1)[:, None]
    heights = rng.uniform(-0.25, 0.5, _BUMPS)
    ball = even_sphere(count)
    radius = 1 + np.exp(12 * (ball.vertices @ places.T - 1)) @ heights
    return TriangleMesh(ball.vertices * radius[:, None], ball.faces)


def torus(n: int, m: int, R: float = 1.0, r: float = 0.4) -> TriangleMesh:
    """Return a torus about the z axis: n vertices around it, m around the tube."""
    u, w = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    around, tube = 2 * np.pi * u / n, 2 * np.pi * w / m
    ring = R + r * np.cos(tube)
    vertices = np.stack([ring * np.cos(around), ring * np.sin(around), r * np.sin(tube)], axis=1)
    a, b, c, d = (((u + p) % n) * m + (w + q) % m for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return TriangleMesh(
        vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    )


def _square(n: int) -> TriangleMesh:
    """Return a unit square of n x n cells that are smoothly uneven: a surface with a boundary."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    x, y = (
        x + 0.08 * np.sin(np.pi * x) * np.cos(2 * y + 0.3),
        y + 0.06 * np.sin(np.pi * y) * np.sin(3 * x + 0.5),
    )
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return TriangleMesh(vertices, grid(n, n, around=False)[0])
