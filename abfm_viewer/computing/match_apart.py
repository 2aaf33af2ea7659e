"""`abfm.match` in a process of its own, so that a window and its solver do not wait for each other.

While a frame is drawn polyscope holds Python's interpreter, without a graphics card nearly all of
the time: a solver in a thread of the same process got a tenth of it. The other process gets a mesh
once, and keeps what was computed from it. `Matching` is its end, `MatchApart` that of the window.
"""

from __future__ import annotations

import itertools
import time as clock
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NoReturn

import abfm
from abfm import Parameters, TriangleMesh
from abfm.numerics.factoring_apart import factoring_apart
from abfm.types import FloatArray
from abfm.workers.worker import Worker, WorkerEndedError, report
from abfm_viewer.computing.freed_memory import give_back

_ENDED_MESSAGE = "the process that matches has ended; match again"
_ITERATES_KEPT = 4  # of the newest iterates whose fields may be requested, besides the best one
_TIMES_A_PICTURE = 9
_WAIT_SECONDS_MIN = 0.05
_WAIT_SECONDS_MAX = 0.2
"""How long no picture is made after one, so that pictures take a tenth of the time: times what it
took, and at least and at most, in seconds."""

Fields = tuple[FloatArray, FloatArray]
"""The fields (N, F, 3) of an iterate, and the source carried by them (V, C)."""


def better(now: abfm.Iteration, before: abfm.Iteration) -> bool:
    """Return whether an iterate is at least as good as an earlier one of the same problem."""
    return now.residual <= before.residual


def _forgotten() -> NoReturn:
    raise abfm.AbfmError("the field of that iterate is not known any more")


@dataclass(eq=False)
class IteratePicture:
    """What an iterate looks like, as far as it came along: some come with their `picture`.

    What else is asked for is fetched, both of one iterate, if it is not known any more of one close
    by; that waits for the other process, so not in the frame loop.
    """

    warning: str | None
    picture: FloatArray | None = None
    field: FloatArray | None = None
    fetch: Callable[[], Fields] = _forgotten

    @property
    def velocity(self) -> FloatArray:
        if self.field is None:
            self.field, self.picture = self.fetch()
        return self.field

    @property
    def advected(self) -> FloatArray:
        if self.picture is None:
            self.field, self.picture = self.fetch()
        return self.picture


class Matching:
    """What the process does, and of a run and the one before the best pictured iterate, and the
    last few.
    """

    def __init__(self) -> None:
        self._recent: dict[int, tuple[abfm.Iteration, ...]] = {}

    def prepare(self, mesh: TriangleMesh, parameters: Parameters) -> None:
        with factoring_apart():
            abfm.matching.prepare(mesh, parameters)

    def match(self, run: int, problem: abfm.Problem) -> abfm.Match:
        """Match, and report every iterate, the first and some others with their pictures."""
        before, next_picture = max(self._recent, default=0), 0.0
        self._recent = {before: self._recent.get(before, ()), run: ()}

        def post(iteration: abfm.Iteration) -> None:
            nonlocal next_picture
            look = IteratePicture(iteration.warning)
            if (began := clock.perf_counter()) >= next_picture:
                look.picture = iteration.advected
                done = clock.perf_counter()
                wait = max(_TIMES_A_PICTURE * (done - began), _WAIT_SECONDS_MIN)
                next_picture = done + min(wait, _WAIT_SECONDS_MAX)
                self._recent[run] = _worth_keeping((*self._recent[run], iteration))
            report(replace(iteration, look=look))

        try:
            with factoring_apart():
                return abfm.match(problem, on_iteration=post)
        finally:
            # of a run that has ended the best fields stay, and not the workspace behind them
            kept = self._recent[run] = self._recent[run][:1]  # requests meanwhile find it
            try:
                self._recent[run] = tuple(
                    replace(last, look=IteratePicture(last.warning, last.advected, last.velocity))
                    for last in kept
                )
            except MemoryError:
                self._recent[run] = ()
            give_back()

    def fields(self, run: int, iteration: int) -> Fields:
        """Return those of an iterate, or of the best one so far; AbfmError if none is known."""
        known = self._recent.get(run) or _forgotten()
        found = next((each for each in known if each.iteration == iteration), known[0])
        return found.velocity, found.advected


def _worth_keeping(known: tuple[abfm.Iteration, ...]) -> tuple[abfm.Iteration, ...]:
    """Return the best of some iterates, and after it the last few of the others."""
    best, *others = known
    for one in others:
        if better(one, best):
            best = one
    others = [one for one in known if one is not best]
    return (best, *others[-_ITERATES_KEPT:])


class MatchApart:
    """Runs one match after the other in a process, which starts with the first, again if it ended.

    One that is idle when it is closed leaves its process to the next one, which sees nothing of it:
    a script that opens one window after the other needs one process.
    """

    _spare: ClassVar[list[Worker[Matching]]] = []
    _runs: ClassVar[Iterator[int]] = itertools.count(1)

    def __init__(self) -> None:
        self._is_matching = self._closed = False

    @cached_property
    def _worker(self) -> Worker[Matching]:
        if self._closed:
            raise WorkerEndedError(_ENDED_MESSAGE)
        with suppress(IndexError):
            return self._spare.pop()
        return Worker(Matching, _ENDED_MESSAGE)

    def prepare(self, mesh: TriangleMesh, parameters: Parameters) -> None:
        """Let it make the coarser meshes; a match that comes meanwhile begins after that."""
        self._worker.call(Matching.prepare, mesh, parameters)

    def match(
        self, problem: abfm.Problem, on_iteration: Callable[[abfm.Iteration], None]
    ) -> abfm.Match:
        """As `abfm.match`, held and ended by the control of this thread; or WorkerEndedError."""
        self._is_matching = True
        run = next(self._runs)
        call = self._worker.call(Matching.match, run, problem)

        def take(iteration: abfm.Iteration) -> None:
            def fetch() -> Fields:
                return call.beside(Matching.fields, run, iteration.iteration).result()

            assert isinstance(iteration.look, IteratePicture)
            iteration.look.fetch = fetch
            on_iteration(iteration)

        found = call.result(take)
        self._is_matching = False
        return found

    def close(self) -> None:
        """Take no more; a match that is under way is ended at once."""
        was_closed, self._closed = self._closed, True
        if was_closed or "_worker" not in vars(self):  # nothing has started
            return
        if self._is_matching or self._spare:
            self._worker.close()
        else:
            self._spare.append(self._worker)
