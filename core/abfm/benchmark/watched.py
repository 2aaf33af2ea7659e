"""A match against the clock: when it arrived on the mesh itself, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from time import perf_counter

from abfm.matching.match import Control, Iteration, match
from abfm.matching.result import Match
from abfm.matching.schedule import MATCHED
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray

LEVEL = MATCHED
"""Relative mismatch to reach."""


@dataclass(frozen=True)
class Watched:
    """What happened.

    Attributes
    ----------
    found : Match
    last : Iteration or None
        The latest iterate.
    to_level : float
        Seconds until the mismatch on the mesh itself was at most `LEVEL`; inf if it never was.
    to_end : float
        Seconds of all of `abfm.match`.
    """

    found: Match
    last: Iteration | None
    to_level: float
    to_end: float


def watched_match(
    mesh: TriangleMesh, source: FloatArray, target: FloatArray, parameters: Parameters, limit: float = inf
) -> Watched:
    """Match; after ``limit`` seconds it is cancelled and ends with what it has.

    Raises
    ------
    AbfmError
        As `abfm.match` does.
    """
    control = Control()
    last: Iteration | None = None
    to_level = inf
    start = perf_counter()

    def watch(iterate: Iteration) -> None:
        nonlocal last, to_level
        last, seconds = iterate, perf_counter() - start
        if iterate.level == iterate.levels - 1 and iterate.mismatch <= LEVEL:
            to_level = min(to_level, seconds)
        if seconds > limit:
            control.cancel()

    found = match(mesh, source, target, parameters, on_iteration=watch, control=control)
    return Watched(found, last, to_level, perf_counter() - start)
