"""Matching of all frames of a sequence, and its fields during and after the run.

Two consecutive frames are an interval, and a match finds one field for each interval.
"""

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
from abfm.workers.worker import WorkerEndedError, report
from abfm_viewer.computing.background import Memo
from abfm_viewer.computing.run import Run
from abfm_viewer.document.kinds import SequenceDocument

_TRIES = 3  # starts of the subprocess; each resumes from the checkpoint of the previous one
_ENDED_MESSAGE = (
    f"the subprocess of the match ended {_TRIES} times, perhaps for lack of memory; match again to "
    "resume from its checkpoint"
)

Then: TypeAlias = "Callable[[SequenceDocument, abfm.Sequence | None], object]"
"""Called with the document of a run and its result; None if the run failed."""


class SequenceMatch:
    """Matches all consecutive frames of a sequence in one run.

    During the run, fields are stored in a checkpoint file. The next run with the same frames
    resumes from this file.
    """

    def __init__(self, run: Run[Any]) -> None:
        # returns the file next to which the checkpoint lies; None for no checkpoint
        self.checkpoint_base: Callable[[SequenceDocument], Path | None] = lambda document: None
        self.pair: tuple[int, int] | None = None  # frames that the user chose to match alone
        self.running_document: SequenceDocument | None = None  # the same object during a run
        self._run = run
        self._fields: dict[int, FloatArray] = {}  # fields of the run, by interval
        self._fast_speed = 0.0  # the largest fast speed of the run's fields
        self._speeds = Memo[FloatArray]()
        self._of_result = Memo[tuple[FloatArray | None, ...]]()

    def start(self, document: SequenceDocument, then: Then, resumes_only: bool = False) -> None:
        """Start a run that matches all frames, beginning with the fields in the checkpoint, if any.

        With ``resumes_only``, nothing is solved, and the result has only the fields in the
        checkpoint. When the run has ended, ``then`` is called with the document and the result.
        """
        self.running_document, self._fields, self._fast_speed = document, {}, 0.0
        given = _task(document), self.checkpoint_base(document), resumes_only
        work, end = partial(self._solve, *given), partial(self._end, document, then)
        self._run.start(work, end, resumes=True)

    def found_count(self, document: SequenceDocument) -> int:
        run = self.running_document
        return len(self._fields) if run is not None and run.sequence is document.sequence else 0

    def fast_speed(self, document: SequenceDocument) -> float:
        """Return the largest `abfm.calculus.fast_speed` of the run's fields so far, or 0."""
        return self._fast_speed if self.found_count(document) else 0.0

    @property
    def progress_text(self) -> str:
        overall = self._run.overall
        count = self.running_document.sequence.intervals if self.running_document else 0
        found = f"{len(self._fields)} of {count} intervals found"
        name = "paused" if self._run.paused else overall.name
        return ", ".join(filter(None, (name, overall.text(), found)))

    def field(self, document: SequenceDocument, interval: int) -> FloatArray | None:
        """Return the field (F, 3) of an interval, always as the same array; None if it is unknown.

        As soon as a run has found any field, fields of an earlier result are no longer returned.
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
        """Return the share of motion between two frames, from 0 (a linear blend) to 1."""
        result = document.result
        if result is None or self.found_count(document):
            return 1.0
        return float(result.motion_shares[interval])

    def speeds(self, document: SequenceDocument) -> FloatArray:
        """Return the root mean square speed of each interval's field, (T - 1,); NaN without one."""
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
        if found is not None:  # the subprocess worked on copies of the document's frames
            found = replace(found, _frames=document.sequence.frames)
        then(document, found)

    # The methods below are called in the thread of the run

    def _solve(self, task: abfm.sequences.SequenceTask, *given: object) -> abfm.Sequence:
        take = partial(self._take, task.mesh)
        try:
            return self._run.call(_solve, task, *given, on_partial=take, tries=_TRIES)
        except WorkerEndedError:
            raise WorkerEndedError(_ENDED_MESSAGE) from None

    def _take(self, mesh: abfm.TriangleMesh, found: tuple[int, FloatArray]) -> None:
        interval, field = found
        speed = np.linalg.norm(field, axis=1)
        self._fast_speed = max(self._fast_speed, abfm.calculus.fast_speed(mesh, speed))
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
