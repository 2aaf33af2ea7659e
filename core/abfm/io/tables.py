"""Comma-separated tables that spreadsheets open safely."""

import csv
import os
import re
from collections.abc import Iterable

from abfm.errors import printable
from abfm.io.atomic import write_atomically
from abfm.reading.text_tables import is_number

_BREAKS = re.compile(r"[\t\n\v\f\r]+")
_FORMULA_STARTS = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")  # also full-width


def write_csv(path: str | os.PathLike[str], rows: Iterable[Iterable[object]]) -> None:
    """Write rows of cells atomically; None is an empty cell.

    Spreadsheets evaluate texts that begin like a formula, and names may be malicious. Such a text
    gets a leading apostrophe, as recommended by OWASP
    (https://owasp.org/www-community/attacks/CSV_Injection). Numbers in texts are not changed. Raise
    a ResultError if the file cannot be written.
    """
    with (
        write_atomically(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        csv.writer(file, lineterminator="\n").writerows(map(_cell, row) for row in rows)


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return value
    text = printable(_BREAKS.sub(" ", value).strip())
    return f"'{text}" if text.startswith(_FORMULA_STARTS) and not is_number(text) else text
