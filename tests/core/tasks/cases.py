"""A small example of each type of task, given by the names and values of its inputs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from abfm.assets import asset_path
from abfm.batch import Row
from abfm.io import write_surface
from abfm.matching.task import MatchTask
from abfm.mesh.shapes import sphere
from abfm.population.task import PopulationTask
from abfm.registration.symmetric import SymmetricTask
from abfm.registration.task import RegistrationTask
from abfm.sequences.task import SequenceTask
from abfm.tasks import Monitor, Task

MESH = sphere(2)
BRIEF = {"refine": 0, "iterations": 6, "levels": 1}


def bump(angle: float) -> np.ndarray:
    """Return a bump on the sphere, rotated about the z axis by an angle."""
    x, y, z = MESH.vertices.T
    along = x * np.cos(angle) + y * np.sin(angle)
    return np.exp(-((1 - along) ** 2 + z**2) / 0.3) + 0.2 * along * z


def _match(folder: Path) -> dict[str, Any]:
    functions = {
        side: f"gaussian:vertex={i},width=0.3" for side, i in (("source", 0), ("target", 9))
    }
    return {"mesh": asset_path("eight.off"), **functions, **BRIEF}


def _registration(folder: Path) -> dict[str, Any]:
    write_surface(folder / "s.ply", MESH)
    np.save(folder / "a.npy", bump(0.0))
    np.save(folder / "b.npy", bump(0.1))
    given = {"a": folder / "s.ply", "b": folder / "s.ply", "initial": "connectivity"}
    return {**given, "source": f"file:{folder}/a.npy", "target": f"file:{folder}/b.npy", **BRIEF}


def _sequence(folder: Path) -> dict[str, Any]:
    write_surface(folder / "s.ply", MESH)
    np.save(folder / "f.npy", np.stack([bump(0.05 * t) for t in range(4)]))
    return {"mesh": folder / "s.ply", "frames": folder / "f.npy", "sigma": 0.1, "alpha": 0.1}


def _population(folder: Path) -> dict[str, Any]:
    write_surface(folder / "s.ply", MESH)
    lines = ["name,depth"]
    for i in range(3):
        np.save(folder / f"{i}.npy", bump(0.1 * i))
        lines.append(f"s{i},{i}.npy")
    (folder / "subjects.csv").write_text("\n".join(lines))
    return {"table": folder / "subjects.csv", "template": folder / "s.ply", "rounds": 1, **BRIEF}


CASES: dict[type[Task], Callable[[Path], dict[str, Any]]] = {
    MatchTask: _match,
    RegistrationTask: _registration,
    SymmetricTask: _registration,
    SequenceTask: _sequence,
    PopulationTask: _population,
}
"""Functions that write the files of a task to a folder and return its inputs by name."""


class Case:
    def __init__(self, kind: type[Task], folder: Path) -> None:
        self.kind, self.folder = kind, folder
        self.inputs = CASES[kind](folder)
        self.partial: list[object] = []
        self.found = self.task().solve(self.monitor(folder / "out", self.partial.append))

    def row(self, **changes: Any) -> Row:
        """Return a row of a table with these inputs after ``changes``; None removes an input."""
        return Row("one", self.inputs | changes, self.folder, self.kind)

    def task(self, **changes: Any) -> Task:
        return self.row(**changes).task()

    def monitor(self, place: Path, on_partial: Callable[[Any], object] = lambda _: None) -> Monitor:
        """Return a monitor with a checkpoint in a separate folder."""
        place.mkdir(exist_ok=True)
        checkpoint = place if self.kind is PopulationTask else place / "result.npz"
        return Monitor(on_partial=on_partial, checkpoint=checkpoint)
