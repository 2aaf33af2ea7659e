"""Frames between two frames, and how certain fields are: waves on a sphere whose truth is known.

    python -m laboratory.in_between [--write docs/sequences.md]

Each wave is computed at half steps of time; every second one is a frame. The errors of the frames
in between, over the deviation, are those of the linear blend, of the motion along the fields alone,
and of `abfm.Sequence.at`; those of the fields are over their uncertainty, medians over faces.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from abfm import Sequence, TriangleMesh, sequence
from abfm.calculus.operators import edge_lengths, vertex_areas
from abfm.flow.flow import Flow
from abfm.mesh.shapes import sphere
from abfm.sequences.between.in_between import in_between
from abfm.types import FloatArray
from laboratory.common import put_between, told_table

KINDS = ("travelling", "rotating", "source and sink", "standing", "two standing")
NOISES = (0.0, 0.1, 0.3)  # standard deviation, of the frames'
DISPLACEMENTS = (1.0, 3.0)  # root mean square from frame to frame, in mean edges
FRAMES, WAVELENGTH = 7, 16.0  # mean edges
MARKS = ("<!-- table of laboratory.in_between -->", "<!-- end of this table -->")
HEADS = (
    "wave",
    "noise",
    "edges",
    "blend",
    "motion alone",
    "`at`",
    "share",
    "confirmed",
    "determined",
    "error over uncertainty",
)


def wave(mesh: TriangleMesh, kind: str, displacement: float) -> tuple[FloatArray, FloatArray]:
    """Return a wave at half steps of time, (2 T - 1, V), and its field per frame, (F, 3): 0 of
    standing waves, which have none.
    """
    edge = float(edge_lengths(mesh).mean())
    number = 2 * np.pi / (WAVELENGTH * edge)
    times = 0.5 * np.arange(2 * FRAMES - 1)[:, None]
    x, y, z = mesh.vertices.T
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    speed = displacement * edge / np.sqrt(2 / 3)  # of the equator, for that root mean square
    if kind in ("travelling", "rotating"):
        turned = np.cos(speed * times) * x + np.sin(speed * times) * y
        found = np.sin(number * turned)
        if kind == "rotating":
            found = found * np.cos(0.7 * number * z)
        return found, speed * np.cross([0.0, 0.0, 1.0], middles)
    if kind == "source and sink":  # along the gradient of z
        places = np.tanh(np.arctanh(np.clip(z, -1 + 1e-9, 1 - 1e-9)) - speed * times)
        up = np.array([0.0, 0.0, 1.0]) - middles[:, 2:] * middles
        return np.cos(number * places), speed * up
    phase = 2 * np.pi * displacement / WAVELENGTH * times
    found = np.cos(phase + 0.4) * np.cos(number * x)
    if kind == "two standing":
        found = found + np.cos(0.7 * phase + 1.3) * np.sin(number * y)
    return found, np.zeros_like(middles)


def errors(found: Sequence, truth: FloatArray) -> FloatArray:
    """Return the error of frames in between, over the deviation: of the linear blend, of the motion
    alone, and of the sequence.
    """
    areas, half = vertex_areas(found.mesh), np.array([0.5])
    squares = []
    for i in range(len(found)):
        flow = Flow(found.mesh, found.velocity[i], float(np.diff(found.times)[i]))
        before, after = found.frames[i : i + 2, :, 0]
        frames = [in_between(flow, before, after, half, motion)[0] for motion in (0.0, 1.0)]
        frames.append(found.at(float(found.middles[i])))
        squares.append([areas @ (frame - truth[2 * i + 1]) ** 2 for frame in frames])
    return np.asarray(np.sqrt(np.mean(squares, axis=0) / areas.sum()) / truth.std())


def rows(mesh: TriangleMesh) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    for kind in KINDS:
        for displacement in DISPLACEMENTS:
            truth, field = wave(mesh, kind, displacement)
            for noise in NOISES:
                scatter = np.random.default_rng(0).standard_normal(truth[::2].shape)
                found = sequence(mesh, truth[::2] + noise * truth.std() * scatter)
                off = np.linalg.norm(found.velocity - field, axis=2)
                ratio = f"{np.median(off / found.uncertainty):.2f}" if field.any() else "no motion"
                yield [
                    kind,
                    f"{100 * noise:g}%",
                    f"{displacement:g}",
                    *(f"{error:.4f}" for error in errors(found, truth)),
                    f"{found.motion_share:.2f}",
                    f"{found.confirmed} of {len(found)}",
                    f"{100 * np.median(found.speed_determined):.0f}%",
                    ratio,
                ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    table = told_table(HEADS, rows(sphere(4)))
    if given.write:
        put_between(given.write, MARKS, [table])


if __name__ == "__main__":
    main()
