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
    """Write a file of rows of cells, whole or not at all; None is an empty cell.

    Spreadsheets compute texts that start like a formula, and names may come from somebody else:
    such a text gets a leading apostrophe, as OWASP recommends
    (https://owasp.org/www-community/attacks/CSV_Injection). Numbers stay numbers, also as text. A
    ResultError reports that the file cannot be written.
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
