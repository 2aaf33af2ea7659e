"""Kernels over the faces of a mesh: their shapes, and the gradients of functions on vertices and
edges.

Vectors are coefficients in the frames of `shapes`. Edge functions (Crouzeix-Raviart) have the
gradient ``-2`` times that of the hat function of the corner opposite to their edge; gradients of
vertex functions are rotated by a right angle, so that the two are orthogonal.
"""

from typing import NamedTuple

import numpy as np

from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray


class FaceShapes(NamedTuple):
    """Shapes of faces."""

    normals: FloatArray  # (F, 3), of length 1
    areas: FloatArray  # (F,)
    frames: FloatArray  # (F, 2, 3), the first axis along the first edge
    gradients: FloatArray  # (F, 3, 2), of the hat functions of the corners


class FaceSlopes(NamedTuple):
    """Gradients of the functions of edges and vertices around each face."""

    gradients: FloatArray  # (F, 3, 2), of the hat functions of the corners
    edges: IndexArray  # (F, 3), opposite the corners
    vertices: IndexArray  # (F, 3)


@kernel
def shapes(vertices: FloatArray, faces: IndexArray, found: FaceShapes) -> None:
    """Compute the shapes of faces (F, 3)."""
    normals, areas, frames, gradients = found
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        u, v, w = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        i, j, k = y * w - z * v, z * u - x * w, x * v - y * u
        twice = np.sqrt(i * i + j * j + k * k)
        base = np.sqrt(x * x + y * y + z * z)
        normals[f, 0], normals[f, 1], normals[f, 2] = i / twice, j / twice, k / twice
        areas[f] = 0.5 * twice
        n, e = normals[f], frames[f]
        e[0, 0], e[0, 1], e[0, 2] = x / base, y / base, z / base
        e[1, 0] = n[1] * e[0, 2] - n[2] * e[0, 1]
        e[1, 1] = n[2] * e[0, 0] - n[0] * e[0, 2]
        e[1, 2] = n[0] * e[0, 1] - n[1] * e[0, 0]
        along = u * e[0, 0] + v * e[0, 1] + w * e[0, 2]
        height = u * e[1, 0] + v * e[1, 1] + w * e[1, 2]
        g = gradients[f]
        g[0, 0], g[0, 1] = -height / twice, (along - base) / twice
        g[1, 0], g[1, 1] = height / twice, -along / twice
        g[2, 0], g[2, 1] = 0.0, base / twice


@kernel
def add_products(
    faces: FaceSlopes, v: FloatArray, of_edges: FloatArray, of_vertices: FloatArray
) -> None:
    """Add to edges and vertices the products of a field (F, 2) with their functions' gradients."""
    gradients, edges, vertices = faces
    for f in range(edges.shape[0]):
        for c in range(3):
            x, y = gradients[f, c, 0], gradients[f, c, 1]
            of_edges[edges[f, c]] -= 2.0 * (x * v[f, 0] + y * v[f, 1])
            of_vertices[vertices[f, c]] += x * v[f, 1] - y * v[f, 0]


@kernel
def add_gradients(
    faces: FaceSlopes,
    on_edges: FloatArray,
    on_vertices: FloatArray,
    factors: FloatArray,
    out: FloatArray,
) -> None:
    """Add to a field (F, 2) gradients of functions on edges and vertices, times factors (F,)."""
    gradients, edges, vertices = faces
    for f in range(edges.shape[0]):
        first, second = 0.0, 0.0
        for c in range(3):
            x, y = gradients[f, c, 0], gradients[f, c, 1]
            edge, vertex = -2.0 * on_edges[edges[f, c]], on_vertices[vertices[f, c]]
            first += edge * x - vertex * y
            second += edge * y + vertex * x
        out[f, 0] += factors[f] * first
        out[f, 1] += factors[f] * second


@kernel
def stiffnesses(gradients: FloatArray, weights: FloatArray, out: FloatArray) -> None:
    """Compute weighted products of the gradients of each face's three hat functions, (F, 3, 3)."""
    for f in range(weights.size):
        for a in range(3):
            for b in range(3):
                product = (
                    gradients[f, a, 0] * gradients[f, b, 0]
                    + gradients[f, a, 1] * gradients[f, b, 1]
                )
                out[f, a, b] = weights[f] * product
