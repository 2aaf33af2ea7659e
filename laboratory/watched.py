"""A match against the clock: how it went on the mesh itself, and how it ended."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from time import perf_counter

import numpy as np

from abfm.matching.match import Control, Iteration, match
from abfm.matching.problem import Problem
from abfm.matching.result import Match
from abfm.matching.solving.schedule import MATCHED
from abfm.types import FloatArray

LEVEL = MATCHED
"""Relative mismatch to reach."""


@dataclass(frozen=True)
class Watched:
    """The course of a match.

    `last` is the latest iterate; `history` (rows, 3) has seconds, energy and relative mismatch of
    each iterate on the mesh itself; `to_end` are the seconds of all of `abfm.match`.
    """

    found: Match
    last: Iteration | None
    history: FloatArray
    to_end: float

    @property
    def to_level(self) -> float:
        """Return seconds until the mismatch on the mesh itself was at most `LEVEL`; inf if it never
        was.
        """
        reached = self.iterations_to_level
        return inf if reached is None else float(self.history[reached, 0])

    @property
    def iterations_to_level(self) -> int | None:
        """Return iterations on the mesh itself until then; None if it never was."""
        reached = np.flatnonzero(self.history[:, 2] <= LEVEL)
        return int(reached[0]) if len(reached) else None


def watched_match(
    problem: Problem,
    seconds: float = inf,
    energy: float = -inf,
    mismatch: float = -inf,
    stopped: Callable[[], bool] = lambda: False,
) -> Watched:
    """Match, until some seconds have passed, energy or mismatch on the mesh itself are low enough,
    or it is stopped.

    Raises
    ------
    AbfmError
        As `abfm.match` does.
    """
    control = Control()
    last: Iteration | None = None
    history: list[tuple[float, float, float]] = []
    start = perf_counter()

    def watch(iterate: Iteration) -> None:
        nonlocal last
        last, now = iterate, perf_counter() - start
        on_mesh = iterate.level == iterate.levels - 1
        if on_mesh:
            history.append((now, iterate.energy, iterate.mismatch))
        if (
            stopped()
            or now > seconds
            or (on_mesh and (iterate.energy < energy or iterate.mismatch <= mismatch))
        ):
            control.cancel()

    found = match(problem, on_iteration=watch, control=control)
    return Watched(found, last, np.array(history).reshape(-1, 3), perf_counter() - start)
