"""Generated surfaces for figures, benchmarks and tests."""

import numpy as np
import trimesh

from abfm.mesh.directions import spread_directions
from abfm.mesh.triangle_mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_LIMBS = np.array(
    [[0, 1, 0.1], [-0.8, 0.5, 0.1], [0.9, 0.3, 0], [-0.5, -0.9, 0.2], [0.5, -1, -0.1]]
)


def even_sphere(count: int) -> TriangleMesh:
    """Return the convex hull of ``count`` evenly spread points of the unit sphere."""
    hull = trimesh.convex.convex_hull(spread_directions(count))
    return TriangleMesh(hull.vertices, hull.faces)


def five_limbs(count: int) -> TriangleMesh:
    """Return a flat body of ``count`` vertices with five limbs, made of long and thin triangles."""
    ball = even_sphere(count)
    cosines = ball.vertices @ (_LIMBS / np.linalg.norm(_LIMBS, axis=1)[:, None]).T
    reach = 1 + np.exp(8 * (cosines - 1)) @ np.array([1.2, 0.8, 0.9, 1, 1.1])
    return TriangleMesh(ball.vertices * reach[:, None] * [1, 1, 0.7], ball.faces)


def grid(n: int, m: int, around: bool) -> tuple[IntArray, IntArray, IntArray]:
    """Return the triangles of n x m squares, (2 n m, 3), and the row and column of each vertex.

    Diagonals alternate. If the grid is periodic (``around``), there are n x m vertices, else one
    row and one column more.
    """
    rows, columns = (n, m) if around else (n + 1, m + 1)
    i, j = np.indices((n, m)).reshape(2, -1)
    a, b, c, d = (
        ((i + p) % rows) * columns + (j + q) % columns for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))
    )
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(even, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    row, column = np.divmod(np.arange(rows * columns), columns)
    return np.concatenate([first, second]), row, column


def sphere(subdivisions: int) -> TriangleMesh:
    """Return the unit sphere with 10 * 4**subdivisions + 2 vertices and nearly even triangles."""
    shape = trimesh.creation.icosphere(subdivisions=subdivisions)
    return TriangleMesh(shape.vertices, shape.faces)


def two_armed(subdivisions: int) -> TriangleMesh:
    """Return a flat body with two curved arms and a symmetry of 180 degrees about z.

    It is ``sphere(subdivisions)``, stretched along x, flattened, and twisted by an angle that
    increases with the distance from the z axis. The rotation maps vertices to vertices.
    """
    ball = sphere(subdivisions)
    x, y, z = (ball.vertices * [1, 1, 0.5]).T
    stretch = 1 + 0.45 * (x * x - y * y)
    turned = (x + 1j * y) * stretch * np.exp(1.2j * np.hypot(x, y) * stretch)
    return TriangleMesh(np.stack([turned.real, turned.imag, z * stretch], axis=1), ball.faces)


def stepped_slab(squares: int) -> TriangleMesh:
    """Return a stepped slab of cubes, a surface with many sharp edges.

    The slab has 4 x 3 cubes without two opposite corners, and two more cubes on top. Every side of
    a cube has ``squares`` x ``squares`` squares of four triangles. The rotation by 180 degrees
    about z maps vertices to vertices.
    """
    slab = {(x, y, 0) for x in range(4) for y in range(3)} - {(0, 2, 0), (3, 0, 0)}
    cubes = slab | {(1, 1, 1), (2, 1, 1)}  # each cube by its lowest corner
    steps = np.indices((squares, squares)).reshape(2, -1).T[:, None]
    around = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = []  # (4, 3) corners of each square, in units of the side of a square
    for cube in sorted(cubes):
        for axis in range(3):
            for side in (0, 1):
                if tuple(np.add(cube, np.eye(3, dtype=int)[axis] * (2 * side - 1))) in cubes:
                    continue
                square = np.empty((len(steps), 4, 3), dtype=int)
                square[..., axis] = squares * (cube[axis] + side)
                across = [(axis + 1) % 3, (axis + 2) % 3]
                square[..., across] = (
                    squares * np.take(cube, across) + steps + (around if side else around[::-1])
                )
                corners.append(square)
    each = np.concatenate(corners)
    middle = np.repeat(each.mean(axis=1, keepdims=True), 4, axis=1)
    triangles = np.stack([each, np.roll(each, -1, axis=1), middle], axis=2).reshape(-1, 3)
    vertices, faces = np.unique(triangles, axis=0, return_inverse=True)
    return TriangleMesh(vertices / squares, faces.reshape(-1, 3))


def torus(n: int, m: int, R: float = 1.0, r: float = 0.45) -> TriangleMesh:
    """Return a torus about the y axis, with n x m vertices; n and m must be even.

    n vertices lie on the circle of radius R, m around the tube of radius r.
    """
    faces, i, j = grid(n, m, around=True)
    u, w = 2 * np.pi * i / n, 2 * np.pi * j / m
    ring = R + r * np.cos(w)
    points = np.stack([ring * np.sin(u), r * np.sin(w), ring * np.cos(u)], axis=1)
    return TriangleMesh(points, faces)


def geodesic_sphere(frequency: int) -> TriangleMesh:
    """Return the unit sphere as a subdivided icosahedron with 10 * frequency**2 + 2 vertices."""
    solid = trimesh.creation.icosahedron()
    i, j = np.indices((frequency + 1, frequency + 1)).reshape(2, -1)
    inside = i + j <= frequency
    number = np.cumsum(inside).reshape(frequency + 1, -1) - 1
    i, j = i[inside], j[inside]
    corners = solid.vertices[solid.faces] / frequency
    points = np.einsum("pc,fcx->fpx", np.stack([frequency - i - j, i, j], axis=1), corners)
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    up, down = (i + j < frequency), (i + j < frequency) & (i > 0)
    corners_of = ((up, (0, 0), (1, 0), (0, 1)), (down, (0, 0), (0, 1), (-1, 1)))
    triangles = [
        np.stack([number[i[some] + p, j[some] + q] for p, q in steps], axis=1)
        for some, *steps in corners_of
    ]
    of_one = np.concatenate(triangles)
    faces = np.concatenate([of_one + face * len(i) for face in range(len(corners))])
    points = points.reshape(-1, 3)
    rounded = np.round(points, 9)
    _, first, merged = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return TriangleMesh(points[first], merged.ravel()[faces])


def gourd(frequency: int) -> TriangleMesh:
    """Return a flattened surface of revolution about y with three bulges.

    The surface has 10 * frequency**2 + 2 vertices.
    """
    ball = geodesic_sphere(frequency)
    polar = np.arccos(np.clip(ball.vertices[:, 1], -1, 1))
    return TriangleMesh(ball.vertices * gourd_radius(polar)[:, None], ball.faces)


def gourd_radius(polar: FloatArray) -> FloatArray:
    """Return the distance of the surface `gourd` from its centre, for angles from the y axis."""
    ellipsoid = 1 / np.hypot(np.sin(polar) / 1.1, np.cos(polar) / 0.75)
    return np.asarray(ellipsoid * (1 + 0.16 * np.cos(4 * polar)))


def three_arms(subdivisions: int) -> tuple[TriangleMesh, tuple[int, int, int]]:
    """Return a flat body with the faces of ``sphere(subdivisions)``, and the tips of its arms.

    The first arm is thick and points upwards; the two others are thin and point downwards.
    """
    shape = trimesh.creation.icosphere(subdivisions=subdivisions)
    radius, tips = np.ones(len(shape.vertices)), []
    for degrees, height, sharpness in ((90, 1.5, 6), (-45, 1.4, 9), (-135, 1.4, 9)):
        along = shape.vertices @ [np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0]
        radius += height * np.exp(sharpness * (along - 1))
        tips.append(int(along.argmax()))
    mesh = TriangleMesh(radius[:, None] * shape.vertices * [1, 1, 0.7], shape.faces)
    return mesh, (tips[0], tips[1], tips[2])
