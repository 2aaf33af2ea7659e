"""How far the fields of films are from motion that is known, beside linear Horn-Schunck."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.baselines import horn_schunck
from abfm.types import FloatArray

GAMMAS = (0.0, 1.0)  # frame by frame, and together
SMOOTHNESS = (0.001, 0.01, 0.1, 1.0)  # of Horn-Schunck, of which the best is told
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
        angles, speeds = self.errors.T
        head = [self.kind, f"{100 * self.noise:g}%", f"{self.displacement:g}"]
        return [*head, *(f"{x:.1f}°" for x in angles), *(f"{100 * x:.1f}%" for x in speeds)]


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
    """Return errors (3, 2) of the fields of a film, means over its intervals: Horn-Schunck's with
    the smoothness that is best by ``errors`` themselves, and of what was found with each of GAMMAS.
    """
    mesh, frames = found[0].mesh, found[0].frames[:, :, 0]
    steps = range(len(frames) - 1)
    linear = [
        [errors(i, horn_schunck(mesh, frames[i], frames[i + 1], 1.0, s)) for i in steps]
        for s in SMOOTHNESS
    ]
    means = np.mean(linear, axis=1)  # (S, 2)
    best = means[means.prod(axis=1).argmin()]
    return np.array(
        [best, *(np.mean([errors(i, f.velocity[i]) for i in steps], axis=0) for f in found)]
    )
