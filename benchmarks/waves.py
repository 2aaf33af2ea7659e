"""Fields of `abfm.sequence` for waves with known motion on a cortex.

    python -m benchmarks.waves --write docs/sequences.md

By default, the surface is the left white surface of fsaverage5, which nilearn contains.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from abfm import TriangleMesh, load_mesh
from abfm.calculus import eigenbasis
from abfm.calculus.vector_fields import to_ambient
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.types import FloatArray
from benchmarks.common import Cells, Table, fsaverage5, main, mapped
from benchmarks.motion import (
    HEADINGS,
    KnownMotion,
    compared,
    edge_length,
    known_cells,
    root_mean_square,
    sequences,
    slopes,
)

KINDS = ("travelling", "rotating", "source and sink")
NOISES = (0.0, 0.1, 0.3)
"""Standard deviation of the noise, relative to that of the frames."""
DISPLACEMENTS = (0.5, 1.0, 2.0, 4.0)
"""Root mean square of the displacement between consecutive frames, in mean edge lengths."""
FRAMES = 6
WAVELENGTH = 16.0
"""Wavelength in mean edge lengths, where the phase has its root mean square slope."""

# indices of the eigenfunctions: the field is the gradient of the first, the phase is the second
_FIELDS = {"travelling": 1, "rotating": 1, "source and sink": 4}
_PHASES = {"travelling": 1, "rotating": 2, "source and sink": 4}


def wave(mesh: TriangleMesh, kind: str, displacement: float) -> KnownMotion:
    """Return the frames of a wave of the given kind, and the field that moves it.

    The field of a wave is the gradient of an eigenfunction, turned by 90 degrees for a rotating
    wave. The field is constant in time and advects the phase along its flow lines.
    """
    basis, edge = eigenbasis(mesh, 5)[1], edge_length(mesh)
    slope = slopes(mesh, basis[:, _FIELDS[kind]])
    if kind == "rotating":
        slope = np.stack([-slope[:, 1], slope[:, 0]], axis=1)
    field = to_ambient(mesh, displacement * edge / root_mean_square(mesh, slope) * slope)
    phase = basis[:, _PHASES[kind]]
    phase = phase / root_mean_square(mesh, slopes(mesh, phase)) * 2 * np.pi / (WAVELENGTH * edge)
    flow, points, phases = ContinuousFlow(mesh, field, 1.0), None, [phase]
    for _ in range(FRAMES - 1):
        points = flow.origins(points)
        phases.append(points.pull_back(phase))
    return KnownMotion(mesh, np.cos(np.array(phases)), field)


class Case(NamedTuple):
    """Settings of a row of the table: surface, kind of wave, displacement and noise."""

    surface: Path
    kind: str
    displacement: float
    noise: float

    def errors(self) -> FloatArray:
        """Return the errors (3, 2) of angle and speed of three methods.

        The methods are Horn-Schunck, and matches of separate and of coupled intervals.
        """
        moving = wave(_mesh(self.surface), self.kind, self.displacement)
        return compared(sequences(moving.mesh, moving.noisy(self.noise)), moving.errors)


_mesh = cache(load_mesh)


def _rows(cases: list[Case], jobs: int | None) -> Iterator[Cells]:
    for case, errors in zip(cases, mapped(Case.errors, cases, jobs), strict=True):
        yield known_cells(case.kind, case.noise, case.displacement, errors)


def tables(arguments: argparse.Namespace) -> Mapping[str, Table]:
    surface = arguments.surface or fsaverage5() / "white_left.gii.gz"
    cases = [Case(surface, *each) for each in product(KINDS, DISPLACEMENTS, NOISES)]
    rows = _rows(cases, arguments.jobs)
    return {"waves": Table(("wave", *HEADINGS), rows)}


if __name__ == "__main__":
    main(__doc__, tables, surface="another surface")
