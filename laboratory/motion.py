"""Errors of the fields of sequences whose motion is known, compared with linear Horn-Schunck."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.baselines import horn_schunck
from abfm.types import FloatArray

GAMMAS = (0.0, 1.0)  # frame by frame, and together
SMOOTHNESS = (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Of Horn-Schunck; the tables have the best one by the known motion."""
HEADS = (
    "noise",
    "edges",
    "Horn-Schunck",
    "frame by frame",
    "together",
    "Horn-Schunck",
    "frame by frame",
    "together",
)
"""Of the columns of `Result.row` after its kind."""

Errors = tuple[float, float]


@dataclass(frozen=True)
class Result:
    """Errors (3, 2) of Horn-Schunck, frame by frame, and together: angle and speed."""

    kind: str
    noise: float
    displacement: float
    errors: FloatArray

    def row(self) -> list[str]:
        head = [self.kind, f"{100 * self.noise:g}%", f"{self.displacement:g}"]
        return [*head, *cells(self.errors)]


def angles(found: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the angles (F,) between vectors (F, 3), in degrees."""
    sizes = np.linalg.norm(found, axis=1) * np.linalg.norm(wanted, axis=1)
    cosines = np.einsum("fx,fx->f", found, wanted) / np.maximum(sizes, 1e-300)
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))))


def solved(mesh: TriangleMesh, frames: FloatArray) -> list[abfm.Sequence]:
    """Return what is found of a film (T, V) with each of GAMMAS."""
    return [abfm.sequence(mesh, frames, gamma=gamma) for gamma in GAMMAS]


def compared(
    found: Sequence[abfm.Sequence], errors: Callable[[int, FloatArray], Errors]
) -> FloatArray:
    """Return errors (1 + S, 2) of the fields of S sequences of the same frames, means over their
    intervals: first Horn-Schunck's, with the smoothness that is best by ``errors`` themselves.
    """
    steps = range(len(found[0]))
    best = tuned(found[0].mesh, found[0].frames[:, :, 0], errors)
    return np.array(
        [best, *(np.mean([errors(i, f.velocity[i]) for i in steps], axis=0) for f in found)]
    )


def tuned(
    mesh: TriangleMesh, frames: FloatArray, errors: Callable[[int, FloatArray], Errors]
) -> FloatArray:
    """Return the errors (2,) of Horn-Schunck between frames (T, V), means over the intervals, with
    the smoothness whose product of both errors is least.
    """
    linear = [
        [errors(i, horn_schunck(mesh, *pair, 1.0, s)) for i, pair in enumerate(pairwise(frames))]
        for s in SMOOTHNESS
    ]
    means = np.mean(linear, axis=1)  # (S, 2)
    return np.asarray(means[means.prod(axis=1).argmin()])


def cells(errors: FloatArray) -> list[str]:
    """Return errors (M, 2) as cells: angles, then speeds; the first, the baseline's, in bold where
    it is less than the last, that of the defaults.
    """
    found = []
    for text, column in (("{:.1f}°", errors[:, 0]), ("{:.1f}%", 100 * errors[:, 1])):
        words = list(map(text.format, column))
        found += [f"**{words[0]}**" if column[0] < column[-1] else words[0], *words[1:]]
    return found
