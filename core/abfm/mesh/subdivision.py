"""Midpoint subdivision: every face is split into four similar faces on the same surface."""

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import MeshError
from abfm.mesh.draft import FileNumbers
from abfm.mesh.triangle_mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IntArray


def subdivided(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh with a new vertex in the middle of every edge: V + E vertices, 4 F faces.

    The old vertices keep their numbers, also those in the file. The middle of edge e becomes vertex
    ``V + e``. Face f is replaced by the faces ``4 f`` to ``4 f + 3``. Face ``4 f + c`` (c = 0, 1,
    2) lies at corner c of f, which is also its corner c. Face ``4 f + 3`` is the middle one. Its
    corner c lies opposite the corner c of f.

    Raises MeshError if new faces have no area.
    """
    middles = mesh.face_edges + len(mesh.vertices)
    children = np.repeat(middles[:, None], 4, axis=1)
    for c in range(3):
        children[:, c, c] = mesh.faces[:, c]
        children[:, c, (c + 1) % 3] = middles[:, (c + 2) % 3]
        children[:, c, (c + 2) % 3] = middles[:, (c + 1) % 3]
    count = mesh.file_vertex_count
    ids = np.concatenate([mesh.vertex_ids, count + np.arange(len(mesh.edges))])
    numbers = FileNumbers(ids, count + len(mesh.edges), mesh.copies)
    vertices = interpolated(mesh, mesh.vertices)
    return TriangleMesh(vertices, children.reshape(-1, 3), numbers=numbers)


_cached_subdivided = per_mesh(subdivided)


def refined(mesh: TriangleMesh, k: int) -> TriangleMesh:
    """Return the mesh `subdivided` k times; it is cached with the mesh."""
    for _ in range(k):
        mesh = _cached_subdivided(mesh)
    return mesh


def interpolated(mesh: TriangleMesh, values: ArrayLike, k: int = 1) -> FloatArray:
    """Interpolate a vertex function (V, ...) to the vertices of the mesh subdivided k times."""
    found = np.asarray(values, dtype=np.float64)
    for level in range(k):
        start, end = refined(mesh, level).edges.T
        found = np.concatenate([found, found[start] / 2 + found[end] / 2])
    return found


def times_subdivided(faces: int, mesh: TriangleMesh) -> int:
    """Return k such that the mesh subdivided k times has this number of ``faces``.

    Raises MeshError if there is no such k.
    """
    count = len(mesh.faces)
    k = max(faces // count, 1).bit_length() // 2
    if faces != 4**k * count:
        raise MeshError(
            f"the number of faces is {faces}; expected {count}, as the mesh has, or the number of "
            f"its midpoint subdivisions: {4 * count}, {16 * count}, ..."
        )
    return k


def mean_of_children(fields: FloatArray, faces: int) -> FloatArray:
    """Average fields (N, 4^k F, 3) of a mesh subdivided k times over the children of each face.

    The result has shape (N, F, 3). All children of a face have the same area.
    """
    if fields.shape[1] == faces:
        return fields
    return np.asarray(fields.reshape(len(fields), faces, -1, 3).mean(axis=2))


def to_children(
    faces: IntArray, barycentric: FloatArray, k: int = 1
) -> tuple[IntArray, FloatArray]:
    """Convert points of a mesh to faces (P,) and weights (P, 3) on the mesh subdivided k times."""
    for _ in range(k):
        corner, largest = barycentric.argmax(axis=1), barycentric.max(axis=1)
        outer = largest >= 0.5
        inside = np.maximum(1 - 2 * barycentric, 0)
        at_corner = 2 * barycentric
        at_corner[np.arange(len(faces)), corner] -= 1
        faces = 4 * faces + np.where(outer, corner, 3)
        barycentric = np.where(outer[:, None], at_corner, inside)
    return faces, barycentric


def to_parents(faces: IntArray, barycentric: FloatArray, k: int = 1) -> tuple[IntArray, FloatArray]:
    """Convert points on the mesh subdivided k times to points of the mesh, unlike `to_children`."""
    for _ in range(k):
        parents, child = np.divmod(faces, 4)
        middle = (1 - barycentric) / 2
        at_corner = barycentric / 2
        outer = child < 3
        at_corner[outer, child[outer]] += 0.5
        faces, barycentric = parents, np.where(outer[:, None], at_corner, middle)
    return faces, barycentric
