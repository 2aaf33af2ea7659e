"""What is done, in a folder: whole files alone, so that whatever is killed can go on."""

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
from abfm.io import remove_abandoned, write_whole, writing_in
from abfm.numerics.real_numbers import is_finite_number
from abfm.outcome import Facts, Outcome
from abfm.reading import from_json, read_bytes

RowState = Literal["done", "failed", "missing"]
"""Of a row: there is a result; it was tried in vain; it was not tried, or not to its end."""
_LEDGER_BYTES_MAX = 256 << 20  # bytes of a file of the ledger
_REASON_LENGTH_MAX = 400
_NAME = re.compile("[0-9a-f]{1,128}")  # of keys and digests, which become names of files


@dataclass(frozen=True)
class Record:
    """What is known of a row, by its key, once it was tried."""

    digest: str = ""  # of its result; none where it has not come so far
    reason: str = ""  # why it failed
    tries: int = 1  # in the run that wrote this
    seconds: float | None = None  # that solving took; None if it was there, or did not come so far
    # of matches, as `Cost` has them; and whatever runs beside, as `RowProducts` has them, of rows
    evaluations: int | None = None
    seconds_to_goal: float | None = None
    row_products: int | None = None
    expected: str = ""  # of a row that is being solved: why no flow can match its functions
    warning: str = ""  # of the library, while it was prepared and solved

    def __post_init__(self) -> None:
        """Refuse what no run writes, by a ValueError: ledgers may come from elsewhere."""
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
    """A row and what has come of it."""

    row: Row
    state: RowState
    record: Record = field(default_factory=Record)
    path: Path | None = None  # of the result, where it is done

    @property
    def digest(self) -> str:
        """Name of the result; empty where it is not known."""
        return self.record.digest

    @property
    def reason(self) -> str:
        """Why it failed, in a line; else empty."""
        return self.record.reason

    @property
    def facts(self) -> Facts:
        """The facts of the result, read from its file; without numbers if there is none, and a
        failure if its file is damaged.
        """
        if self.path is None:
            outcome = Outcome.FAILED if self.state == "failed" else Outcome.MISSING
            return Facts(outcome, str(outcome), self.reason or self.record.expected)
        try:
            return self.row.declared.file.facts(self.path)
        except ResultError as error:
            return Facts(Outcome.FAILED, str(Outcome.FAILED), str(error))

    def load(self) -> Any:
        """Read the result, such as a Match or a Registration; an AbfmError says that there is
        none.
        """
        if self.path is None:
            reason = self.reason or "it has not been solved"
            raise ResultError(f"there is no result of {one_line(self.row.name)}: {reason}")
        return self.row.declared.file.load(self.path)


class Ledger:
    """The folder of results: ``<digest>.npz`` each, and what is known of rows in ``ledger/``.

    Parameters
    ----------
    folder : path
        It is made by what writes there first.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(os.path.abspath(os.path.expanduser(folder)))
        self.own = self.folder / "ledger"

    def make(self) -> str:
        """Make the folder, if it is not there, and return what tells it from others."""
        path = self.own / "identity"
        with writing_in(self.folder):
            self.own.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                write_whole(path, secrets.token_hex(16))
            return path.read_text()

    def is_seen(self, identity: str) -> bool:
        """Tell whether this is, here, the same folder, and may be written to."""
        try:
            is_same = (self.own / "identity").read_text() == identity
        except OSError:
            return False
        return is_same and all(os.access(each, os.W_OK) for each in (self.folder, self.own))

    def result(self, digest: str) -> Path:
        """Return where the result with a digest is, or will be."""
        return self.folder / f"{digest}.npz"

    def has(self, digest: str) -> bool:
        """Tell whether there is a result; one that was cut short, as in a copy, is none."""
        return is_zipfile(self.result(digest))

    def write_result(self, digest: str, content: bytes) -> None:
        """Write a result that came as bytes, if it is not there."""
        if not self.has(digest):
            write_whole(self.result(digest), content)

    def entry(self, row: Row) -> LedgerEntry:
        """Return what is known of a row."""
        return self._entry(row, row.key)

    def entries(self, rows: Iterable[Row]) -> list[LedgerEntry]:
        """Return what is known of rows, in their order."""
        return [self.entry(row) for row in rows]

    def forget(self, row: Row) -> None:
        """Take a row as one that was never tried."""
        self._place(row.key).unlink(missing_ok=True)

    def record(self, row: Row, record: Record) -> LedgerEntry:
        """Write what is known of a row, and return it."""
        if record.reason:
            record = replace(record, reason=one_line(record.reason, _REASON_LENGTH_MAX))
        self._write(self._place(row.key), asdict(record))
        return self.entry(row)

    def remove_abandoned(self) -> None:
        """Remove what processes that have ended did not write to its end."""
        for folder in (self.folder, self.own):
            remove_abandoned(folder)

    def write_rows(self, rows: Sequence[Row], title: str) -> None:
        """Keep which rows there are, for those who ask later."""
        entries = [{**row.told(), "key": row.key} for row in rows]
        self._write(self.own / "rows.json", {"title": title, "rows": entries})

    def kept(self) -> tuple[str, list[LedgerEntry]]:
        """Return the title and what is known of the rows that were kept last, without a look at
        their files.

        Raises
        ------
        ResultError
            If there are none.
        """
        try:
            content = from_json(read_bytes(self.own / "rows.json", _LEDGER_BYTES_MAX))
            if not isinstance(content, dict) or not isinstance(content.get("rows"), list):
                raise ValueError(f"it holds {brief(content)}")
            found = [self._kept(number, each) for number, each in enumerate(content["rows"], 1)]
            return one_line(content.get("title", "")), found
        except (OSError, ValueError) as error:
            reason = one_line(error, 80)
            if not isinstance(error, OSError):
                reason = f"its list of rows is damaged ({reason})"
            raise ResultError(
                f"{one_line(self.folder)} holds no batch: {reason}; give the folder that a batch "
                "was written to"
            ) from error

    def _kept(self, number: int, entry: Any) -> LedgerEntry:
        """Return what is known of a row of the list; a failure if it is damaged."""
        try:
            row, key = _row_and_key(entry)
        except ValueError as error:
            reason = f"its line in the list of rows is damaged: {one_line(error, 200)}"
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
        if self.has(record.digest):
            return LedgerEntry(row, "done", record, self.result(record.digest))
        return LedgerEntry(row, "missing", record)

    def _place(self, key: str) -> Path:
        return self.own / f"{key}.json"

    def _read(self, key: str) -> Record:
        """Return the record of a row; an OSError or ValueError reports why it cannot be read."""
        entry = from_json(read_bytes(self._place(key), _LEDGER_BYTES_MAX))
        known = {each.name for each in fields(Record)}
        if not isinstance(entry, dict) or not entry or entry.keys() - known:
            raise ValueError(f"it holds {brief(entry)}")
        record = Record(**entry)
        reason, expected, warning = (
            one_line(text, _REASON_LENGTH_MAX)
            for text in (record.reason, record.expected, record.warning)
        )
        return replace(record, reason=reason, expected=expected, warning=warning)

    def _write(self, path: Path, content: object) -> None:
        write_whole(path, json.dumps(content))


def _row_and_key(entry: Any) -> tuple[Row, str]:
    """Return a row and its key as `Ledger.write_rows` wrote them, or raise a ValueError."""
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
