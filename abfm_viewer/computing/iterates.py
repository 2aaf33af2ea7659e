"""A match in a subprocess: all iterates are reported, some with pictures; fields on request."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NoReturn

import abfm
from abfm import Parameters, TriangleMesh
from abfm.numerics.factoring_apart import factoring_apart
from abfm.tasks.monitor import Monitor
from abfm.types import FloatArray
from abfm.workers.control import Control, present_control
from abfm.workers.worker import report
from abfm_viewer.computing.freed_memory import give_back
from abfm_viewer.computing.run import Kept

_ITERATES_KEPT = 4  # of the newest iterates whose fields may be requested, besides the best one
_TIMES_A_PICTURE = 9
_WAIT_SECONDS_MIN = 0.05
_WAIT_SECONDS_MAX = 0.2
"""How long no picture is made after one, so that pictures take a tenth of the time: times what it
took, and at least and at most, in seconds."""
FIRST_FIELD_SECONDS = 2.0
"""Seconds of a match before fields are sent unasked, in case the process is killed: shorter ones
lose little, and should lose no time."""
_TIMES_A_FIELD = 49
_GROWTH = 1.5
_FIELD_WAIT_SECONDS_MAX = 20.0
"""How long none are sent after some, at least: times what it took, so that sending takes 2% of the
time, and times the wait before; and at most."""
_SECONDS_PER_VERTEX = 1e-6  # of sending fields: 33 ms at 40,962 vertices

Fields = tuple[FloatArray, FloatArray]
"""The fields (N, F, 3) of an iterate, and the source carried by them (V, C)."""


def better(now: abfm.Iteration, before: abfm.Iteration) -> bool:
    """Return whether an iterate is at least as good as an earlier one of the same problem."""
    return now.residual <= before.residual


def _forgotten() -> NoReturn:
    raise abfm.AbfmError("the field of that iterate is not known any more")


@dataclass(eq=False)
class IteratePicture:
    """The fields of an iterate, as far as they are known here: some come with their `picture`.

    Others are fetched, both of one iterate, if it is not known any more of one close by; that waits
    for the other process, so not in the frame loop.
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


# In the process, which keeps the best pictured iterate of the present run and of the one before,
# and after it the last few.


def prepare(_: Kept, mesh: TriangleMesh, parameters: Parameters) -> None:
    """Make the coarser meshes."""
    with factoring_apart():
        abfm.matching.prepare(mesh, parameters)


def match(kept: Kept, run: int, task: abfm.matching.MatchTask) -> abfm.Match:
    """Match, and report every iterate, the first and some others with their pictures, and now and
    then the best one once more, with its fields.
    """
    before = max(kept, default=0)
    for earlier in kept.keys() - {before}:
        del kept[earlier]
    kept[run] = ()
    reports = _Reports(kept, run, len(task.problem.mesh.vertices))
    try:
        with factoring_apart():
            return task.solve(Monitor(present_control() or Control(), reports.add))
    finally:
        # of a run that has ended the best fields stay, and not the workspace behind them
        best = kept[run] = kept[run][:1]  # requests meanwhile find it
        try:
            kept[run] = tuple(map(_with_fields, best))
        except MemoryError:
            kept[run] = ()
        give_back()


class _Reports:
    """Reports iterates, so that pictures take a tenth of the time, and fields 2%."""

    def __init__(self, kept: Kept, run: int, vertices: int) -> None:
        self._kept, self._run = kept, run
        self._next_picture = 0.0
        self._wait = max(FIRST_FIELD_SECONDS, _TIMES_A_FIELD * _SECONDS_PER_VERTEX * vertices)
        self._next_fields = clock.perf_counter() + self._wait
        self._sent: abfm.Iteration | None = None  # with its fields

    def add(self, iteration: abfm.Iteration) -> None:
        view = IteratePicture(iteration.warning)
        if (began := clock.perf_counter()) >= self._next_picture:
            view.picture = iteration.advected
            done = clock.perf_counter()
            wait = max(_TIMES_A_PICTURE * (done - began), _WAIT_SECONDS_MIN)
            self._next_picture = done + min(wait, _WAIT_SECONDS_MAX)
            self._kept[self._run] = _worth_keeping((*self._kept[self._run], iteration))
        report(replace(iteration, view=view))
        best = self._kept[self._run][0]
        if began >= self._next_fields and best.iteration and best is not self._sent:
            report(_with_fields(best))
            took = clock.perf_counter() - began
            wait = min(_GROWTH * self._wait, _FIELD_WAIT_SECONDS_MAX)
            self._wait = max(wait, _TIMES_A_FIELD * took)
            self._next_fields, self._sent = began + took + self._wait, best


def _with_fields(last: abfm.Iteration) -> abfm.Iteration:
    return replace(last, view=IteratePicture(last.warning, last.advected, last.velocity))


def fields(kept: Kept, run: int, iteration: int) -> Fields:
    """Return those of an iterate, or of the best one so far; AbfmError if none is known."""
    known = kept.get(run) or _forgotten()
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
