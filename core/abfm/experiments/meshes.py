"""Meshes of the experiments: the bundled ones, each read once, and generated shapes."""

from __future__ import annotations

from functools import lru_cache

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
