"""A coarser mesh of the same surface, with even triangles: edges collapse, shortest first, to their midpoints."""

from __future__ import annotations

import igl
import numpy as np

from abfm import own_process
from abfm.errors import MeshError
from abfm.mesh.topology import FloatArray, IntArray
from abfm.mesh.triangle_mesh import TriangleMesh
from abfm.own_process import OwnProcess, ProcessEndedError, Requests

_ENOUGH = 1.25  # a mesh that refuses to shrink to this times what was asked is no coarser mesh


def coarsened(mesh: TriangleMesh, vertex_count: int) -> TriangleMesh | None:
    """A mesh of about ``vertex_count`` vertices near the surface; None where the surface cannot be coarsened so far.

    Edges collapse in the order of their lengths, so that what comes out is far more even than what went in: needles
    are the first to go. Topology stays. Made once per mesh and count.
    """
    key = (__name__, vertex_count)
    if key not in mesh.cache:
        mesh.cache[key] = _collapse(mesh, vertex_count)
    found: TriangleMesh | None = mesh.cache[key]
    return found


def _collapse(mesh: TriangleMesh, vertex_count: int) -> TriangleMesh | None:
    count = len(mesh.vertices)
    faces = 2 * (vertex_count - mesh.euler_characteristic) - int(mesh.is_boundary_edge.sum() * vertex_count / count)
    if vertex_count >= count or faces < 4:
        return None
    vertices, triangles = _decimated(mesh.vertices, mesh.faces, faces)
    try:
        coarse = TriangleMesh(vertices, triangles)
    except MeshError:
        return None
    return coarse if len(coarse.vertices) <= _ENOUGH * vertex_count else None


def _decimated(vertices: FloatArray, faces: IntArray, face_count: int) -> tuple[FloatArray, IntArray]:
    """Collapse edges, in a process of its own where a window would stand still: igl keeps the interpreter to itself."""
    limit = own_process.factor_from
    if limit is None or len(vertices) < limit:
        return _decimate(vertices, faces, face_count)
    process = OwnProcess(__name__)
    try:
        process.send((vertices, faces, face_count))
        found: tuple[FloatArray, IntArray] = process.receive()
    except ProcessEndedError:
        raise MemoryError("the process that makes a coarser mesh has ended") from None
    finally:
        process.close()
    return found


def _decimate(vertices: FloatArray, faces: IntArray, face_count: int) -> tuple[FloatArray, IntArray]:
    fewer, triangles, *_ = igl.decimate(np.asfortranarray(vertices), np.asfortranarray(faces), face_count)
    return fewer, triangles


def _serve() -> None:
    requests = Requests()
    for vertices, faces, face_count in requests:
        requests.answer(_decimate(vertices, faces, face_count))


if __name__ == "__main__":
    _serve()
