"""Batch of the matches of all figures: rows to be solved at once, and their stored results."""

import os
from collections.abc import Sequence
from dataclasses import replace

from abfm import AbfmError, Match
from abfm.batch import LedgerEntry, Row, problem_row
from abfm.experiments.scripts import RequestedMatch


def rows_of(
    figure: int, requested: Sequence[RequestedMatch], folder: str | os.PathLike[str]
) -> list[Row]:
    """Write the problems that a figure's script has requested to files; return a row for each."""
    return [
        problem_row(each.problem, folder, f"figure {figure}, {each.text}") for each in requested
    ]


def matches_of(requested: Sequence[RequestedMatch], entries: Sequence[LedgerEntry]) -> list[Match]:
    """Load the stored results of a figure's matches, in the order of the requested matches.

    All numbers equal those of newly solved matches in every bit, except the fields of earlier steps
    of the path, which result files round.

    Raises
    ------
    AbfmError
        If a match has no stored result; the message reports the cause.
    """
    found = []
    for each, entry in zip(requested, entries, strict=True):
        if entry.path is None:
            raise AbfmError(entry.reason or "the row has not been solved")
        # the mesh of the script has cached operators, the mesh of the file has none
        found.append(replace(entry.load(), problem=each.problem))
    return found
