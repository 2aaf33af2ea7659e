"""Textures on a sphere whose motion is known exactly, at one interval each.

    python -m laboratory.textures [--jobs N] [--write docs/sequences.md]

Textures are sums of random plane waves in space, evaluated where an exact tracer finds the origin
of each vertex, so that no interpolation favours a method. The fields are a rotation, and the sum of
a gradient and a rotated gradient of random waves.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from abfm import TriangleMesh, sequence
from abfm.batch import Cluster
from abfm.calculus.operators import edge_lengths, face_areas, gradient
from abfm.mesh.shapes import sphere
from abfm.sequences import defaults
from abfm.types import BoolArray, FloatArray
from laboratory.common import mapped, put_between, told_table
from laboratory.motion import angles, cells, tuned

TEXTURES = {"smooth": 20.0, "rough": 9.0}
"""Wavelength, in mean edges."""
MOTIONS = ("turn", "waves")
NOISES = (0.0, 0.05, 0.1)
"""Standard deviation, of the frames'."""
DISPLACEMENTS = (0.25, 0.5, 1.0, 2.5, 4.0)
"""Root mean square, in mean edges."""
LEVELS = (3, 4, 5)
"""Subdivisions of spheres of 642, 2,562 and 10,242 vertices, whose errors are compared by size."""
SIZE_NOISES = (0.0, 0.1)
SIZE = 4
"""Subdivisions of all other spheres."""
HEADS = (
    "vertices",
    "texture",
    "motion",
    "noise",
    "edges",
    "Horn-Schunck",
    "order 1",
    "chosen",
    "Horn-Schunck",
    "order 1",
    "chosen",
    "norm",
)
MARKS = ("<!-- tables of laboratory.textures -->", "<!-- end of the tables of textures -->")
_FIELD_WAVELENGTH = 24.0  # mean edges
_WAVE_COUNT = 40
_TRACER_STEPS = 8
_SLOPE_MIN = 0.5  # of the root mean square of the slope
_SPEED_MIN = 0.2  # of the root mean square of the speed


class PlaneWaves:
    """A sum of random plane waves in space, of unit variance; points are (P, 3)."""

    def __init__(self, wavelength: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        directions = rng.standard_normal((_WAVE_COUNT, 3))
        lengths = np.linalg.norm(directions, axis=1, keepdims=True)
        self._vectors = 2 * np.pi / wavelength * directions / lengths
        self._phases = rng.uniform(0, 2 * np.pi, _WAVE_COUNT)
        self._scale = np.sqrt(2 / _WAVE_COUNT)

    def values(self, points: FloatArray) -> FloatArray:
        """Return the values (P,)."""
        return np.asarray(self._scale * np.cos(points @ self._vectors.T + self._phases).sum(axis=1))

    def gradients(self, points: FloatArray) -> FloatArray:
        """Return the gradients in space, (P, 3)."""
        return np.asarray(
            -self._scale * np.sin(points @ self._vectors.T + self._phases) @ self._vectors
        )


@dataclass(frozen=True)
class MovingTexture:
    """Two frames of a texture on the unit sphere, and the field that moves one to the other."""

    mesh: TriangleMesh
    texture: str
    motion: str
    displacement: float
    noise: float
    seed: int = 0

    @cached_property
    def edge(self) -> float:
        """Mean edge length."""
        return float(edge_lengths(self.mesh).mean())

    @cached_property
    def _velocity(self) -> Callable[[FloatArray], FloatArray]:
        """The field at points of the sphere, (P, 3), per frame."""
        if self.motion == "turn":

            def field(points: FloatArray) -> FloatArray:
                return np.asarray(np.cross([0.0, 0.0, 1.0], points))

        else:
            waves = [PlaneWaves(_FIELD_WAVELENGTH * self.edge, 10 * self.seed + k) for k in (1, 2)]

            def field(points: FloatArray) -> FloatArray:
                first, second = (wave.gradients(points) for wave in waves)
                normal = np.einsum("px,px->p", first, points)[:, None] * points
                return np.asarray(first - normal + np.cross(points, second))

        def scaled(points: FloatArray) -> FloatArray:
            return np.asarray(self.displacement * self.edge / size * field(points))

        vertices = self.mesh.vertices
        size = float(np.sqrt((field(vertices) ** 2).sum(axis=1).mean()))
        return scaled

    @cached_property
    def field(self) -> FloatArray:
        """The field at the faces' middles, (F, 3), per frame."""
        centres = self.mesh.vertices[self.mesh.faces].mean(axis=1)
        return self._velocity(centres / np.linalg.norm(centres, axis=1, keepdims=True))

    @cached_property
    def frames(self) -> FloatArray:
        """Both frames with noise, (2, V)."""
        wave = PlaneWaves(TEXTURES[self.texture] * self.edge, 10 * self.seed)
        points, step = self.mesh.vertices, -1 / _TRACER_STEPS
        for _ in range(_TRACER_STEPS):
            points = _moved(self._velocity, points, step)
        frames = np.stack([wave.values(self.mesh.vertices), wave.values(points)])
        scatter = np.random.default_rng(10 * self.seed + 5).standard_normal(frames.shape)
        return np.asarray(frames + self.noise * frames.std() * scatter)

    @cached_property
    def told(self) -> BoolArray:
        """Faces where the texture is not flat, and something moves."""
        wave = PlaneWaves(TEXTURES[self.texture] * self.edge, 10 * self.seed)
        areas = face_areas(self.mesh)
        values = gradient(self.mesh) @ wave.values(self.mesh.vertices)
        slopes = np.linalg.norm(values.reshape(-1, 2), axis=1)
        speeds = np.linalg.norm(self.field, axis=1)
        usual, usual_speed = (np.sqrt(areas @ each**2 / areas.sum()) for each in (slopes, speeds))
        return np.asarray((slopes > _SLOPE_MIN * usual) & (speeds > _SPEED_MIN * usual_speed))

    def errors(self, interval: int, found: FloatArray) -> tuple[float, float]:
        """Return the median angle, in degrees, and the median relative error of the speed."""
        a, b = found[self.told], self.field[self.told]
        sizes, wanted = (np.linalg.norm(v, axis=1) for v in (a, b))
        return float(np.median(angles(a, b))), float(np.median(np.abs(sizes - wanted) / wanted))


def _moved(
    velocity: Callable[[FloatArray], FloatArray], points: FloatArray, step: float
) -> FloatArray:
    """Return points of the unit sphere after a step of Runge and Kutta's fourth order."""

    def onto(points: FloatArray) -> FloatArray:
        return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))

    first = velocity(points)
    second = velocity(onto(points + 0.5 * step * first))
    third = velocity(onto(points + 0.5 * step * second))
    fourth = velocity(onto(points + step * third))
    return onto(points + step / 6 * (first + 2 * second + 2 * third + fourth))


class Case(NamedTuple):
    """A row of the tables: a texture, how it moves, and the size of the sphere."""

    texture: str
    motion: str
    noise: float
    displacement: float
    level: int = SIZE

    def row(self) -> list[str]:
        """Return errors of Horn-Schunck, of order 1 and of the chosen norm, and which that is."""
        mesh = sphere(self.level)
        moving = MovingTexture(mesh, *self[:2], self.displacement, self.noise)
        old, new = (
            sequence(mesh, moving.frames, parameters=defaults(**norm))
            for norm in ({"order": 1, "alpha": 1.0}, {})
        )
        linear = tuned(mesh, moving.frames, moving.errors)
        errors = np.array([linear, *(moving.errors(0, f.velocity[0]) for f in (old, new))])
        head = [f"{len(mesh.vertices):,}", *self[:2], f"{100 * self.noise:g}%"]
        chosen = f"{new.parameters.solver.order}, {new.parameters.alpha:g}, {new.sigma:.1g}"
        return [*head, f"{self.displacement:g}", *cells(errors), chosen]


def table(rows: list[Case], jobs: int) -> str:
    """Return a table of cases, which are solved by so many processes."""
    return told_table(HEADS, mapped(Case.row, rows, jobs))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, help="so many processes (default: one for each core)")
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    jobs = Cluster(given.jobs).processes
    sizes = product(SIZE_NOISES, (1.0,), LEVELS)
    parts = [
        "Median errors of the angle (first three), and of the speed; the norm is its order, alpha "
        "and sigma. Errors of Horn-Schunck are bold where they are smaller than those with it:",
        table([Case("smooth", "turn", *each) for each in sizes], jobs),
        table([Case(*each) for each in product(TEXTURES, MOTIONS, NOISES, DISPLACEMENTS)], jobs),
    ]
    if given.write:
        put_between(given.write, MARKS, parts)


if __name__ == "__main__":
    main()
