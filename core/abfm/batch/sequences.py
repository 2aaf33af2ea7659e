"""Rows that are films: a sequence of frames on one surface."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abfm.batch.columns import parameters_in
from abfm.batch.kind import Cost, Prepared, Preview, mesh_of_row, preview_of
from abfm.errors import ParameterError, brief
from abfm.io import results
from abfm.matching.judging.verdict import Verdict
from abfm.outcome import Facts
from abfm.sequences import GAMMA, Unfinished, defaults, read_frames, sequence
from abfm.sequences.verdicts import NUMBERS, facts_of_intervals
from abfm.workers.control import Control

if TYPE_CHECKING:
    from abfm.batch.rows import Row, Saved


def prepare_sequence(row: Row) -> Prepared:
    """Name it by what the row and its files say."""
    given = row.values()

    def solve(control: Control | None, cost: Cost, path: Path | None) -> Saved:
        mesh = mesh_of_row(given["mesh"], given)
        film = read_frames(given["frames"], mesh, given.get("array"))
        step = given.get("dt")
        return sequence(
            mesh,
            film.values,
            film.times if step is None else None,
            defaults(**parameters_in(given)),
            given.get("gamma", GAMMA),
            dt=step,
            mask=given.get("mask"),
            weights=given.get("weights"),
            circular=given.get("circular", False),
            unfinished=Unfinished(path),
            control=control,
        )

    return Prepared(row.key, solve)


def check_sequence(given: Mapping[str, Any]) -> None:
    """Refuse parameters that sequences do not take, or that do not fit each other."""
    defaults(**parameters_in(given))


def facts_of_sequence(path: Path) -> Facts:
    """Return the facts that the file of a sequence holds, as `abfm.Sequence.facts`.

    Raises
    ------
    ResultError
        If the file is missing or damaged, or holds values that no sequence has.
    """
    entries = results.SEQUENCE.entries
    with results.open_archive(path, results.SEQUENCE.name, results.MEND) as archive:
        sizes = dict[str, int]()
        texts, *numbers = (
            entries[name].check(name, archive[name], sizes) for name in ("verdicts", *NUMBERS)
        )
        return facts_of_intervals(list(map(Verdict.of_texts, texts.tolist())), *numbers)


def preview_of_sequence(path: Path) -> Preview:
    """Return the first, the middle and the last frame of a sequence."""
    return preview_of(
        path,
        results.SEQUENCE,
        lambda arrays: [arrays["frames"][i, :, 0] for i in (0, len(arrays["frames"]) // 2, -1)],
    )


def positive(text: str) -> float:
    """Read a number above 0."""
    return _number(text, "above 0", lambda number: number > 0)


def not_negative(text: str) -> float:
    """Read a number from 0 on."""
    return _number(text, "of at least 0", lambda number: number >= 0)


def weights(text: str) -> list[float]:
    """Read weights of channels, not negative, with commas or blanks between."""
    return [not_negative(each) for each in text.replace(",", " ").split()]


def _number(text: str, range: str, holds: Any) -> float:
    try:
        number = float(text)
    except ValueError:
        number = np.nan
    if not (np.isfinite(number) and holds(number)):
        raise ParameterError(f"{brief(text)} is no number {range}")
    return number
