"""The results of a batch or of a population as rows, in any order, as far as they are searched."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np

import abfm
from abfm.outcome import Facts, Outcome
from abfm.wording import counted
from abfm_viewer.document.document import Document

Name = Literal[
    "name",
    "verdict",
    "residual",
    "verified_residual",
    "folded",
    "log2_area",
    "correlation",
    "reason",
]
"""Numbers have the names that they have in facts."""


class Column(NamedTuple):
    """What a head says, what it means, and how numbers are written."""

    head: str
    tip: str
    digits: str = ""  # of numbers; empty for texts


COLUMNS: Mapping[Name, Column] = {
    "name": Column("name", "What the row is called in its table."),
    "verdict": Column("verdict", "What it came to. The worst come first."),
    "residual": Column("left", "The residual of the discrete flow.", ".2%"),
    "verified_residual": Column(
        "by flow lines", "The same by the second witness, flow lines.", ".2%"
    ),
    "folded": Column("folded", "Share of the faces that the map folds.", ".2%"),
    "log2_area": Column(
        "|log2 J|", "How much its map changes areas, mean over the surface.", ".2f"
    ),
    "correlation": Column(
        "correlation", "With the mean of the others that fit, on the template.", ".3f"
    ),
    "reason": Column("why", "What does not fit, or why it failed."),
}


@dataclass(frozen=True)
class ResultRow:
    """A row and the facts of its result."""

    number: int  # in its table
    name: str
    facts: Facts
    path: Path | None = None  # of its result
    texts: tuple[tuple[str, str], ...] = ()  # of its channels: sources and targets, as written

    @property
    def key(self) -> tuple[int, str]:
        """What tells it from other rows, also after its table was read again."""
        return self.number, self.name

    @property
    def verdict(self) -> Outcome:
        return self.facts.outcome

    def label_document(self, document: Document) -> Document:
        """Return a document called by the row's name, and its functions as the table has them."""
        specs = [spec for channel in document.channels for spec in channel.specs]
        texts = [text for pair in self.texts for text in pair]
        called = dict(zip(specs, texts, strict=True)) if len(specs) == len(texts) else {}
        return document.renamed(self.name, called)

    def cell_text(self, column: Name) -> str:
        """Return what a cell says."""
        texts = {"name": self.name, "verdict": str(self.verdict), "reason": self.facts.reason}
        if column in texts:
            return texts[column]
        value = self.facts.number(column)
        return "" if math.isnan(value) else format(value, COLUMNS[column].digits)

    def has(self, words: Sequence[str]) -> bool:
        """Return whether all words, or phrases, in lower case, are in its texts."""
        text = f"{self.name} {self.verdict} {self.facts.reason}".lower()
        return all(word in text for word in words)


@dataclass(frozen=True, eq=False)
class ResultTable:
    """The rows of a batch."""

    columns: ClassVar[tuple[Name, ...]] = (
        *("name", "verdict", "residual", "verified_residual", "folded", "log2_area", "reason"),
    )
    noun: ClassVar[str] = "row"
    has_comparisons: ClassVar[bool] = False  # of a row with the others

    place: Path  # that was opened: a folder, or a population's file
    title: str
    rows: tuple[ResultRow, ...]

    def has_values(self, row: ResultRow) -> bool:
        """Return whether a row has values on the template."""
        return False

    def can_show(self, row: ResultRow) -> bool:
        """Return whether there is something of a row that surfaces can show."""
        return row.path is not None or self.has_values(row)

    @property
    def summary(self) -> str:
        """The number of rows by verdict: ``9 rows: 7 matched, 2 failed``."""
        count = Counter(row.verdict for row in self.rows)
        parts = [f"{count[each]} {each}" for each in Outcome if count[each]]
        return f"{counted(len(self.rows), self.noun)}: {', '.join(parts) or 'none'}"

    def find(self, key: tuple[int, str] | None) -> ResultRow | None:
        return next((row for row in self.rows if row.key == key), None)

    def shown(self, column: Name, falls: bool, search: str) -> tuple[ResultRow, ...]:
        """Return the rows that have what is searched for, sorted by a column: as it was typed, or
        where no row has that, all its words.

        Verdicts rise from the worst to the best, and rows of one verdict are in the order of
        `badness`. Unknown numbers come last.
        """
        search = " ".join(search.lower().split())
        found = [row for row in self.rows if row.has([search])]
        found = found or [row for row in self.rows if row.has(search.split())]
        rows = sorted(found, key=self.badness)
        if column == "verdict":
            return tuple(reversed(rows) if falls else rows)
        if not COLUMNS[column].digits:
            rows.sort(key=lambda row: row.cell_text(column).casefold(), reverse=falls)
            return tuple(rows)
        known = [row for row in rows if not math.isnan(row.facts.number(column))]
        unknown = [row for row in rows if math.isnan(row.facts.number(column))]
        known.sort(key=lambda row: row.facts.number(column), reverse=falls)
        return (*known, *unknown)

    def badness(self, row: ResultRow) -> tuple[int, float, str]:
        """Return a key by which rows are sorted, the worst first: by verdict, then by residual."""
        worse = row.facts.worse_residual
        return -row.verdict.rank, 0.0 if math.isnan(worse) else -worse, row.name


@dataclass(frozen=True, eq=False)
class PopulationTable(ResultTable):
    """The subjects of a population, in their order."""

    columns = (*("name", "verdict", "residual", "folded", "log2_area", "correlation", "reason"),)
    noun = "subject"
    has_comparisons = True

    population: abfm.Population

    def has_values(self, row: ResultRow) -> bool:
        return bool(np.isfinite(self.population.values[row.number]).any())

    def badness(self, row: ResultRow) -> tuple[int, float, str]:
        """Return a key by which rows are sorted; good ones are compared by correlation."""
        rank = Outcome.NEARLY.rank if row.verdict.is_good else row.verdict.rank
        correlation = row.facts.number("correlation")
        return -rank, -2.0 if math.isnan(correlation) else correlation, row.name
