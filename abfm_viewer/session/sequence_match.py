"""The fields of a film: those of a run, as they are found, or those of its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

import abfm
from abfm.tasks.monitor import Monitor
from abfm.types import FloatArray
from abfm.workers.control import Control, current_control
from abfm.workers.progress import Step
from abfm.workers.worker import WorkerEndedError, report
from abfm_viewer.computing.background import Memo
from abfm_viewer.computing.run import Run
from abfm_viewer.document.kinds import SequenceDocument

_TRIES = 3  # of a process that ends, such as for want of memory, each from where the last one was
_ENDED_MESSAGE = (
    f"the process that matches ended {_TRIES} times, as for want of memory; match again to go on "
    "from what it found"
)

Then: TypeAlias = "Callable[[SequenceDocument, abfm.Sequence | None], object]"
"""Takes what a run was of, and its result; None if it failed."""


class SequenceMatch:
    """Matches all frames of a film in a run. What is found is kept in a file meanwhile: the next
    run of the same resumes from it.

    Attributes
    ----------
    checkpoint_base : callable
        Returns the file next to which that is, for a document; by default there is none.
    pair : (int, int) or None
        Frames to match by themselves, if chosen.
    running_document : SequenceDocument or None
        What the run is of that is under way, the same object all the time.
    """

    def __init__(self, run: Run[Any]) -> None:
        self.checkpoint_base: Callable[[SequenceDocument], Path | None] = lambda document: None
        self.pair: tuple[int, int] | None = None
        self.running_document: SequenceDocument | None = None
        self._run = run
        self._step = Step("starting the solver")
        self._fields: dict[int, FloatArray] = {}  # of the run, by interval
        self._fast = 0.0  # the largest of what counted as fast in the run's fields
        self._speeds = Memo[FloatArray]()
        self._of_result = Memo[tuple[FloatArray | None, ...]]()

    @property
    def step(self) -> Step:
        """What the run does, or did last."""
        self._step = self._run.step or self._step
        return self._step

    def start(self, document: SequenceDocument, then: Then, resumes_only: bool = False) -> None:
        """Match all frames of a document's film, from what an earlier run of the same has found
        that was not completed, or only return that; ``then`` is called when the run is collected.
        """
        self.running_document, self._fields, self._fast = document, {}, 0.0
        self._step = Step("reading what was found" if resumes_only else "starting the solver")
        given = _task(document), self.checkpoint_base(document), resumes_only
        work, end = partial(self._solve, *given), partial(self._end, document, then)
        self._run.start(work, end, resumes=True)

    def found_count(self, document: SequenceDocument) -> int:
        """Return how many fields a run of the document has found."""
        is_of_run = (
            self.running_document is not None
            and self.running_document.sequence is document.sequence
        )
        return len(self._fields) if is_of_run else 0

    def fast_speed(self, document: SequenceDocument) -> float:
        """Return what counts as fast in any of the fields that a run of the document has found, 0
        without any; it only grows.
        """
        return self._fast if self.found_count(document) else 0.0

    @property
    def progress_text(self) -> str:
        """What a run does, in a line."""
        doing = "paused" if self._run.paused else self.step.text()
        count = self.running_document.sequence.intervals if self.running_document else 0
        return f"{doing}, {len(self._fields)} of {count} intervals found"

    def field(self, document: SequenceDocument, interval: int) -> FloatArray | None:
        """Return the field (F, 3) of an interval, always the same array; None where none is known.
        A run's own fields are shown as soon as there is one.
        """
        if self.found_count(document):
            return self._fields.get(interval)
        result = document.result
        if result is None or interval >= len(result):
            return None

        def fields() -> tuple[FloatArray | None, ...]:
            known = zip(result.velocity, result.solved, strict=True)
            return tuple(field if is_solved else None for field, is_solved in known)

        return self._of_result.get((result,), fields)[interval]

    def motion_share(self, document: SequenceDocument, interval: int) -> float:
        """Return the share of motion in frames between two, see `abfm.Sequence.motion_shares`; 1
        during a run.
        """
        result = document.result
        if result is None or self.found_count(document):
            return 1.0
        return float(result.motion_shares[interval])

    def speeds(self, document: SequenceDocument) -> FloatArray:
        """Return the root mean square of the speed in each interval, (T - 1,), or NaN."""
        sequence = document.sequence
        fields = [self.field(document, interval) for interval in range(sequence.intervals)]

        def measure() -> FloatArray:
            areas = abfm.calculus.face_areas(sequence.frames.mesh)
            shares = areas / areas.sum()
            squares = [
                np.nan if each is None else shares @ np.einsum("fx,fx->f", each, each)
                for each in fields
            ]
            return np.asarray(np.sqrt(np.array(squares)))

        return self._speeds.get((sequence, *fields), measure)

    def _end(self, document: SequenceDocument, then: Then, found: abfm.Sequence | None) -> None:
        self.running_document, self._fields = None, {}
        if found is not None:  # the frames that it was sent are the document's
            found = replace(found, _frames=document.sequence.frames)
        then(document, found)

    # In the run's thread

    def _solve(self, task: abfm.sequences.SequenceTask, *given: object) -> abfm.Sequence:
        take = partial(self._take, task.mesh)
        try:
            return self._run.call(_solve, task, *given, on_partial=take, tries=_TRIES)
        except WorkerEndedError:
            raise WorkerEndedError(_ENDED_MESSAGE) from None

    def _take(self, mesh: abfm.TriangleMesh, found: tuple[int, FloatArray]) -> None:
        interval, field = found
        speed = np.linalg.norm(field, axis=1)
        self._fast = max(self._fast, abfm.calculus.fast_speed(mesh, speed))
        self._fields[interval] = field


def _task(document: SequenceDocument) -> abfm.sequences.SequenceTask:
    frames, settings = document.sequence.frames, document.settings
    values = frames.values if frames.channels_given else frames.values[:, :, 0]
    options = {
        "parameters": settings.parameters,
        "gamma": settings.gamma,
        "mask": frames.mask,
        "weights": frames.weights,
    }
    file = abfm.sequences.FramesFile(values, frames.times)
    return abfm.sequences.SequenceTask(frames.mesh, file, key="", options=options)


def _solve(
    _: object, task: abfm.sequences.SequenceTask, beside: Path | None, resumes_only: bool
) -> abfm.Sequence:
    control = current_control() or Control()
    return task.solve(Monitor(control, report, checkpoint=beside, resumes_only=resumes_only))
