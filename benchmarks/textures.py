"""Fields of `abfm.sequence` between two frames of textures with known motion on spheres.

    python -m benchmarks.textures --write docs/sequences.md

Textures are sums of random plane waves in space. They are evaluated at the exact origin of each
vertex, so that no interpolation favours a method. The fields are a rotation, and the sum of a
gradient and a rotated gradient of random waves.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np

from abfm import TriangleMesh, sequence
from abfm.mesh.shapes import sphere
from abfm.sequences import defaults
from abfm.types import FloatArray
from benchmarks.common import Table, main, mapped
from benchmarks.motion import KnownMotion, compared, edge_length, error_cells, error_headings

WAVELENGTHS = {"smooth": 20.0, "rough": 9.0}
"""Wavelengths of the textures, in mean edge lengths."""
MOTIONS = ("rotation", "waves")
NOISES = (0.0, 0.05, 0.1)
"""Standard deviation of the noise, relative to that of the frames."""
DISPLACEMENTS = (0.25, 0.5, 1.0, 2.5, 4.0)
"""Root mean square of the displacement between the two frames, in mean edge lengths."""
SUBDIVISIONS = (3, 4, 5)
"""Subdivisions of the spheres of 642, 2,562 and 10,242 vertices in the table by size."""
SUBDIVISION = 4
"""Subdivision of all other spheres."""
HEADINGS = (
    "vertices",
    "texture",
    "motion",
    "noise",
    "edges",
    *error_headings("Horn-Schunck", "order 1", "chosen"),
    "order, alpha, sigma",
)

_FIELD_WAVELENGTH = 24.0  # in mean edge lengths
_WAVE_COUNT = 40
_TRACER_STEPS = 8
_NOISE_SEED = 5
_FIELD_SEEDS = (1, 2)

Velocity = Callable[[FloatArray], FloatArray]


class PlaneWaves:
    """A function in space: a sum of random plane waves with unit variance."""

    def __init__(self, wavelength: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        directions = rng.standard_normal((_WAVE_COUNT, 3))
        lengths = np.linalg.norm(directions, axis=1, keepdims=True)
        self._vectors = 2 * np.pi / wavelength * directions / lengths
        self._phases = rng.uniform(0, 2 * np.pi, _WAVE_COUNT)
        self._scale = np.sqrt(2 / _WAVE_COUNT)

    def values(self, points: FloatArray) -> FloatArray:
        return np.asarray(self._scale * np.cos(points @ self._vectors.T + self._phases).sum(axis=1))

    def gradients(self, points: FloatArray) -> FloatArray:
        """Return the gradients of the function in space, (P, 3), at points (P, 3)."""
        return np.asarray(
            -self._scale * np.sin(points @ self._vectors.T + self._phases) @ self._vectors
        )


def moving_texture(
    mesh: TriangleMesh, texture: str, motion: str, displacement: float
) -> KnownMotion:
    """Return two frames of a texture on the unit sphere, and the field from one to the other."""
    edge = edge_length(mesh)
    velocity = _velocity(motion, edge)
    sizes = np.linalg.norm(velocity(mesh.vertices), axis=1)
    scale = displacement * edge / float(np.sqrt((sizes**2).mean()))
    points = mesh.vertices
    for _ in range(_TRACER_STEPS):
        points = _traced(velocity, points, -scale / _TRACER_STEPS)
    wave = PlaneWaves(WAVELENGTHS[texture] * edge, 0)
    frames = np.stack([wave.values(mesh.vertices), wave.values(points)])
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    return KnownMotion(mesh, frames, scale * velocity(_on_sphere(middles)))


def _velocity(motion: str, edge: float) -> Velocity:
    """Return a function that takes points (P, 3) of the sphere and returns velocities (P, 3)."""
    waves = [PlaneWaves(_FIELD_WAVELENGTH * edge, seed) for seed in _FIELD_SEEDS]

    def rotation(points: FloatArray) -> FloatArray:
        return np.asarray(np.cross([0.0, 0.0, 1.0], points))

    def gradients(points: FloatArray) -> FloatArray:
        first, second = (wave.gradients(points) for wave in waves)
        normal = np.einsum("px,px->p", first, points)[:, None] * points
        return np.asarray(first - normal + np.cross(points, second))

    return rotation if motion == "rotation" else gradients


def _on_sphere(points: FloatArray) -> FloatArray:
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def _traced(velocity: Velocity, points: FloatArray, step: float) -> FloatArray:
    """Move points of the unit sphere along a field by one fourth-order Runge-Kutta step."""
    first = velocity(points)
    second = velocity(_on_sphere(points + 0.5 * step * first))
    third = velocity(_on_sphere(points + 0.5 * step * second))
    fourth = velocity(_on_sphere(points + step * third))
    return _on_sphere(points + step / 6 * (first + 2 * second + 2 * third + fourth))


class Case(NamedTuple):
    """Settings of a row of the tables: texture, motion, noise, displacement, and sphere size."""

    texture: str
    motion: str
    noise: float
    displacement: float
    subdivision: int = SUBDIVISION

    def row(self) -> list[str]:
        """Return a row of the table, with the errors of three methods.

        They are Horn-Schunck, and sequences with norm order 1 and with default parameters. The last
        cell has the parameters that the last method chose.
        """
        mesh = sphere(self.subdivision)
        moving = moving_texture(mesh, self.texture, self.motion, self.displacement)
        frames = moving.noisy(self.noise, _NOISE_SEED)
        found = [
            sequence(mesh, frames, parameters=each)
            for each in (defaults(order=1, alpha=1.0), defaults())
        ]
        chosen = found[1].parameters
        return [
            f"{len(mesh.vertices):,}",
            self.texture,
            self.motion,
            f"{100 * self.noise:g}%",
            f"{self.displacement:g}",
            *error_cells(compared(found, moving.errors)),
            f"{chosen.order}, {chosen.alpha:g}, {found[1].sigma:.1g}",
        ]


def tables(arguments: argparse.Namespace) -> Mapping[str, Table]:
    sizes = [
        Case("smooth", "rotation", noise, 1.0, subdivision)
        for noise, subdivision in product((0.0, 0.1), SUBDIVISIONS)
    ]
    cases = [Case(*each) for each in product(WAVELENGTHS, MOTIONS, NOISES, DISPLACEMENTS)]
    return {
        "texture sizes": Table(HEADINGS, mapped(Case.row, sizes, arguments.jobs)),
        "textures": Table(HEADINGS, mapped(Case.row, cases, arguments.jobs)),
    }


if __name__ == "__main__":
    main(__doc__, tables)
