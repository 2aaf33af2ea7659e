"""A coarser mesh of the same surface, with even triangles: edges collapse, shortest first, to
their midpoints.
"""

import numpy as np

from abfm.errors import MeshError
from abfm.mesh.edge_collapse import Surface, collapse_edges
from abfm.mesh.topology import next_corner
from abfm.mesh.triangle_mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IntArray

_SMALL = np.int32  # enough for slots of 700 million faces
_ENOUGH = 1.25  # a mesh that refuses to shrink to this times what was asked is no coarser mesh


@per_mesh
def coarsened(mesh: TriangleMesh, vertex_count: int) -> TriangleMesh | None:
    """Return a mesh of about ``vertex_count`` vertices near the surface; None where the surface
    cannot be coarsened so far.

    Edges collapse in the order of their lengths, so that what comes out is far more even than what
    went in: needles are the first to go. Topology stays. Made once per mesh and count.
    """
    count = len(mesh.vertices)
    faces = 2 * (vertex_count - mesh.euler_characteristic) - int(
        mesh.is_boundary_edge.sum() * vertex_count / count
    )
    if vertex_count >= count or faces < 4:
        return None
    vertices, triangles = _collapse_edges(mesh, faces)
    try:
        coarse = TriangleMesh(vertices, triangles)
    except MeshError:
        return None
    return coarse if len(coarse.vertices) <= _ENOUGH * vertex_count else None


def _collapse_edges(mesh: TriangleMesh, face_count: int) -> tuple[FloatArray, IntArray]:
    """Return the vertices and faces that are left; pinched vertices stay as they are, with all
    their edges.
    """
    count = len(mesh.vertices)
    points = np.concatenate([mesh.vertices, np.zeros((1, 3))])  # and one at infinity
    faces, twins, edges = (array.astype(_SMALL) for array in _closed(mesh))
    lengths = ((mesh.vertices[mesh.edges[:, 0]] - mesh.vertices[mesh.edges[:, 1]]) ** 2).sum(axis=1)
    fixed = np.append(mesh.is_pinched_vertex, True)
    keys = np.full(edges.max() + 1, np.inf)
    keys[: len(lengths)] = np.where(fixed[mesh.edges].any(axis=1), np.inf, lengths)
    order = np.argsort(keys, kind="stable")
    surface = Surface(points, faces, twins, edges, fixed)
    collapse_edges(surface, order.astype(_SMALL), keys, len(mesh.faces), face_count)
    left = faces[: mesh.faces.size].reshape(-1, 3)
    left = left[left[:, 0] >= 0]
    used = np.zeros(count, dtype=bool)
    used[left] = True
    return points[:count][used], (np.cumsum(used) - 1)[left]


def _closed(mesh: TriangleMesh) -> tuple[IntArray, IntArray, IntArray]:
    """Return vertex, other slot and edge of every slot (3 F,), with faces to a vertex at infinity
    on the boundary.
    """
    inner, outer = (
        mesh.edge_slots[~mesh.is_boundary_edge],
        mesh.edge_slots[mesh.is_boundary_edge, 0],
    )
    new = 3 * (len(mesh.faces) + np.arange(len(outer)))
    start = next_corner(outer)
    ends = next_corner(start)
    faces = np.stack(
        [
            np.full(len(outer), len(mesh.vertices)),
            mesh.faces.ravel()[ends],
            mesh.faces.ravel()[start],
        ]
    )
    twins = np.empty(mesh.faces.size + 3 * len(outer), dtype=np.int64)
    twins[inner] = inner[:, ::-1]
    twins[new], twins[outer] = outer, new
    # around the boundary: the face after one that ends at a fan begins there
    fans = mesh.corner_fans.ravel()
    before, after = np.argsort(fans[ends], kind="stable"), np.argsort(fans[start], kind="stable")
    twins[new[before] + 2], twins[new[after] + 1] = new[after] + 1, new[before] + 2
    edges = np.empty_like(twins)
    edges[: mesh.faces.size] = mesh.face_edges.ravel()
    edges[new] = edges[outer]
    edges[new[before] + 2] = edges[new[after] + 1] = len(mesh.edges) + np.arange(len(outer))
    return np.concatenate([mesh.faces.ravel(), faces.T.ravel()]), twins, edges
