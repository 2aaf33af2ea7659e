"""What scripts wait for, matched by a batch: that of all figures at once, and kept in a folder."""

import os
from collections.abc import Sequence
from dataclasses import replace

from abfm import AbfmError, Match
from abfm.batch import LedgerEntry, Row, problem_row
from abfm.experiments.vocabulary import Sought


def rows_of(figure: int, sought: Sequence[Sought], folder: str | os.PathLike[str]) -> list[Row]:
    """Return a row for each match that a figure's script waits for, written into a folder."""
    return [problem_row(each.problem, folder, f"figure {figure}, {each.text}") for each in sought]


def matches_of(sought: Sequence[Sought], entries: Sequence[LedgerEntry]) -> list[Match]:
    """Read what has come of these rows, in the order of what was sought: the same numbers, bit for
    bit, as if it had just been found, but for fields of a path that are not the match's own.

    Raises
    ------
    AbfmError
        If there is no result, with the reason.
    """
    found = []
    for each, entry in zip(sought, entries, strict=True):
        if entry.path is None:
            raise AbfmError(entry.reason or "it has not been matched")
        # what was computed on the script's own mesh is not computed again on the file's
        found.append(replace(entry.load(), problem=each.problem))
    return found
