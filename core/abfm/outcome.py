"""Outcomes and warnings of tasks, and the facts reported of a result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal, overload

import numpy as np

from abfm.types import FloatArray

Tone = Literal["good", "warning", "failure", "muted", "ink"]
"""Name of the theme colour that shows an outcome; ``ink`` is the colour of plain text."""


class Outcome(StrEnum):
    """Outcome of a task; members are ordered from the best to the worst.

    The first five are the verdicts of a match, a registration or an interval of a sequence. The
    others are outcomes of rows in tables.
    """

    MATCHED = "matched"
    """Both checks (discrete flow and flow lines) have a residual of at most the goal."""
    REGISTERED = "registered"  # measured functions match as closely as the data support
    NEARLY = "nearly"  # the larger residual is above the goal, but at most `RESIDUAL_NEARLY`
    NOT_REACHED = "not reached"  # this flow does not match the functions
    IMPOSSIBLE = "impossible"  # no flow can match source to target, or none target to source
    OUTLIER = "outlier"  # a subject is an outlier of its population
    MISSING = "missing"  # the row has not been solved
    FAILED = "failed"  # the row raised an error

    @property
    def is_good(self) -> bool:
        """Whether the task succeeded (exit status 0)."""
        return self in (Outcome.MATCHED, Outcome.REGISTERED, Outcome.NEARLY)

    @property
    def rank(self) -> int:
        """Position in the order from the best (0) to the worst."""
        return list(Outcome).index(self)

    @property
    def tone(self) -> Tone:
        """Name of the theme colour that shows the outcome."""
        if self is Outcome.NEARLY:
            return "warning"
        if self is Outcome.MISSING:
            return "muted"
        return "good" if self.is_good else "failure"


class WarningTopic(StrEnum):
    """Name of a warning; ``abfm.explanations`` has a section for each."""

    AREAS_CHANGE = "areas change"
    LIMIT_EXCEEDED = "limit exceeded"
    FOLDED_FACES = "folded faces"
    FLIPPED_FACES = "flipped faces"
    COLLAPSED_FACES = "collapsed faces"
    LOW_COVERAGE = "low coverage"
    ROUND_TRIP_ERROR = "round-trip error"
    MAP_NOT_MEASURED = "map not measured"
    UNRELIABLE_MAP = "unreliable map"
    NOT_CONFIRMED = "intervals not confirmed"
    RECOMPUTED_VALUES = "recomputed values"
    HEMISPHERES = "hemispheres"
    MESH_DEFECTS = "mesh defects"


VERDICTS = tuple(outcome for outcome in Outcome if outcome.rank <= Outcome.IMPOSSIBLE.rank)
"""The outcomes that a match can have."""
RESIDUAL_NEARLY = 0.15  # largest residual of the outcome `Outcome.NEARLY`


@overload
def worse_residual(residual: float, verified: float) -> float: ...
@overload
def worse_residual(residual: FloatArray, verified: FloatArray) -> FloatArray: ...
def worse_residual(residual: Any, verified: Any) -> Any:
    """Return the larger residual of the two checks, by element; NaN stands for a missing check."""
    worse = np.fmax(residual, verified)
    return worse if np.ndim(worse) else float(worse)


def outcome_of(residual: float, goal: float) -> Outcome:
    """Return the outcome matched, nearly or not reached, from the size of a residual alone."""
    if residual <= goal:
        return Outcome.MATCHED
    return Outcome.NEARLY if residual <= max(RESIDUAL_NEARLY, goal) else Outcome.NOT_REACHED


@dataclass(frozen=True)
class Facts:
    """The facts of a result that all reports, pages and panels show.

    Attributes
    ----------
    outcome : Outcome
    headline : str
        A few words with the main numbers, such as "matched (residual 4%)".
    reason : str
        The reason for the outcome, in one line without a full stop.
    advice : str
        A suggestion for a better result, in one line; empty if none is needed.
    numbers : mapping of str to float or None
        Measurements by name; None if unknown.
    warnings : tuple of str
        Warnings about the result, one line each.
    is_complete : bool
        False if the run was interrupted (cancelled, or out of memory) or was never solved.
    topics : tuple of str
        Names of the sections of ``abfm.explanations`` that explain the outcome and the warnings;
        by default that of the outcome.
    short_headline : str
        The headline with shorter words, such as "areas ×1.4"; by default the headline.
    """

    outcome: Outcome
    headline: str
    reason: str = ""
    advice: str = ""
    numbers: Mapping[str, float | None] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    is_complete: bool = True
    topics: tuple[str, ...] = ()
    short_headline: str = ""

    def __post_init__(self) -> None:
        topics = dict.fromkeys(map(str, self.topics or [self.outcome]))  # removes repetitions
        object.__setattr__(self, "topics", tuple(topics))
        object.__setattr__(self, "short_headline", self.short_headline or self.headline)

    @property
    def needs_help(self) -> bool:
        """Whether the result is incomplete, has warnings, or is neither matched nor registered."""
        is_plain = self.outcome in (Outcome.MATCHED, Outcome.REGISTERED) and self.is_complete
        return not is_plain or bool(self.warnings)

    @property
    def tone(self) -> Tone:
        """Name of the theme colour that shows the result.

        An incomplete result, or a good one with warnings, has the colour of a warning.
        """
        if not self.is_complete or (self.outcome.tone == "good" and self.warnings):
            return "warning"
        return self.outcome.tone

    @property
    def lines(self) -> list[str]:
        """The headline, the reason and the other warnings, one line each."""
        return [self.headline, self.reason, *(f"warning: {each}" for each in self.other_warnings)]

    @property
    def other_warnings(self) -> list[str]:
        """The warnings without the one that is the reason, if any."""
        return [each for each in self.warnings if each != self.reason]

    @property
    def notes(self) -> list[str]:
        """The reason, the warnings and the advice, one line each."""
        advice = f"advice: {self.advice}" if self.advice else ""
        return [line for line in (*self.lines[1:], advice) if line]

    def number(self, name: str) -> float:
        """Return a measurement by name; NaN if it is unknown."""
        value = self.numbers.get(name)
        return math.nan if value is None else value

    @property
    def worse_residual(self) -> float:
        """The larger residual of both checks (discrete flow and flow lines); NaN if unknown."""
        return worse_residual(self.number("residual"), self.number("verified_residual"))
