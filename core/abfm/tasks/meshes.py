"""Meshes of tasks: a process keeps the last few that it read, with what was computed from them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.options import MeshOptions
from abfm.tasks.inputs import mesh_options

_MESHES_KEPT = 3


def mesh_of(path: str, values: Mapping[str, Any]) -> TriangleMesh:
    """Read a mesh with the options among values by name, unless this process has it already."""
    try:
        status = os.stat(path)
        changed = status.st_size, status.st_mtime_ns
    except (OSError, ValueError):
        changed = 0, 0  # reading it reports why
    return _loaded(path, changed, mesh_options(values))


@lru_cache(maxsize=_MESHES_KEPT)
def _loaded(path: str, changed: tuple[int, int], options: MeshOptions) -> TriangleMesh:
    return load_mesh(path, **options.given)


def mesh_notes(*meshes: TriangleMesh) -> list[str]:
    """Return what was repaired in meshes, one line each."""
    return [message for mesh in meshes for message in mesh.messages]
