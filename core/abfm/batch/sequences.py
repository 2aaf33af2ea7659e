"""Rows that are films: a sequence of frames on one surface."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abfm.batch.columns import parameters_in
from abfm.batch.kind import Cost, Facts, Prepared, mesh_of_row, weight
from abfm.errors import ParameterError, brief
from abfm.io import results
from abfm.outcome import Outcome
from abfm.sequences import GAMMA, Unfinished, defaults, read_frames, sequence
from abfm.workers.control import Control

if TYPE_CHECKING:
    from abfm.batch.rows import Row, Saved


def prepare_sequence(row: Row) -> Prepared:
    """Name it by what the row and its files say."""
    given = row.values()

    def solve(control: Control | None, cost: Cost, path: Path | None) -> Saved:
        mesh = mesh_of_row(given["mesh"], given)
        film = read_frames(given["frames"], mesh, given.get("array"))
        step, times = given.get("dt"), film.times
        if step is not None:
            times = step * np.arange(float(len(film.values)))
        return sequence(
            mesh,
            film.values,
            times,
            defaults(**parameters_in(given)),
            given.get("gamma", GAMMA),
            mask=weight(mesh, given.get("mask")),
            weights=given.get("weights"),
            unfinished=Unfinished(path),
            control=control,
        )

    return Prepared(row.key, solve)


def check_sequence(given: Mapping[str, Any]) -> None:
    """Refuse parameters that sequences do not take, or that do not fit each other."""
    defaults(**parameters_in(given))


def facts_of_sequence(path: Path) -> Facts:
    """Return what a file says: the commonest verdict of its intervals, and their medians."""
    with results.open_archive(path, results.SEQUENCE.name, results.MEND) as archive:
        kinds = [kind for kind, *_ in archive["verdicts"].tolist()]
        numbers = [archive[name] for name in ("residual", "verified_residual", "folded")]
    confirmed = sum(Outcome(kind).is_good for kind in kinds)
    # as `abfm sequence` has it: by whether most are confirmed
    is_good = 2 * confirmed >= len(kinds)
    usual = Counter(k for k in kinds if Outcome(k).is_good == is_good).most_common(1)[0][0]
    reason = f"flow lines confirm {confirmed} of {len(kinds)} intervals"
    return Facts(usual, reason, *(float(np.nanmedian(each)) for each in numbers))


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
