"""What tests have a worker compute."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from abfm import FunctionError, TriangleMesh
from abfm.workers.control import checkpoint
from abfm.workers.progress import step
from abfm.workers.worker import report


class Notes:
    """A state: what was noted."""

    def __init__(self) -> None:
        self.lines: list[object] = []

    def add(self, line: object) -> list[object]:
        self.lines.append(line)
        return self.lines


def give_back(_: Notes, given: Any) -> Any:
    return given


def fail(_: Notes, kind: str) -> None:
    raise {"input": FunctionError, "memory": MemoryError, "bug": KeyError, "end": SystemExit}[kind](
        "two\nlines"
    )


def count_apart(_: Notes, upto: int) -> int:
    with step("counting"):
        for number in range(upto):
            report(number)
    return os.getpid()


def go_on(notes: Notes, file: Path) -> None:
    """Note how often a checkpoint was passed, until a control ends it; say that it began."""
    file.touch()
    while True:
        checkpoint()
        notes.lines.append(1)
        time.sleep(0.001)


def lines(notes: Notes) -> int:
    return len(notes.lines)


def hold(_: Notes, file: Path) -> None:
    """Wait until there is a file."""
    with step("holding"):
        while not file.exists():
            time.sleep(0.001)


def mesh_and_size(notes: Notes, mesh: TriangleMesh) -> tuple[TriangleMesh, bool]:
    """Return a mesh, and whether it is the object of the call before."""
    before = notes.lines[-1] if notes.lines else None
    notes.lines = [mesh]
    return mesh, before is mesh
