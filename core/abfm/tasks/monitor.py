"""What a caller sees of a task while it is solved, and how it stops it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from abfm.workers.control import Control


def ignore(*_: object) -> None:
    """Do nothing."""


@dataclass(frozen=True)
class Monitor:
    """Partial results and notes of a task, its checkpoint file, and the control to stop it.

    How far the task is comes by `abfm.workers.progress`.

    Attributes
    ----------
    control : Control
        Pauses, resumes or cancels the task. A cancelled task returns the best result so far.
    on_partial : callable
        Called in the thread that solves with each partial result: an `Iteration` of a match, or the
        number of a solved interval of a sequence and its field, (F, 3).
    on_note : callable
        Called with each note on how the task is solved, one line each.
    checkpoint : Path, optional
        Where the result will be: a long task keeps what it has found in a file next to it, and
        resumes from there.
    resumes_only : bool
        Whether a task with a checkpoint returns what that holds, and solves nothing.
    checkpoints : list of Path
        The checkpoint files of the task, which the caller removes once the result is saved.
    """

    control: Control = field(default_factory=Control)
    on_partial: Callable[[Any], object] = ignore
    on_note: Callable[[str], object] = ignore
    checkpoint: Path | None = None
    resumes_only: bool = False
    checkpoints: list[Path] = field(default_factory=list)
