"""Flat strips along curves on a surface, in units of the square root of its area."""

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.mesh import per_mesh
from abfm.types import FloatArray, IntArray

Triangles = tuple[FloatArray, IntArray]  # vertices (V, 3) and faces (F, 3)


def strips(places: FloatArray, normals: FloatArray, half_widths: FloatArray) -> Triangles:
    """Return triangles of n flat strips along curves on a surface.

    Strip i follows points ``places[i]`` (K, 3), with surface normals ``normals[i]`` (K, 3) and half
    widths ``half_widths[i]`` (K,). The faces are counterclockwise seen from outside.
    """
    count, nodes = half_widths.shape
    side = half_widths[:, :, None] * unit(np.cross(normals, np.gradient(places, axis=1)))
    vertices = np.stack([places - side, places + side], axis=2).reshape(-1, 3)
    first = 2 * (np.arange(nodes - 1) + nodes * np.arange(count)[:, None]).reshape(-1, 1)
    return vertices, np.concatenate([first + np.array([0, 2, 1]), first + np.array([1, 2, 3])])


def unit(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3), scaled to length 1; zero vectors stay zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def normals_at(mesh: TriangleMesh, faces: IntArray, barycentric: FloatArray) -> FloatArray:
    """Return unit normals (K, 3) at K points, given by faces (K,) and barycentric weights (K, 3).

    They are interpolated from the normals of the vertices.
    """
    return unit(np.einsum("kc,kcx->kx", barycentric, vertex_normals(mesh)[mesh.faces[faces]]))


@per_mesh
def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Return outward unit normals of the vertices, (V, 3)."""
    return outward(mesh) * abfm.functions.vertex_normals(mesh)


def outward(mesh: TriangleMesh) -> int:
    """Return 1 if the normals of a mesh point outward, or -1 if they point inward."""
    return -1 if mesh.is_inside_out else 1
