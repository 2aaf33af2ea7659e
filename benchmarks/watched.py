"""Matches that record the history of their iterates on the mesh itself, and can stop early."""

from dataclasses import dataclass
from math import inf
from time import perf_counter

import numpy as np

from abfm import Match, Parameters, Problem, match
from abfm.matching import Iteration
from abfm.types import FloatArray
from abfm.workers import Control

MISMATCH = Parameters.goal
"""Mismatch, relative to the norm of the target, until which iterations and seconds are counted."""


@dataclass(frozen=True)
class WatchedMatch:
    """A match, and the history of its iterates on the mesh itself.

    Attributes
    ----------
    history : (rows, 3) array
        Seconds, energy and mismatch of each iterate. Seconds since the start of the match include
        coarser meshes and the setup of the problem.
    """

    match: Match
    history: FloatArray
    seconds: float

    @property
    def iterations_to_mismatch(self) -> int | None:
        """Iterations on the mesh itself until the mismatch is at most `MISMATCH`, or None."""
        reached = np.flatnonzero(self.history[:, 2] <= MISMATCH)
        return int(reached[0]) if len(reached) else None

    @property
    def seconds_to_mismatch(self) -> float | None:
        """Seconds until the mismatch is at most `MISMATCH`, or None."""
        reached = self.iterations_to_mismatch
        return None if reached is None else float(self.history[reached, 0])


def watched_match(
    problem: Problem, seconds: float = inf, energy: float = -inf, mismatch: float = -inf
) -> WatchedMatch:
    """Solve a match, or stop early after a time, or at an energy or mismatch on the mesh itself."""
    control = Control()
    functions = problem.functions
    # the paper's mismatch is relative to the norm of the target
    ratio = functions.deviation(functions.target) / functions.norm(functions.target)
    history: list[tuple[float, float, float]] = []
    start = perf_counter()

    def watch(iterate: Iteration) -> None:
        now, is_low = perf_counter() - start, False
        if iterate.level == iterate.levels - 1:
            history.append((now, iterate.energy, ratio * iterate.residual))
            is_low = iterate.energy < energy or ratio * iterate.residual <= mismatch
        if now > seconds or is_low:
            control.cancel()

    found = match(problem, on_iteration=watch, control=control)
    return WatchedMatch(found, np.array(history).reshape(-1, 3), perf_counter() - start)
