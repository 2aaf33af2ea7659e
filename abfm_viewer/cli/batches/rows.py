"""Rows of a summary: what a ledger has of each, with the facts of its result."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from abfm.batch import LedgerEntry
from abfm.outcome import Facts, Outcome

ROWS_SHOWN_MAX = 1000
"""Rows on a page, which has about 6 MB with their pictures."""
_NUMBERS = ("residual", "verified_residual", "folded", "log2_area")


class SummaryRow(NamedTuple):
    """A row of a batch and its facts; without numbers if it has no result."""

    entry: LedgerEntry
    facts: Facts

    @property
    def name(self) -> str:
        """The name of the row."""
        return self.entry.row.name

    @property
    def is_known(self) -> bool:
        """Whether there is a result that can be read."""
        return bool(self.facts.numbers)

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers and texts; None for what is unknown."""
        entry, facts = self.entry, self.facts
        return {
            "name": self.name,
            "digest": entry.digest or None,
            "verdict": str(facts.outcome),
            **{number: facts.numbers.get(number) for number in _NUMBERS},
            "seconds": entry.record.seconds,
            "reason": facts.reason or None,
            "file": None if entry.path is None else entry.path.name,
        }


def summary_row(entry: LedgerEntry) -> SummaryRow:
    """Read the facts of a row."""
    return SummaryRow(entry, entry.facts)


def counts(rows: Iterable[SummaryRow]) -> dict[Outcome, int]:
    """Return the number of rows by outcome, the best outcome first."""
    found = Counter(row.facts.outcome for row in rows)
    return {outcome: found[outcome] for outcome in sorted(found, key=lambda each: each.rank)}


def worst(rows: Sequence[SummaryRow]) -> list[SummaryRow]:
    """Return the rows with the worst outcomes, then the largest residuals, at most
    `ROWS_SHOWN_MAX`.
    """
    return heapq.nsmallest(ROWS_SHOWN_MAX, rows, key=_goodness)


def _goodness(row: SummaryRow) -> tuple[int, float]:
    residual = row.facts.worse_residual
    return -row.facts.outcome.rank, -residual if residual > 0 else 0.0
