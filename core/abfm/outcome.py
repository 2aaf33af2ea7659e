"""The outcome of a task: one word, and how every view ranks and colours it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal, overload

import numpy as np

from abfm.types import FloatArray

Tone = Literal["good", "warning", "failure", "muted", "ink"]
"""How a view shows an outcome, the name of a colour of the theme; ink is that of plain text."""


class Outcome(StrEnum):
    """What a task achieved, from the best to the worst.

    The first five are the verdicts of a match, a registration or an interval of a sequence; the
    others are outcomes of rows in tables.
    """

    MATCHED = "matched"
    """The residual of both checks is at most the goal."""
    REGISTERED = "registered"
    """Measured functions match as closely as the data support."""
    NEARLY = "nearly"
    """The residual is above the goal and at most `RESIDUAL_NEARLY`."""
    NOT_REACHED = "not reached"
    """This flow does not match the functions."""
    IMPOSSIBLE = "impossible"
    """No flow can match the functions."""
    OUTLIER = "does not fit"
    """A subject that does not fit the others of its population."""
    MISSING = "missing"
    """A row that has not been solved."""
    FAILED = "failed"
    """A row that raised an error."""

    @property
    def is_good(self) -> bool:
        """Return whether the task succeeded: exit status 0."""
        return self in (Outcome.MATCHED, Outcome.REGISTERED, Outcome.NEARLY)

    @property
    def rank(self) -> int:
        """Return the place in the order from the best (0) to the worst."""
        return list(Outcome).index(self)

    @property
    def tone(self) -> Tone:
        """Return the colour of the outcome."""
        if self is Outcome.NEARLY:
            return "warning"
        if self is Outcome.MISSING:
            return "muted"
        return "good" if self.is_good else "failure"


VERDICTS = tuple(outcome for outcome in Outcome if outcome.rank <= Outcome.IMPOSSIBLE.rank)
"""The outcomes of a match."""
RESIDUAL_NEARLY = 0.15
"""Largest residual of functions that nearly match."""


@overload
def worse_residual(residual: float, verified: float) -> float: ...
@overload
def worse_residual(residual: FloatArray, verified: FloatArray) -> FloatArray: ...
def worse_residual(residual: Any, verified: Any) -> Any:
    """Return the larger residual of two checks, the discrete flow and flow lines; also of arrays.

    A check that was not made is NaN and does not count; the result is NaN if neither was made.
    """
    worse = np.fmax(residual, verified)
    return worse if np.ndim(worse) else float(worse)


def outcome_of(residual: float, goal: float) -> Outcome:
    """Return the outcome that a residual has by its size alone."""
    if residual <= goal:
        return Outcome.MATCHED
    return Outcome.NEARLY if residual <= max(RESIDUAL_NEARLY, goal) else Outcome.NOT_REACHED


@dataclass(frozen=True)
class Facts:
    """What is reported of a result: every view shows these.

    Attributes
    ----------
    outcome : Outcome
    headline : str
        A few words with the main numbers, such as "matched to 4%".
    reason : str
        Why, in one line without a full stop.
    advice : str
        What to try, in one line; empty if nothing is needed.
    numbers : mapping of str to float or None
        Measurements by name; None for one that is unknown.
    warnings : tuple of str
        One line each.
    is_complete : bool
        Whether the run came to its own end: False if it was cancelled or never solved.
    """

    outcome: Outcome
    headline: str
    reason: str = ""
    advice: str = ""
    numbers: Mapping[str, float | None] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    is_complete: bool = True

    @property
    def tone(self) -> Tone:
        """Return the colour of the result: a good outcome with a warning is not all good."""
        if not self.is_complete or (self.outcome.tone == "good" and self.warnings):
            return "warning"
        return self.outcome.tone

    @property
    def lines(self) -> list[str]:
        """The headline, the reason and the warnings, one line each."""
        return [self.headline, self.reason, *(f"warning: {each}" for each in self.warnings)]

    @property
    def notes(self) -> list[str]:
        """The reason, the warnings and the advice, one line each."""
        advice = f"advice: {self.advice}" if self.advice else ""
        return [line for line in (*self.lines[1:], advice) if line]

    def number(self, name: str) -> float:
        """Return a measurement; NaN if it is unknown."""
        value = self.numbers.get(name)
        return math.nan if value is None else value

    @property
    def worse_residual(self) -> float:
        """The larger residual of both checks; NaN if it is unknown."""
        return worse_residual(self.number("residual"), self.number("verified_residual"))
