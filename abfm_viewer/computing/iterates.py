"""A match in a subprocess, which reports its iterates to the process of the window.

An iterate is the state of the solver after an iteration. Some reports contain the advected source,
as a picture for the window, or also the fields.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NoReturn

import abfm
from abfm import Parameters, TriangleMesh
from abfm.numerics.factoring_in_subprocess import factoring_in_subprocess
from abfm.tasks.monitor import Monitor
from abfm.types import FloatArray
from abfm.workers.control import Control, current_control
from abfm.workers.worker import report
from abfm_viewer.computing.freed_memory import return_free_memory
from abfm_viewer.computing.run import ProcessCache

_RECENT_ITERATES = 4  # newest iterates whose fields can be requested, in addition to the best one
_PICTURE_WAIT_RATIO = 9
"""Ratio of the wait between two pictures to the time for one: pictures take a tenth of all time."""
_WAIT_SECONDS_MIN = 0.05
_WAIT_SECONDS_MAX = 0.2
FIRST_FIELD_SECONDS = 2.0
"""Seconds after which a match first sends its fields without a request.

The fields are needed if the process is killed. A shorter match then loses little.
"""
_FIELD_WAIT_RATIO = 49
"""Least ratio of the wait between two sent fields to the time for sending: 2% of all time."""
_FIELD_WAIT_GROWTH = 1.5  # ratio of a wait between two sent fields to the wait before it
_FIELD_WAIT_SECONDS_MAX = 20.0
_SECONDS_PER_VERTEX = 1e-6  # time to send fields: 33 ms at 40,962 vertices

Fields = tuple[FloatArray, FloatArray]
"""The fields (N, F, 3) of an iterate and the source advected by them (V, C)."""


def better(now: abfm.matching.Iteration, before: abfm.matching.Iteration) -> bool:
    """Return whether the residual of an iterate is at most that of an earlier one."""
    return now.residual <= before.residual


def _raise_not_stored() -> NoReturn:
    raise abfm.AbfmError("the field of this iterate is no longer stored")


@dataclass(eq=False)
class IteratePicture:
    """Fields and advected source of an iterate, fetched from the subprocess when they are needed.

    Some iterates arrive with the advected source (`picture`). Otherwise the first access fetches
    both arrays. If the subprocess no longer stores them, those of the best iterate are fetched.
    This access waits for the subprocess, so drawing code must not make it.
    """

    warning: str | None
    picture: FloatArray | None = None
    field: FloatArray | None = None
    fetch: Callable[[], Fields] = _raise_not_stored

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


# The functions below run in the subprocess. It stores, for the present and the previous run, the
# best iterate with a picture, and for the present one also the newest iterates.


def prepare(_: ProcessCache, mesh: TriangleMesh, parameters: Parameters) -> None:
    with factoring_in_subprocess():
        abfm.matching.prepare(mesh, parameters)


def match(cache: ProcessCache, run: int, task: abfm.matching.MatchTask) -> abfm.Match:
    """Solve a match and report its iterates, as described in `_Reports`.

    ``run`` is the number under which ``cache`` stores iterates.
    """
    before = max(cache, default=0)
    for earlier in cache.keys() - {before}:
        del cache[earlier]
    cache[run] = ()
    reports = _Reports(cache, run, len(task.problem.mesh.vertices))
    try:
        with factoring_in_subprocess():
            return task.solve(Monitor(current_control() or Control(), reports.add))
    finally:
        # only the best fields of a finished run stay in memory, without the solver's workspace
        best = cache[run] = cache[run][:1]  # for requests in the meantime
        try:
            cache[run] = tuple(map(_with_fields, best))
        except MemoryError:
            cache[run] = ()
        return_free_memory()


class _Reports:
    """Reports all iterates of a run: some with the advected source, fewer with the fields.

    The first one has the advected source. Fields are those of the best iterate.
    """

    def __init__(self, cache: ProcessCache, run: int, vertices: int) -> None:
        self._cache, self._run = cache, run
        self._next_picture = 0.0
        self._wait = max(FIRST_FIELD_SECONDS, _FIELD_WAIT_RATIO * _SECONDS_PER_VERTEX * vertices)
        self._next_fields = clock.perf_counter() + self._wait
        self._sent: abfm.matching.Iteration | None = None  # last iterate whose fields were sent

    def add(self, iteration: abfm.matching.Iteration) -> None:
        view = IteratePicture(iteration.warning)
        if (began := clock.perf_counter()) >= self._next_picture:
            view.picture = iteration.advected
            done = clock.perf_counter()
            wait = max(_PICTURE_WAIT_RATIO * (done - began), _WAIT_SECONDS_MIN)
            self._next_picture = done + min(wait, _WAIT_SECONDS_MAX)
            self._cache[self._run] = _best_and_recent((*self._cache[self._run], iteration))
        report(replace(iteration, view=view))
        best = self._cache[self._run][0]
        if began >= self._next_fields and best.iteration and best is not self._sent:
            report(_with_fields(best))
            took = clock.perf_counter() - began
            wait = min(_FIELD_WAIT_GROWTH * self._wait, _FIELD_WAIT_SECONDS_MAX)
            self._wait = max(wait, _FIELD_WAIT_RATIO * took)
            self._next_fields, self._sent = began + took + self._wait, best


def _with_fields(last: abfm.matching.Iteration) -> abfm.matching.Iteration:
    return replace(last, view=IteratePicture(last.warning, last.advected, last.velocity))


def fields(cache: ProcessCache, run: int, iteration: int) -> Fields:
    """Return the fields and the advected source of a stored iterate of a run.

    If this iterate is not stored, those of the best iterate are returned. If none is stored, an
    `AbfmError` is raised.
    """
    stored = cache.get(run) or _raise_not_stored()
    found = next((each for each in stored if each.iteration == iteration), stored[0])
    return found.velocity, found.advected


def _best_and_recent(
    iterates: tuple[abfm.matching.Iteration, ...],
) -> tuple[abfm.matching.Iteration, ...]:
    best, *others = iterates
    for one in others:
        if better(one, best):
            best = one
    others = [one for one in iterates if one is not best]
    return (best, *others[-_RECENT_ITERATES:])
