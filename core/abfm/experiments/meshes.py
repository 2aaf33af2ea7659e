"""Meshes of the experiments: the bundled ones, each read once, and generated shapes."""

from functools import lru_cache

import numpy as np
import trimesh

from abfm.assets import asset_path
from abfm.mesh import TriangleMesh, load_mesh, shapes
from abfm.types import FloatArray


@lru_cache
def bundled(name: str) -> TriangleMesh:
    """A mesh that comes with abfm; the same object every time, so that what was computed on it is kept."""
    return load_mesh(asset_path(name))


@lru_cache
def sphere(subdivisions: int) -> TriangleMesh:
    """Unit sphere with 10 * 4**subdivisions + 2 vertices, nearly even triangles."""
    shape = trimesh.creation.icosphere(subdivisions=subdivisions)
    return TriangleMesh(shape.vertices, shape.faces)


@lru_cache
def smoothed(name: str, times: int) -> TriangleMesh:
    """A bundled mesh after Loop subdivision: each time four times as many faces, and smoother."""
    mesh = bundled(name)
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).subdivide_loop(times)
    return TriangleMesh(shape.vertices, shape.faces)


five_limbs = lru_cache(shapes.five_limbs)


@lru_cache
def two_armed(subdivisions: int) -> TriangleMesh:
    """Flat body with two curved arms that the rotation by 180 degrees about z exchanges, vertex by vertex.

    A sphere with its vertices in pairs about z, drawn out along x, flattened, and turned the more the farther out.
    """
    x, y, z = (sphere(subdivisions).vertices * [1, 1, 0.5]).T
    stretch = 1 + 0.45 * (x * x - y * y)
    turned = (x + 1j * y) * stretch * np.exp(1.2j * np.hypot(x, y) * stretch)
    return TriangleMesh(np.stack([turned.real, turned.imag, z * stretch], axis=1), sphere(subdivisions).faces)


@lru_cache
def stepped_slab(squares: int) -> TriangleMesh:
    """Slab of 4 x 3 cubes without two opposite ones at its corners, with two cubes on top: all edges are creases.

    Every side of a cube has ``squares`` x ``squares`` squares of four triangles. The rotation by 180 degrees about z
    carries vertices to vertices.
    """
    slab = {(x, y, 0) for x in range(4) for y in range(3)} - {(0, 2, 0), (3, 0, 0)}
    return _cubes(slab | {(1, 1, 1), (2, 1, 1)}, squares)


def _cubes(cubes: set[tuple[int, int, int]], squares: int) -> TriangleMesh:
    """Surface of a union of unit cubes, given by their lowest corners."""
    steps = np.stack(np.meshgrid(np.arange(squares), np.arange(squares), indexing="ij"), axis=-1).reshape(-1, 1, 2)
    around = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = []  # of all squares, (4, 3) each, in squares' sides
    for cube in sorted(cubes):
        for axis in range(3):
            for side in (0, 1):
                if tuple(np.add(cube, np.eye(3, dtype=int)[axis] * (2 * side - 1))) in cubes:
                    continue
                square = np.empty((len(steps), 4, 3), dtype=int)
                square[..., axis] = squares * (cube[axis] + side)
                across = [(axis + 1) % 3, (axis + 2) % 3]
                square[..., across] = squares * np.take(cube, across) + steps + (around if side else around[::-1])
                corners.append(square)
    each = np.concatenate(corners)
    middle = np.repeat(each.mean(axis=1, keepdims=True), 4, axis=1)
    triangles = np.stack([each, np.roll(each, -1, axis=1), middle], axis=2).reshape(-1, 3)
    vertices, faces = np.unique(triangles, axis=0, return_inverse=True)
    return TriangleMesh(vertices / squares, faces.reshape(-1, 3))


@lru_cache
def torus(n: int, m: int, R: float = 1.0, r: float = 0.45) -> TriangleMesh:
    """Torus about the y axis: n vertices around it at distance R, m around the tube of radius r; both numbers even."""
    faces, i, j = shapes.grid(n, m, around=True)
    u, w = 2 * np.pi * i / n, 2 * np.pi * j / m
    ring = R + r * np.cos(w)
    return TriangleMesh(np.stack([ring * np.sin(u), r * np.sin(w), ring * np.cos(u)], axis=1), faces)


@lru_cache
def geodesic_sphere(frequency: int) -> TriangleMesh:
    """Unit sphere with 10 * frequency**2 + 2 vertices: an icosahedron's faces in even triangles, projected."""
    solid = trimesh.creation.icosahedron()
    i, j = (index.ravel() for index in np.meshgrid(*[np.arange(frequency + 1)] * 2, indexing="ij"))
    inside = i + j <= frequency
    number = np.cumsum(inside).reshape(frequency + 1, -1) - 1
    i, j = i[inside], j[inside]
    corners = solid.vertices[solid.faces] / frequency
    points = np.einsum("pc,fcx->fpx", np.stack([frequency - i - j, i, j], axis=1), corners)
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    up, down = (i + j < frequency), (i + j < frequency) & (i > 0)
    corners_of = ((up, (0, 0), (1, 0), (0, 1)), (down, (0, 0), (0, 1), (-1, 1)))
    triangles = np.concatenate(
        [np.stack([number[i[some] + p, j[some] + q] for p, q in steps], axis=1) for some, *steps in corners_of]
    )
    faces = np.concatenate([triangles + face * len(i) for face in range(len(corners))])
    _, kept, merged = np.unique(np.round(points.reshape(-1, 3), 9), axis=0, return_index=True, return_inverse=True)
    return TriangleMesh(points.reshape(-1, 3)[kept], merged.ravel()[faces])


@lru_cache
def gourd(frequency: int) -> TriangleMesh:
    """A squat surface of revolution about the y axis with three bulges, 10 * frequency**2 + 2 vertices."""
    ball = geodesic_sphere(frequency).vertices
    polar = np.arccos(np.clip(ball[:, 1], -1, 1))
    return TriangleMesh(ball * gourd_radius(polar)[:, None], geodesic_sphere(frequency).faces)


def gourd_radius(polar: FloatArray) -> FloatArray:
    """Distance of the `gourd` from its centre, by the angle from the y axis."""
    squat = 1 / np.hypot(np.sin(polar) / 1.1, np.cos(polar) / 0.75)
    return np.asarray(squat * (1 + 0.16 * np.cos(4 * polar)))


@lru_cache
def three_arms(subdivisions: int) -> tuple[TriangleMesh, tuple[int, int, int]]:
    """Smooth flat body with a thick arm upwards and two thin ones downwards, and the vertices at their ends."""
    shape = trimesh.creation.icosphere(subdivisions=subdivisions)
    radius, tips = np.ones(len(shape.vertices)), []
    for degrees, height, sharpness in ((90, 1.5, 6), (-45, 1.4, 9), (-135, 1.4, 9)):
        along = shape.vertices @ [np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0]
        radius += height * np.exp(sharpness * (along - 1))
        tips.append(int(along.argmax()))
    return TriangleMesh(radius[:, None] * shape.vertices * [1, 1, 0.7], shape.faces), (tips[0], tips[1], tips[2])
