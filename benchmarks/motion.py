"""Sequences with known motion, and errors of the fields of `abfm.sequence` and Horn-Schunck."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.baselines import horn_schunck
from abfm.calculus.operators import edge_lengths, face_areas, gradient
from abfm.types import BoolArray, FloatArray

SMOOTHNESSES = (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Smoothness weights of Horn-Schunck; the tables show the result closest to the known motion."""


def error_headings(*methods: str) -> list[str]:
    """Return a heading for each cell of `error_cells`: angle, then speed, of each method."""
    return [f"{error}: {method}" for error in ("angle", "speed") for method in methods]


HEADINGS = ("noise", "edges", *error_headings("Horn-Schunck", "frame by frame", "together"))
"""Headings of the cells of `known_cells`, except that of the first cell, the kind of motion."""

_GAMMAS = (0.0, 1.0)  # coupling in time; 0 solves each interval separately
# Errors are measured only on faces whose slope and speed exceed these multiples of their root mean
# square.
_SLOPE_MIN = 0.5
_SPEED_MIN = 0.2

Errors = tuple[float, float]
"""Median angle to the known field in degrees, and median relative error of the speed."""


def edge_length(mesh: TriangleMesh) -> float:
    return float(edge_lengths(mesh).mean())


def slopes(mesh: TriangleMesh, function: FloatArray) -> FloatArray:
    return np.asarray((gradient(mesh) @ function).reshape(-1, 2))


def root_mean_square(mesh: TriangleMesh, vectors: FloatArray) -> float:
    areas = face_areas(mesh)
    return float(np.sqrt(areas @ (vectors**2).sum(axis=1) / areas.sum()))


def angles(found: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the angles (F,), in degrees, between ``found`` and ``wanted``, both (F, 3)."""
    sizes = np.linalg.norm(found, axis=1) * np.linalg.norm(wanted, axis=1)
    cosines = np.einsum("fx,fx->f", found, wanted) / np.maximum(sizes, 1e-300)
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))))


@dataclass(frozen=True, eq=False)
class KnownMotion:
    """Frames (T, V) without noise, and the field (F, 3) that moves each frame to the next."""

    mesh: TriangleMesh
    frames: FloatArray
    field: FloatArray

    def noisy(self, noise: float, seed: int = 0) -> FloatArray:
        """Add noise to the frames, ``noise`` times their standard deviation."""
        scatter = np.random.default_rng(seed).standard_normal(self.frames.shape)
        return np.asarray(self.frames + noise * self.frames.std() * scatter)

    @cached_property
    def _is_moving(self) -> BoolArray:
        speeds = np.linalg.norm(self.field, axis=1)
        return np.asarray(speeds > _SPEED_MIN * root_mean_square(self.mesh, self.field))

    def is_determined(self, frame: int) -> BoolArray:
        """Return a mask (F,) of faces where the slope of the frame and the speed are large."""
        slope = slopes(self.mesh, self.frames[frame])
        usual = root_mean_square(self.mesh, slope)
        return np.asarray((np.linalg.norm(slope, axis=1) > _SLOPE_MIN * usual) & self._is_moving)

    def errors(self, frame: int, found: FloatArray) -> Errors:
        """Return the errors (angle, speed) of a field (F, 3) that moves a frame to the next.

        They are medians over the faces of `is_determined`.
        """
        faces = self.is_determined(frame)
        a, b = found[faces], self.field[faces]
        sizes, wanted = (np.linalg.norm(v, axis=1) for v in (a, b))
        return float(np.median(angles(a, b))), float(np.median(np.abs(sizes - wanted) / wanted))


def sequences(mesh: TriangleMesh, frames: FloatArray) -> list[abfm.Sequence]:
    """Return two solutions for frames (T, V): with separate intervals, and coupled in time."""
    return [abfm.sequence(mesh, frames, gamma=gamma) for gamma in _GAMMAS]


def compared(
    found: Sequence[abfm.Sequence], errors: Callable[[int, FloatArray], Errors]
) -> FloatArray:
    """Return the errors (1 + S, 2) of Horn-Schunck and of S sequences for the same frames.

    They are means over the intervals. Horn-Schunck has the smoothness for which the product of both
    errors is smallest.
    """
    mesh, frames, intervals = found[0].mesh, found[0].frames[:, :, 0], range(len(found[0]))
    linear = [
        [errors(i, horn_schunck(mesh, *pair, 1.0, s)) for i, pair in enumerate(pairwise(frames))]
        for s in SMOOTHNESSES
    ]
    means = np.mean(linear, axis=1)
    sequence_errors = [
        np.mean([errors(i, each.velocity[i]) for i in intervals], axis=0) for each in found
    ]
    return np.array([means[means.prod(axis=1).argmin()], *sequence_errors])


def error_cells(errors: FloatArray) -> list[str]:
    """Format the errors (M, 2) of M methods as cells of a table: all angles, then all speeds.

    The first method is Horn-Schunck. Its error is bold if it is smaller than that of the last
    method.
    """
    found = []
    for form, column in (("{:.1f}°", errors[:, 0]), ("{:.1f}%", 100 * errors[:, 1])):
        first, *others = map(form.format, column)
        found += [f"**{first}**" if column[0] < column[-1] else first, *others]
    return found


def known_cells(kind: str, noise: float, displacement: float, errors: FloatArray) -> list[str]:
    """Return a row: motion, noise, displacement in mean edge lengths, and errors."""
    return [kind, f"{100 * noise:g}%", f"{displacement:g}", *error_cells(errors)]
