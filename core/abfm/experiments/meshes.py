"""Meshes of the experiments: the bundled ones, each read once, and generated shapes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import trimesh

from abfm.assets import asset_path
from abfm.mesh import TriangleMesh, load_mesh


@lru_cache
def bundled(name: str) -> TriangleMesh:
    """A mesh that comes with abfm; the same object every time, so that what was computed on it is kept."""
    return load_mesh(asset_path(name))


@lru_cache
def sphere(subdivisions: int) -> TriangleMesh:
    """Unit sphere with 10 * 4**subdivisions + 2 vertices, nearly even triangles."""
    shape = trimesh.creation.icosphere(subdivisions=subdivisions)
    return TriangleMesh(shape.vertices, shape.faces)


@lru_cache
def smoothed(name: str, times: int) -> TriangleMesh:
    """A bundled mesh after Loop subdivision: each time four times as many faces, and smoother."""
    mesh = bundled(name)
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).subdivide_loop(times)
    return TriangleMesh(shape.vertices, shape.faces)


@lru_cache
def five_limbs(vertices: int) -> TriangleMesh:
    """A smooth body with five limbs of different lengths, without symmetry, from evenly spread points of a sphere."""
    k = np.arange(vertices)
    z = 1 - (2 * k + 1) / vertices
    angle = np.pi * (3 - np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    shape = trimesh.convex.convex_hull(np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1))
    limbs = np.array([[0, 1, 0.1], [-0.8, 0.5, 0.1], [0.9, 0.3, 0], [-0.5, -0.9, 0.2], [0.5, -1, -0.1]])
    limbs /= np.linalg.norm(limbs, axis=1)[:, None]
    reach = 1 + np.exp(8 * (shape.vertices @ limbs.T - 1)) @ np.array([1.2, 0.8, 0.9, 1, 1.1])
    return TriangleMesh(shape.vertices * reach[:, None] * [1, 1, 0.7], shape.faces)
