"""Sequences with known motion, and errors of fields compared with linear Horn-Schunck."""

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
"""Smoothness values of Horn-Schunck; the tables have the best one for the known motion."""


def error_headings(*methods: str) -> list[str]:
    """Return the headings of the cells of `error_cells`."""
    return [f"{error}: {method}" for error in ("angle", "speed") for method in methods]


HEADINGS = ("noise", "edges", *error_headings("Horn-Schunck", "frame by frame", "together"))
"""Headings of the cells of `known_cells` after the kind."""

_GAMMAS = (0.0, 1.0)  # interval by interval, and coupled in time
_SLOPE_MIN = 0.5  # errors are measured on faces of larger slope, relative to its root mean square
_SPEED_MIN = 0.2

Errors = tuple[float, float]
"""The median angle in degrees, and the median relative error of the speed."""


def edge_length(mesh: TriangleMesh) -> float:
    return float(edge_lengths(mesh).mean())


def slopes(mesh: TriangleMesh, function: FloatArray) -> FloatArray:
    """Return the gradients (F, 2) in face frames of a function (V,)."""
    return np.asarray((gradient(mesh) @ function).reshape(-1, 2))


def root_mean_square(mesh: TriangleMesh, vectors: FloatArray) -> float:
    """Return the root mean square over the surface of vectors (F, D)."""
    areas = face_areas(mesh)
    return float(np.sqrt(areas @ (vectors**2).sum(axis=1) / areas.sum()))


def angles(found: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the angles (F,) between vectors (F, 3), in degrees."""
    sizes = np.linalg.norm(found, axis=1) * np.linalg.norm(wanted, axis=1)
    cosines = np.einsum("fx,fx->f", found, wanted) / np.maximum(sizes, 1e-300)
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))))


@dataclass(frozen=True, eq=False)
class KnownMotion:
    """Frames (T, V) without noise, and the field (F, 3) per frame that moves each to the next."""

    mesh: TriangleMesh
    frames: FloatArray
    field: FloatArray

    def noisy(self, noise: float, seed: int = 0) -> FloatArray:
        """Return the frames with noise, whose standard deviation is relative to theirs."""
        scatter = np.random.default_rng(seed).standard_normal(self.frames.shape)
        return np.asarray(self.frames + noise * self.frames.std() * scatter)

    @cached_property
    def _is_moving(self) -> BoolArray:
        speeds = np.linalg.norm(self.field, axis=1)
        return np.asarray(speeds > _SPEED_MIN * root_mean_square(self.mesh, self.field))

    def is_determined(self, frame: int) -> BoolArray:
        """Return the faces (F,) where the function is not flat and the field is not slow."""
        slope = slopes(self.mesh, self.frames[frame])
        usual = root_mean_square(self.mesh, slope)
        return np.asarray((np.linalg.norm(slope, axis=1) > _SLOPE_MIN * usual) & self._is_moving)

    def errors(self, frame: int, found: FloatArray) -> Errors:
        """Return the errors of a field (F, 3) between a frame and the next."""
        faces = self.is_determined(frame)
        a, b = found[faces], self.field[faces]
        sizes, wanted = (np.linalg.norm(v, axis=1) for v in (a, b))
        return float(np.median(angles(a, b))), float(np.median(np.abs(sizes - wanted) / wanted))


def sequences(mesh: TriangleMesh, frames: FloatArray) -> list[abfm.Sequence]:
    """Solve frames (T, V) interval by interval, and coupled in time."""
    return [abfm.sequence(mesh, frames, gamma=gamma) for gamma in _GAMMAS]


def compared(
    found: Sequence[abfm.Sequence], errors: Callable[[int, FloatArray], Errors]
) -> FloatArray:
    """Return errors (1 + S, 2) of Horn-Schunck and of S sequences of the same frames.

    Errors are means over the intervals. Horn-Schunck has the smoothness for which the product of
    both errors is smallest.
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
    """Return errors (M, 2) as cells: angles, then speeds.

    The error of the baseline, the first one, is bold if it is smaller than that of the defaults,
    the last one.
    """
    found = []
    for form, column in (("{:.1f}°", errors[:, 0]), ("{:.1f}%", 100 * errors[:, 1])):
        first, *others = map(form.format, column)
        found += [f"**{first}**" if column[0] < column[-1] else first, *others]
    return found


def known_cells(kind: str, noise: float, displacement: float, errors: FloatArray) -> list[str]:
    """Return a row of a table of errors: kind, noise, displacement in edges, and errors."""
    return [kind, f"{100 * noise:g}%", f"{displacement:g}", *error_cells(errors)]
