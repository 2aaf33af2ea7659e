"""Tables of the results of a batch or a population, which can be sorted and searched."""

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
"""Names of columns; columns of numbers have the names of these numbers in `Facts`."""


class Column(NamedTuple):
    """Heading of a column, its tooltip, and the format of its numbers."""

    head: str
    tip: str
    digits: str = ""  # format of numbers; empty for texts


COLUMNS: Mapping[Name, Column] = {
    "name": Column("name", "Name of the row in its table."),
    "verdict": Column("verdict", "Verdict of the result. The worst are listed first."),
    "residual": Column("residual", "Residual of the discrete flow.", ".2%"),
    "verified_residual": Column("along flow lines", "Residual along flow lines.", ".2%"),
    "folded": Column("folded", "Share of the faces that the map folds.", ".2%"),
    "log2_area": Column("|log2 J|", "Area change of the map, mean over the surface.", ".2f"),
    "correlation": Column(
        "correlation", "Correlation with the mean of the other subjects, without outliers.", ".3f"
    ),
    "reason": Column("reason", "Reason for the verdict or for a failure."),
}


@dataclass(frozen=True)
class ResultRow:
    """A row of a table of results, for example a subject, with the facts of its result."""

    number: int  # of the row in its table
    name: str
    facts: Facts
    path: Path | None = None  # file of the result
    texts: tuple[tuple[str, str], ...] = ()  # source and target of each channel, as in the table

    @property
    def key(self) -> tuple[int, str]:
        """Number and name of the row, by which it is found when the table is read again."""
        return self.number, self.name

    @property
    def verdict(self) -> Outcome:
        return self.facts.outcome

    @property
    def picture(self) -> Path | None:
        """The small picture that a batch has drawn of the result, if there is one."""
        path = self.path and self.path.parent / "pictures" / f"{self.path.stem}.png"
        return path if path and path.is_file() else None

    def label_document(self, document: Document) -> Document:
        """Return a document with the row's name, and with the names of functions in the table."""
        specs = [spec for channel in document.channels for spec in channel.specs]
        texts = [text for pair in self.texts for text in pair]
        names = dict(zip(specs, texts, strict=True)) if len(specs) == len(texts) else {}
        return document.renamed(self.name, names)

    def cell_text(self, column: Name) -> str:
        texts = {"name": self.name, "verdict": str(self.verdict), "reason": self.facts.reason}
        if column in texts:
            return texts[column]
        value = self.facts.number(column)
        return "" if math.isnan(value) else format(value, COLUMNS[column].digits)

    def has(self, words: Sequence[str]) -> bool:
        """Return whether name, verdict and reason contain all words, which are in lower case."""
        text = f"{self.name} {self.verdict} {self.facts.reason}".lower()
        return all(word in text for word in words)


def as_text(columns: Sequence[Name], rows: Sequence[ResultRow]) -> str:
    """Return the headings and the cells of rows, separated by tabs, as spreadsheets read them."""
    heads = [COLUMNS[column].head for column in columns]
    cells = [[" ".join(row.cell_text(column).split()) for column in columns] for row in rows]
    return "\n".join(map("\t".join, (heads, *cells)))


@dataclass(frozen=True, eq=False)
class ResultTable:
    columns: ClassVar[tuple[Name, ...]] = (
        *("name", "verdict", "residual", "verified_residual", "folded", "log2_area", "reason"),
    )
    noun: ClassVar[str] = "row"
    has_comparisons: ClassVar[bool] = False  # whether a row can be compared with the others

    place: Path  # the folder or the population file that was opened
    title: str
    rows: tuple[ResultRow, ...]

    def has_values(self, row: ResultRow) -> bool:
        return False

    def can_show(self, row: ResultRow) -> bool:
        """Return whether a row can be shown: by its result, or by values on the template."""
        return row.path is not None or self.has_values(row)

    @property
    def summary(self) -> str:
        """Number of rows by verdict: ``9 rows: 7 matched, 2 failed``."""
        count = Counter(row.verdict for row in self.rows)
        parts = [f"{count[each]} {each}" for each in Outcome if count[each]]
        return f"{counted(len(self.rows), self.noun)}: {', '.join(parts) or 'none'}"

    def find(self, key: tuple[int, str] | None) -> ResultRow | None:
        return next((row for row in self.rows if row.key == key), None)

    def shown(self, column: Name, falls: bool, search: str) -> tuple[ResultRow, ...]:
        """Return the rows that match a search, sorted by a column; descending if ``falls``.

        A row matches if it contains the search text. If no row does, rows match that contain all
        its words. Verdicts are sorted from the worst to the best, and rows of equal verdict by
        `badness`. Unknown numbers are last.
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
        """Return a key that sorts rows from the worst to the best: by verdict, then by residual."""
        worse = row.facts.worse_residual
        return -row.verdict.rank, 0.0 if math.isnan(worse) else -worse, row.name


@dataclass(frozen=True, eq=False)
class PopulationTable(ResultTable):
    columns = (*("name", "verdict", "residual", "folded", "log2_area", "correlation", "reason"),)
    noun = "subject"
    has_comparisons = True

    population: abfm.Population

    def has_values(self, row: ResultRow) -> bool:
        return bool(np.isfinite(self.population.values[row.number]).any())

    def badness(self, row: ResultRow) -> tuple[int, float, str]:
        """Return a key that sorts rows from the worst to the best: by verdict, then by correlation.

        The verdicts matched and nearly matched count as equal.
        """
        rank = Outcome.NEARLY.rank if row.verdict.is_good else row.verdict.rank
        correlation = row.facts.number("correlation")
        return -rank, -2.0 if math.isnan(correlation) else correlation, row.name
