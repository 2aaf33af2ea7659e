"""Ledger of a batch: files in a folder with the state of each row of the table.

Each file is written completely or not at all, so an interrupted batch can always be resumed.
"""

from __future__ import annotations

import json
import os
import re
import secrets
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal
from zipfile import is_zipfile

from abfm.batch.rows import Row
from abfm.errors import ResultError, brief, one_line
from abfm.io import remove_abandoned, write_file, writing_in
from abfm.numerics.real_numbers import is_finite_number
from abfm.outcome import Facts, Outcome
from abfm.reading import from_json, read_bytes

RowState = Literal["done", "failed", "missing"]
"""State of a row: "done" if it has a result, "failed" if its last attempt failed, or "missing"."""
_LEDGER_BYTES_MAX = 256 << 20  # size of a ledger file
_REASON_LENGTH_MAX = 400
_NAME = re.compile("[0-9a-f]{1,128}")  # keys and digests, which become file names


@dataclass(frozen=True)
class Record:
    """State of a row after an attempt to solve it; stored under the row's key."""

    digest: str = ""  # name of the result; empty if the inputs could not be read
    reason: str = ""  # cause of a failure; empty without a failure
    tries: int = 1  # number of attempts in the run that wrote the record
    seconds: float | None = None  # solution time; None if the result existed or solving failed
    # cost of a match, see `Cost`, and products with rows, see `RowProducts`
    evaluations: int | None = None
    seconds_to_goal: float | None = None
    row_products: int | None = None
    expected: str = ""  # why no flow can match the functions of a row being solved
    warning: str = ""  # warnings of the library while the row was prepared and solved

    def __post_init__(self) -> None:
        """Raise ValueError for values that no run writes, because ledgers may be damaged."""
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(each.default, str):
                fits = isinstance(value, str)
            elif value is None:
                fits = each.default is None
            else:
                fits = is_finite_number(value) and value >= 0
            if not fits:
                raise ValueError(f"{each.name} is {brief(value)}")
        if self.digest and not _NAME.fullmatch(self.digest):
            raise ValueError(f"digest is {brief(self.digest)}; expected hexadecimal digits")


@dataclass(frozen=True)
class LedgerEntry:
    """The state and the record of a row, as the ledger reports them."""

    row: Row
    state: RowState
    record: Record = field(default_factory=Record)
    path: Path | None = None  # the result file; None unless the state is "done"

    @property
    def digest(self) -> str:
        """Hash of the problem, which names its result file; empty if the hash is unknown."""
        return self.record.digest

    @property
    def reason(self) -> str:
        """Cause of a failure in one line; empty without a failure."""
        return self.record.reason

    @property
    def facts(self) -> Facts:
        """Facts of the result (outcome, numbers and warnings), read from its file.

        Without a result the facts have no numbers. If the file is damaged, they report a failure.
        """
        if self.path is None:
            outcome = Outcome.FAILED if self.state == "failed" else Outcome.MISSING
            return Facts(outcome, str(outcome), self.reason or self.record.expected)
        try:
            return self.row.task_type.file.facts(self.path)
        except ResultError as error:
            return Facts(Outcome.FAILED, str(Outcome.FAILED), str(error))

    def load(self) -> Any:
        """Load the result, such as a Match or a Registration; raise an AbfmError without one."""
        if self.path is None:
            reason = self.reason or "it has not been solved"
            raise ResultError(f"there is no result of {one_line(self.row.name)}: {reason}")
        return self.row.task_type.file.load(self.path)


class Ledger:
    """The folder of a batch: results as ``<digest>.npz``, and records of rows in ``ledger/``.

    Parameters
    ----------
    folder : path
        Folder of the batch; the first write creates it.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(os.path.abspath(os.path.expanduser(folder)))
        self.records_folder = self.folder / "ledger"

    def make(self) -> str:
        """Create the folder if necessary; return the unique text in its file ``identity``."""
        path = self.records_folder / "identity"
        with writing_in(self.folder):
            self.records_folder.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                write_file(path, secrets.token_hex(16))
            return path.read_text(encoding="ascii")

    def is_accessible(self, identity: str) -> bool:
        """Return whether the folder has this identity, see `make`, and is writable."""
        try:
            path = self.records_folder / "identity"
            is_same = path.read_text(encoding="ascii", errors="replace") == identity
        except OSError:
            return False
        return is_same and all(
            os.access(each, os.W_OK) for each in (self.folder, self.records_folder)
        )

    def result_path(self, digest: str) -> Path:
        """Return the path of the result file with this digest, whether it exists or not."""
        return self.folder / f"{digest}.npz"

    def has_result(self, digest: str) -> bool:
        """Return whether a complete result exists; a truncated file does not count."""
        return is_zipfile(self.result_path(digest))

    def write_result(self, digest: str, content: bytes) -> None:
        """Write the bytes of a result, unless the result exists."""
        if not self.has_result(digest):
            write_file(self.result_path(digest), content)

    def entry(self, row: Row) -> LedgerEntry:
        """Return the ledger entry of a row: its state, its record, and the path of its result."""
        return self._entry(row, row.key)

    def entries(self, rows: Iterable[Row]) -> list[LedgerEntry]:
        """Return the ledger entries of rows, in their order."""
        return [self.entry(row) for row in rows]

    def forget(self, row: Row) -> None:
        """Remove the record of a row, so that the row counts as never attempted."""
        self._record_path(row.key).unlink(missing_ok=True)

    def record(self, row: Row, record: Record) -> LedgerEntry:
        """Write the record of a row, and return its entry."""
        if record.reason:
            record = replace(record, reason=one_line(record.reason, _REASON_LENGTH_MAX))
        self._write(self._record_path(row.key), asdict(record))
        return self.entry(row)

    def remove_abandoned(self) -> None:
        """Remove incomplete files of processes that have ended."""
        for folder in (self.folder, self.records_folder):
            remove_abandoned(folder)

    def write_rows(self, rows: Sequence[Row], title: str) -> None:
        """Store the list of rows and its title in the folder, for `read_rows`."""
        entries = [{**row.to_dict(), "key": row.key} for row in rows]
        self._write(self.records_folder / "rows.json", {"title": title, "rows": entries})

    def read_rows(self) -> tuple[str, list[LedgerEntry]]:
        """Return the title and the entries of the stored rows; ResultError without stored rows.

        Their input files are not read.
        """
        try:
            content = from_json(read_bytes(self.records_folder / "rows.json", _LEDGER_BYTES_MAX))
            if not isinstance(content, dict) or not isinstance(content.get("rows"), list):
                raise ValueError(f"it contains {brief(content)}")
            found = [
                self._listed_entry(number, each) for number, each in enumerate(content["rows"], 1)
            ]
            return one_line(content.get("title", "")), found
        except (OSError, ValueError) as error:
            reason = one_line(error, 80)
            if not isinstance(error, OSError):
                reason = f"its list of rows is damaged ({reason})"
            raise ResultError(
                f"{one_line(self.folder)} contains no batch: {reason}; expected the folder that a "
                "batch was written to"
            ) from error

    def _listed_entry(self, number: int, entry: Any) -> LedgerEntry:
        """Return the ledger entry of an item of the list of rows; a failure if it is damaged."""
        try:
            row, key = _row_and_key(entry)
        except ValueError as error:
            reason = f"its entry in the list of rows is damaged: {one_line(error, 200)}"
            return LedgerEntry(Row.unreadable(f"row {number}"), "failed", Record(reason=reason))
        return self._entry(row, key)

    def _entry(self, row: Row, key: str) -> LedgerEntry:
        try:
            record = self._read(key)
        except FileNotFoundError:
            return LedgerEntry(row, "missing")
        except (OSError, ValueError) as error:
            reason = f"its file in the folder ledger is damaged ({one_line(error, 80)})"
            return LedgerEntry(row, "missing", Record(reason=reason))
        if record.reason:
            return LedgerEntry(row, "failed", record)
        if self.has_result(record.digest):
            return LedgerEntry(row, "done", record, self.result_path(record.digest))
        return LedgerEntry(row, "missing", record)

    def _record_path(self, key: str) -> Path:
        return self.records_folder / f"{key}.json"

    def _read(self, key: str) -> Record:
        """Return the record of a row; raise OSError or ValueError if it cannot be read."""
        entry = from_json(read_bytes(self._record_path(key), _LEDGER_BYTES_MAX))
        known = {each.name for each in fields(Record)}
        if not isinstance(entry, dict) or not entry or entry.keys() - known:
            raise ValueError(f"it contains {brief(entry)}")
        record = Record(**entry)
        texts = record.reason, record.expected, record.warning
        reason, expected, warning = (one_line(text, _REASON_LENGTH_MAX) for text in texts)
        return replace(record, reason=reason, expected=expected, warning=warning)

    def _write(self, path: Path, content: object) -> None:
        write_file(path, json.dumps(content))


def _row_and_key(entry: Any) -> tuple[Row, str]:
    """Return the row and the key in an item of the stored list; ValueError if it is damaged."""
    try:
        name, folder, key = (entry[each] for each in ("name", "folder", "key"))
        options = [(column, text) for column, text in entry["options"]]
        texts = [name, folder, key, *(text for pair in options for text in pair)]
        if not all(isinstance(text, str) for text in texts):
            raise TypeError
    except (TypeError, KeyError, ValueError):
        raise ValueError(f"it is {brief(entry)}; expected name, options, folder and key") from None
    if not _NAME.fullmatch(key):
        raise ValueError(f"its key is {brief(key)}; expected hexadecimal digits")
    return Row(name, options, folder), key
