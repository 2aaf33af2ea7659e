"""Transformations of meshes: motions, scalings and renumberings, with functions and fields."""

from dataclasses import dataclass

import numpy as np
from hypothesis import Phase, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from abfm.mesh import TriangleMesh
from tests.shapes import icosphere, square, torus


def potato(subdivisions):
    sphere = icosphere(subdivisions)
    x, y, z = sphere.vertices.T
    radius = 1 + 0.3 * np.sin(2 * x + 0.4) * np.cos(3 * y - 1) + 0.2 * z * x + 0.15 * y
    return TriangleMesh(sphere.vertices * radius[:, None] * [1, 1.3, 0.8], sphere.faces)


def face(subdivisions):
    """Return a closed surface with one mirror plane, x = 0."""
    sphere = icosphere(subdivisions)
    x, y, z = sphere.vertices.T
    radius = 1 + 0.3 * z + 0.2 * y * z - 0.2 * x**2
    return TriangleMesh(sphere.vertices * radius[:, None], sphere.faces)


MESHES = {"potato": potato(2), "torus": torus(14, 9), "square": square(6)}


def examples(count):
    """Return settings with ``count`` deterministic cases and without shrinking, which is slow."""
    return settings(max_examples=count, phases=(Phase.explicit, Phase.generate), derandomize=True)


@dataclass(frozen=True)
class Move:
    """A rotation, a scaling, a translation in sqrt(area), and a renumbering."""

    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seed: int | None = None  # of the renumbering; None keeps the numbers

    @property
    def rotation(self):
        return Rotation.from_rotvec(self.turn).as_matrix()

    def places(self, mesh, points):
        """Return where points in space (..., 3) lie after the move."""
        return self.scale * (points @ self.rotation.T + mesh.length_scale * np.asarray(self.shift))

    def numbers(self, mesh):
        """Return the old number of each vertex and of each face of the moved mesh."""
        if self.seed is None:
            return np.arange(len(mesh.vertices)), np.arange(len(mesh.faces))
        rng = np.random.default_rng(self.seed)
        return rng.permutation(len(mesh.vertices)), rng.permutation(len(mesh.faces))

    def mesh(self, mesh):
        vertices, faces = self.numbers(mesh)
        firsts = np.zeros(len(faces), dtype=int)
        if self.seed is not None:
            firsts = np.random.default_rng(self.seed).integers(3, size=len(faces))
        corners = (np.arange(3) + firsts[:, None]) % 3
        corners = np.argsort(vertices)[np.take_along_axis(mesh.faces[faces], corners, axis=1)]
        return TriangleMesh(self.places(mesh, mesh.vertices[vertices]), corners)

    def function(self, mesh, f, power=0):
        """Return a function on vertices (V, ...) of the moved mesh; its unit is length**power."""
        return self.scale**power * f[self.numbers(mesh)[0]]

    def on_faces(self, mesh, f, power=0):
        """Return values on the faces (F,) of the moved mesh; their unit is length**power."""
        return self.scale**power * f[self.numbers(mesh)[1]]

    def field(self, mesh, v, power=1):
        """Return vectors on the faces (F, 3) of the moved mesh; their unit is length**power."""
        return self.scale**power * (v @ self.rotation.T)[self.numbers(mesh)[1]]


MOVES = st.builds(
    Move,
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    scale=st.floats(-6, 6).map(lambda exponent: 10.0**exponent),
    shift=st.tuples(*[st.floats(-5, 5)] * 3),
    seed=st.none() | st.integers(0, 1000),
)
