"""Which of several ways to solve one problem came closest, and which changes areas least."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from abfm.outcome import Outcome
from abfm.parameters import FIELDS, option
from abfm_viewer.cli.batches.rows import SummaryRow

_KINDS = "match", "registration"
_WAYS = {*map(option, FIELDS), "start", "initial", "max-distortion"}
"""Options that say how a problem is solved, not which."""


class Best(NamedTuple):
    """Of rows that solve one problem: the closest, of those that reached their target if there are
    any, and of these the one whose map changes areas least, if that is known of any.
    """

    closest: SummaryRow
    gentlest: SummaryRow | None
    reached: bool  # whether they reached their target
    unbeaten: frozenset[str]  # names of those that no other beats in both

    def to_dict(self) -> dict[str, str | None]:
        """Return the names of the rows."""
        gentlest = None if self.gentlest is None else self.gentlest.name
        return {"closest": self.closest.name, "areas_change_least": gentlest}

    def sentences(self) -> list[str]:
        """Return it in words."""
        first, other = self.closest, self.gentlest
        if other is None or other is first:
            both = "" if other is None else ", and areas change least"
            found = [f"closest{both}: {_told(first)}"]
        else:
            which = "of those that reached their target, " if self.reached else ""
            found = [f"closest: {_told(first)}", f"{which}areas change least: {_told(other)}"]
        has_sigma = dict(first.entry.row.options).get("sigma", "auto") != "auto"
        if first.facts.outcome is Outcome.REGISTERED and has_sigma:
            found.append(
                "the functions were measured, and closer than their noise is no better: "
                "sigma auto ends where what was held out gains no more"
            )
        return found


def best_of(rows: Sequence[SummaryRow]) -> Best | None:
    """Return which rows are best; None where they do not solve one problem in several ways, or
    fewer than two are done.
    """
    if not rows or any(_problem(row) != _problem(rows[0]) for row in rows):
        return None
    known = [row for row in rows if _residual(row) < math.inf]
    if len(known) < 2 or rows[0].entry.row.kind not in _KINDS:
        return None
    good = [row for row in known if row.facts.outcome.is_good]
    compared = good or known
    closest = min(compared, key=lambda row: (_residual(row), _areas(row)))
    gentle = [row for row in compared if _areas(row) < math.inf]
    gentlest = min(gentle, key=lambda row: (_areas(row), _residual(row)), default=None)
    return Best(closest, gentlest, bool(good), _unbeaten(gentle))


def _problem(row: SummaryRow) -> tuple[tuple[str, str], ...]:
    return tuple(pair for pair in row.entry.row.options if pair[0] not in _WAYS)


def _residual(row: SummaryRow) -> float:
    return _or_infinite(row.facts.worse_residual)


def _areas(row: SummaryRow) -> float:
    return _or_infinite(row.facts.number("log2_area"))


def _or_infinite(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _unbeaten(rows: Sequence[SummaryRow]) -> frozenset[str]:
    """Return the names of those than which no other leaves less and changes areas less."""
    found, least, last = set[str](), math.inf, (math.nan, math.nan)
    for row in sorted(rows, key=lambda row: (_residual(row), _areas(row))):
        pair = _residual(row), _areas(row)
        if pair[1] < least or pair == last:
            found.add(row.name)
            least, last = pair[1], pair
    return frozenset(found)


def _told(row: SummaryRow) -> str:
    areas = _areas(row)
    cost = f", mean |log2 J| {areas:.2f}" if areas < math.inf else ""
    return f"{row.name}: {100 * _residual(row):.2g}% left{cost}"
