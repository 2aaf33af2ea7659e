"""Monitor of a running task: partial results, notes, checkpoints and control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from abfm.workers.control import Control


def ignore(*_: object) -> None: ...


@dataclass(frozen=True)
class Monitor:
    """Callbacks, checkpoint file and control of a task that is being solved.

    Progress is reported separately, see ``abfm.workers.progress``.

    Attributes
    ----------
    control : Control
        Object that pauses, resumes or cancels the task. A cancelled task returns the best result so
        far.
    on_partial : callable
        Function that is called with each partial result, in the thread that solves the task. A
        match passes an `Iteration`; a sequence passes the number of a solved interval and its
        field, (F, 3).
    on_note : callable
        Function that is called with each note about the solution, a text of one line.
    checkpoint : Path, optional
        Path of the final result. A long task stores its progress in a file next to this path, and
        resumes from that file.
    resumes_only : bool
        Whether to return the result stored in the checkpoint without solving anything further.
    checkpoints : list of Path
        Checkpoint files of the task. The caller removes them after the result is saved.
    """

    control: Control = field(default_factory=Control)
    on_partial: Callable[[Any], object] = ignore
    on_note: Callable[[str], object] = ignore
    checkpoint: Path | None = None
    resumes_only: bool = False
    checkpoints: list[Path] = field(default_factory=list)
