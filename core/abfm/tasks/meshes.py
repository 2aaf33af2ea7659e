"""Meshes of tasks; each process caches the last few meshes with their operators."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.options import MeshOptions
from abfm.tasks.inputs import mesh_options

_MESHES_CACHED_MAX = 3


def mesh_of(path: str, values: Mapping[str, Any]) -> TriangleMesh:
    """Load a mesh file with the mesh options in ``values``; the last three meshes are cached."""
    try:
        status = os.stat(path)
        fingerprint = status.st_size, status.st_mtime_ns
    except (OSError, ValueError):
        fingerprint = 0, 0  # loading the mesh reports the cause
    return _loaded(path, fingerprint, mesh_options(values))


@lru_cache(maxsize=_MESHES_CACHED_MAX)
def _loaded(path: str, fingerprint: tuple[int, int], options: MeshOptions) -> TriangleMesh:
    return load_mesh(path, **options.changed)


def mesh_notes(*meshes: TriangleMesh) -> list[str]:
    return [message for mesh in meshes for message in mesh.messages]
