"""A run's newest field that is here, should the process that matches be killed; fetching them
takes 2% of its time.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from contextlib import suppress

from abfm import AbfmError
from abfm_viewer.computing.problem import ProblemSpec, Snapshot

FIRST = 2.0
"""Seconds of a run before a field is fetched to be kept: shorter ones lose little, and should
lose no time.
"""
_TIMES_A_FIELD, _GROWTH, _LONGEST_WAIT = 49, 1.5, 20.0
"""How long none is fetched after one, at least: times what it took, and times the wait before;
and at most.
"""
_SECONDS_PER_VERTEX = 1e-6  # of fetching one: 33 ms at 40,962 vertices


class Keeper:
    """Of one run on a mesh with so many vertices; its solves `begin` one after the other.

    `newest` is the newest snapshot of the present solve whose field is here; None before there is
    one.
    """

    def __init__(self, vertices: int, now: Callable[[], float] = clock.perf_counter) -> None:
        self.newest: Snapshot | None = None
        self._problem: ProblemSpec | None = None
        self._now = now
        self._wait = max(FIRST, _TIMES_A_FIELD * _SECONDS_PER_VERTEX * vertices)
        self._next = now() + self._wait

    def begin(self, problem: ProblemSpec | None) -> None:
        """Let what comes belong to another solve."""
        self.newest, self._problem = None, problem

    def keep(self, snapshot: Snapshot) -> None:
        """Remember one whose field is here, unless it is of an earlier solve or older than what
        is known.
        """
        older = (
            self.newest is not None
            and self.newest.iteration.iteration >= snapshot.iteration.iteration
        )
        if snapshot.problem is self._problem and not older:
            self.newest = snapshot

    def fetch(self, snapshot: Snapshot) -> None:
        """Fetch its field if it is time for one; it waits, so not for the frame loop."""
        began = self._now()
        # what was shown is what can be fetched
        if began < self._next or not snapshot.shown.iteration:
            return
        with suppress(AbfmError):  # that the process has ended is told by what comes next
            _ = snapshot.iteration.velocity
            self.keep(snapshot)
        now = self._now()
        self._wait = max(min(_GROWTH * self._wait, _LONGEST_WAIT), _TIMES_A_FIELD * (now - began))
        self._next = now + self._wait
