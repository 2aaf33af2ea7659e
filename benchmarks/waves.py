"""Fields of `abfm.sequence` for waves with known motion on a cortex.

    python -m benchmarks.waves --write docs/sequences.md --picture docs/images/waves.png

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
"""Root mean square of the displacement between frames, in mean edges."""
FRAMES = 6
WAVELENGTH = 16.0
"""Wavelength in mean edges, at the root mean square slope of the phase."""

_FIELDS = {"travelling": 1, "rotating": 1, "source and sink": 4}  # eigenfunctions
_PHASES = {"travelling": 1, "rotating": 2, "source and sink": 4}


def wave(mesh: TriangleMesh, kind: str, displacement: float) -> KnownMotion:
    """Return a wave of a kind.

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
    """A row of the table."""

    surface: Path
    kind: str
    displacement: float
    noise: float

    def errors(self) -> FloatArray:
        """Return the errors (3, 2) of Horn-Schunck, without coupling in time, and with coupling."""
        moving = wave(_mesh(self.surface), self.kind, self.displacement)
        return compared(sequences(moving.mesh, moving.noisy(self.noise)), moving.errors)


_mesh = cache(load_mesh)


def _rows(cases: list[Case], jobs: int | None, picture: Path | None) -> Iterator[Cells]:
    results = []
    for case, errors in zip(cases, mapped(Case.errors, cases, jobs), strict=True):
        results.append((case, errors))
        yield known_cells(case.kind, case.noise, case.displacement, errors)
    if picture:
        draw(results, picture)


def draw(results: list[tuple[Case, FloatArray]], path: Path) -> None:
    """Plot mean errors over the kinds against displacements, one column per noise."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.6), layout="constrained")
    plots = figure.subplots(2, len(NOISES), sharex=True, sharey="row", squeeze=False)
    names = ("Horn-Schunck, best smoothness", "abfm, frame by frame", "abfm, together in time")
    styles = (("#8a8f98", "s", "--"), ("#3b7dd8", "o", "-"), ("#d1495b", "o", "-"))
    for column, noise in enumerate(NOISES):
        means = np.array(
            [
                np.mean([e for c, e in results if (c.noise, c.displacement) == (noise, d)], axis=0)
                for d in DISPLACEMENTS
            ]
        )
        for row, (word, factor) in enumerate((("angle, degrees", 1), ("speed, %", 100))):
            plot = plots[row, column]
            for number, (name, (color, marker, line)) in enumerate(zip(names, styles, strict=True)):
                values = factor * means[:, number, row]
                plot.plot(DISPLACEMENTS, values, line, color=color, marker=marker, label=name)
            plot.set_xscale("log", base=2)
            plot.set_xticks(DISPLACEMENTS, [f"{d:g}" for d in DISPLACEMENTS])
            plot.spines[["top", "right"]].set_visible(False)
            plot.grid(color="#e6e8ec")
            if column == 0:
                plot.set_ylabel(f"error of {word}")
        plots[0, column].set_title(f"{100 * noise:g}% noise" if noise else "no noise")
        plots[1, column].set_xlabel("displacement (edges per frame)")
    for row in plots:  # plots in a row share their range
        row[0].set_ylim(bottom=0)
    plots[0, 0].legend(frameon=False, fontsize=8.5)
    figure.savefig(path, dpi=115)


def tables(arguments: argparse.Namespace) -> Mapping[str, Table]:
    surface = arguments.surface or fsaverage5() / "white_left.gii.gz"
    cases = [Case(surface, *each) for each in product(KINDS, DISPLACEMENTS, NOISES)]
    rows = _rows(cases, arguments.jobs, arguments.picture)
    return {"waves": Table(("wave", *HEADINGS), rows)}


if __name__ == "__main__":
    main(__doc__, tables, surface="another surface", picture="a plot of the errors")
