"""A film's match: all its intervals, in a process, and the fields that are known by now."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import abfm
from abfm.numerics.factoring_apart import factoring_apart
from abfm.types import FloatArray
from abfm.workers.control import Control, controlled
from abfm.workers.progress import Step, telling
from abfm.workers.worker import Worker, WorkerEndedError, report, stateless
from abfm_viewer.computing.background import THREADS, Memo, error_line
from abfm_viewer.document.film import FilmSettings
from abfm_viewer.document.kinds import FilmDocument

_TRIES = 3  # of a process that ends, such as for want of memory, each from where the last one was
_ENDED_MESSAGE = (
    f"the process that matches ended {_TRIES} times, as for want of memory; match again to go on "
    "from what it found"
)


class Ended(NamedTuple):
    """What a run was of and has come to, or in a line why it failed."""

    began: FilmDocument
    found: abfm.Sequence | str
    was_recovered: bool  # it only told what an earlier one had found


class FilmMatch:
    """At most one run; its fields are there as soon as they are found, its result at its end. What
    it found is kept in a file meanwhile: the next run of the same goes on from it.

    Attributes
    ----------
    beside : callable
        Returns the file beside which that is, for a document; by default there is none.
    """

    failed = False  # errors of a run are notices

    def __init__(self) -> None:
        self.beside: Callable[[FilmDocument], Path | None] = lambda document: None
        self.step: Step | None = None  # what it does, read at any time
        self.pair: tuple[int, int] | None = None  # frames to match by themselves, if chosen
        self._began: FilmDocument | None = None  # what the run is of
        self._goes_on = True
        self._fields: dict[int, FloatArray] = {}  # of the run, by interval
        self._fast = 0.0  # the largest of what counted as fast in the run's fields
        self._control = Control()
        self._work: Future[abfm.Sequence] | None = None
        self._worker = Worker(stateless, _ENDED_MESSAGE)
        self._speeds = Memo[FloatArray]()
        self._of_result = Memo[tuple[FloatArray | None, ...]]()

    @property
    def running(self) -> bool:
        return self._work is not None

    @property
    def began(self) -> FilmDocument | None:
        """What the run is of that is under way, the same object all the time."""
        return self._began

    @property
    def paused(self) -> bool:
        return self.running and self._control.paused

    def start(self, document: FilmDocument, goes_on: bool = True) -> None:
        """Match all frames of a document's film, unless a run is under way, after what one of the
        same had found that did not come to its end; or, unless it `goes_on`, tell only that.
        """
        if self.running:
            return
        self._began, self._control, self._fields = document, Control(), {}
        self._fast, self._goes_on = 0.0, goes_on
        self.step = Step("starting the solver" if goes_on else "reading what was found")
        film = document.film.frames, document.settings, self.beside(document), goes_on
        self._work = THREADS.submit(self._solve, film, self._fields, self._control)

    def pause(self) -> None:
        self._control.pause()

    def resume(self) -> None:
        self._control.resume()

    def cancel(self) -> None:
        """Ask for what was found so far; returns at once."""
        if self.running:
            self._control.cancel()

    def found(self, document: FilmDocument) -> int:
        """Return how many fields a run of the document has found."""
        return len(self._fields) if self._is_of(document) else 0

    def fast(self, document: FilmDocument) -> float:
        """Return what counts as fast in any of the fields that a run of the document has found, 0
        without any; it only grows.
        """
        return self._fast if self.found(document) else 0.0

    def words(self) -> str:
        """Return in a line what a run does."""
        doing = "paused" if self.paused else self.step.words() if self.step else "matching"
        if self._began is None:
            return doing
        return f"{doing}, {len(self._fields)} of {self._began.film.intervals} intervals found"

    def field(self, document: FilmDocument, interval: int) -> FloatArray | None:
        """Return the field (F, 3) of an interval, always the same array; None where none is known.
        A run's own fields are shown as soon as there is one.
        """
        if self._is_of(document) and self._fields:
            return self._fields.get(interval)
        sequence = document.result
        if sequence is None or interval >= len(sequence):
            return None

        def fields() -> tuple[FloatArray | None, ...]:
            known = zip(sequence.velocity, sequence.solved, strict=True)
            return tuple(field if is_solved else None for field, is_solved in known)

        return self._of_result.get((sequence,), fields)[interval]

    def motion(self, document: FilmDocument, interval: int) -> float:
        """Return the share of motion in frames between two, see `abfm.Sequence.motion_shares`; 1
        during a run.
        """
        sequence = document.result
        if sequence is None or (self._is_of(document) and self._fields):
            return 1.0
        return float(sequence.motion_shares[interval])

    def speeds(self, document: FilmDocument) -> FloatArray:
        """Return the root mean square of the speed in each interval, (T - 1,), or NaN."""
        film = document.film
        fields = [self.field(document, interval) for interval in range(film.intervals)]

        def measure() -> FloatArray:
            areas = abfm.calculus.face_areas(film.frames.mesh)
            shares = areas / areas.sum()
            squares = [
                np.nan if each is None else shares @ np.einsum("fx,fx->f", each, each)
                for each in fields
            ]
            return np.asarray(np.sqrt(np.array(squares)))

        return self._speeds.get((film, *fields), measure)

    def collect(self) -> Ended | None:
        """Return, once, what a run has come to."""
        if self._work is None or self._began is None or not self._work.done():
            return None
        work, began = self._work, self._began
        self._fields, self._work, self._began, self.step = {}, None, None, None
        try:
            found = work.result()
        except Exception as error:
            return Ended(began, error_line(error), not self._goes_on)
        # the frames that it was sent are the document's
        own = replace(found, _frames=began.film.frames)
        return Ended(began, own, not self._goes_on)

    def close(self) -> None:
        self.cancel()
        self._worker.close()
        if self._work is not None:
            wait([self._work], 1.0)

    def _is_of(self, document: FilmDocument) -> bool:
        return self._began is not None and self._began.film is document.film

    @factoring_apart()
    def _solve(
        self,
        film: tuple[abfm.sequences.Frames, FilmSettings, Path | None, bool],
        fields: dict[int, FloatArray],
        control: Control,
    ) -> abfm.Sequence:
        mesh = film[0].mesh

        def take(found: tuple[int, FloatArray]) -> None:
            interval, field = found
            speed = np.linalg.norm(field, axis=1)
            fast = abfm.calculus.fast_speed(mesh, speed)
            if fields is self._fields:  # else another run has begun
                self._fast = max(self._fast, fast)
            fields[interval] = field

        def tell(step: Step | None) -> None:
            self.step = step or self.step

        def run() -> abfm.Sequence:
            return self._worker.call(_matched, *film).result(take)

        with telling(tell), controlled(control):
            for _ in range(1, _TRIES):
                with suppress(WorkerEndedError):
                    return run()
            return run()


def _matched(
    _: None,
    frames: abfm.sequences.Frames,
    settings: FilmSettings,
    beside: Path | None,
    goes_on: bool,
) -> abfm.Sequence:
    values = frames.values if frames.channels_given else frames.values[:, :, 0]
    return abfm.sequence(
        frames.mesh,
        values,
        frames.times,
        settings.parameters,
        settings.gamma,
        mask=frames.mask,
        weights=frames.weights,
        unfinished=abfm.sequences.Unfinished(beside, goes_on=goes_on),
        on_field=lambda interval, field: report((interval, field)),
    )
