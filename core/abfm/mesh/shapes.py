"""Generated surfaces that experiments and measurements share."""

import numpy as np
import trimesh

from abfm.mesh.triangle_mesh import TriangleMesh
from abfm.types import IntArray

_LIMBS = np.array([[0, 1, 0.1], [-0.8, 0.5, 0.1], [0.9, 0.3, 0], [-0.5, -0.9, 0.2], [0.5, -1, -0.1]])


def even_sphere(count: int) -> TriangleMesh:
    """Evenly spread points of the unit sphere, and their convex hull."""
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    hull = trimesh.convex.convex_hull(np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1))
    return TriangleMesh(hull.vertices, hull.faces)


def five_limbs(count: int) -> TriangleMesh:
    """A flat smooth body with five limbs of different lengths, whose triangles are long and thin, without symmetry."""
    ball = even_sphere(count)
    cosines = ball.vertices @ (_LIMBS / np.linalg.norm(_LIMBS, axis=1)[:, None]).T
    reach = 1 + np.exp(8 * (cosines - 1)) @ np.array([1.2, 0.8, 0.9, 1, 1.1])
    return TriangleMesh(ball.vertices * reach[:, None] * [1, 1, 0.7], ball.faces)


def grid(n: int, m: int, around: bool) -> tuple[IntArray, IntArray, IntArray]:
    """The squares of a grid as two triangles each, (2 n m, 3), and the rows and columns of its vertices.

    Diagonals alternate. Of n x m squares the grid has as many vertices where it closes around, else one row and one
    column more.
    """
    rows, columns = (n, m) if around else (n + 1, m + 1)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    a, b, c, d = (((i + p) % rows) * columns + (j + q) % columns for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(even, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    row, column = np.divmod(np.arange(rows * columns), columns)
    return np.concatenate([first, second]), row, column
