"""The best fields so far: what a match returns, whatever ends it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from abfm.matching.objective.objective import Evaluation
from abfm.matching.solving.schedule import Stage
from abfm.numerics.optimizer import State
from abfm.types import FloatArray


class Candidate(NamedTuple):
    """Frame coefficients (N, F, 2), and the objective there."""

    x: FloatArray
    point: Evaluation


@dataclass(frozen=True)
class Progress:
    """What a descent goes on from.

    Attributes
    ----------
    best : Candidate, optional
        On the level of the latest stage.
    learned : State, optional
        The iterate whose pairs tell how the energy bends there.
    before : Stage, optional
        The latest one that was minimised.
    """

    best: Candidate | None = None
    learned: State[Evaluation] | None = None
    before: Stage | None = None


class Descends(Protocol):
    """What has an incumbent."""

    progress: Progress

    def mismatch_of(self, candidate: Candidate) -> float:
        """Relative mismatch of a candidate on the level of the latest stage."""
        ...


class Incumbent:
    """What is known to be best while something is tried out.

    If anything ends the trial early, be it cancelled, out of memory or a fault, the descent is back
    at the incumbent, or stays with what the trial has found if that leaves less.

    Parameters
    ----------
    descent : Descends
    progress : Progress
        The incumbent, on the same level as the trial; it may be replaced meanwhile.
    mismatch : float
        What the incumbent leaves; 0 where the trial has to come to its end to be trusted.
    """

    def __init__(self, descent: Descends, progress: Progress, mismatch: float = 0.0) -> None:
        self.progress = progress
        self._descent, self._mismatch = descent, mismatch

    def __enter__(self) -> Incumbent:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            return
        descent = self._descent
        # the incumbent first: there may be no memory to compare
        tried, descent.progress = descent.progress, self.progress
        if tried.best is not None and descent.mismatch_of(tried.best) <= self._mismatch:
            descent.progress = tried
