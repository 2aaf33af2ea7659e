"""Reading of the results of a batch or population as a table, even while they are computed."""

from __future__ import annotations

from pathlib import Path

import abfm
from abfm import AbfmError
from abfm.errors import one_line
from abfm.outcome import Facts, Outcome
from abfm_viewer.document.result_table import PopulationTable, ResultRow, ResultTable

POPULATION = "population.npz"
NAMES = (POPULATION, "subjects.csv", "summary.csv", "rows.json")
"""Files that identify a folder of results, written by `abfm batch` and `abfm population`."""
_LEDGER = "ledger"
_NUMBERS = ("residual", "folded", "log2_area", "correlation")  # names of facts about subjects


def place_of(path: Path) -> Path | None:
    """Return the folder, or population file, with the results to which a path belongs, or None."""
    if path.is_dir() or path.name == POPULATION:
        return path
    if path.name == "rows.json" and path.parent.name == _LEDGER:
        return path.parent.parent
    return path.parent if path.name.lower() in NAMES else None


class TableReader:
    def __init__(self, place: Path) -> None:
        self.place = place
        self._stamps: list[int] = []
        self._table: ResultTable | None = None
        self._known: dict[Path, ResultRow] = {}

    def read(self, anew: bool = True) -> ResultTable:
        """Return the table of results, read from its files.

        If ``anew`` is False and no file has changed, the same object as before is returned. A
        missing or damaged table raises a `ResultError`.
        """
        stamps = _stamps(self.place)
        if self._table is None or anew or stamps != self._stamps:
            self._table, self._stamps = self._read(), stamps
        return self._table

    def _read(self) -> ResultTable:
        file = self.place / POPULATION if self.place.is_dir() else self.place
        if file.is_file():
            return _of_population(self.place, file)
        from abfm.batch import Ledger  # imported late: loads the solver

        title, entries = Ledger(self.place).read_rows()
        rows = tuple(self._row(number, entry) for number, entry in enumerate(entries))
        return ResultTable(self.place, title, rows)

    def _row(self, number: int, entry: abfm.batch.LedgerEntry) -> ResultRow:
        name = one_line(entry.row.name, 200)
        # results are named by their digest, so a known file cannot have changed
        known = None if entry.path is None else self._known.get(entry.path)
        if known is not None and known.key == (number, name):
            return known
        facts = entry.facts
        if entry.path is None or not facts.numbers:
            return ResultRow(number, name, facts)
        row = ResultRow(number, name, facts, entry.path, _texts(entry))
        self._known[entry.path] = row
        return row


def _texts(entry: abfm.batch.LedgerEntry) -> tuple[tuple[str, str], ...]:
    """Return source and target of each channel as in the batch's row; empty for sequences."""
    from abfm.tasks.inputs import channels

    try:
        sources, targets, _ = channels(entry.row.written)
    except AbfmError:  # written by another version
        return ()
    return tuple(zip(sources, targets, strict=True))


def _of_population(place: Path, path: Path) -> PopulationTable:
    from abfm import load

    found: abfm.Population = load(path)
    rows, matched = [], [channel for channel in found.channels if not channel.is_held_out]
    for number, name in enumerate(found.names):
        result = path.parent / f"{found.digests[number]}.npz"
        word = found.verdicts[number]
        verdict = Outcome(word) if word in set(Outcome) else Outcome.FAILED
        is_outlier = not found.fits[number] and verdict is not Outcome.FAILED
        outcome = Outcome.OUTLIER if is_outlier else verdict
        numbers = {each: float(getattr(found, each)[number]) for each in _NUMBERS}
        facts = Facts(outcome, str(outcome), found.reasons[number], numbers=numbers)
        existing = result if found.digests[number] and result.is_file() else None
        texts = tuple((channel.name, channel.name) for channel in matched)
        rows.append(ResultRow(number, name, facts, existing, texts))
    name = path.parent.name if path.name == POPULATION else path.name
    return PopulationTable(place, f"population {name}", tuple(rows), found)


def _stamps(place: Path) -> list[int]:
    """Return the modification times (ns) of a table's files, to notice changes of the table."""
    watched = (place, place / POPULATION, place / _LEDGER, place / _LEDGER / "rows.json")
    stamps = []
    for path in watched if place.is_dir() else (place,):
        try:
            stamps.append(path.stat().st_mtime_ns)
        except OSError:
            stamps.append(0)
    return stamps
