"""Comma-separated tables that spreadsheets open safely."""

import csv
import re
from collections.abc import Iterable
from typing import TextIO

from abfm.errors import printable

_BREAKS = re.compile(r"[\t\n\v\f\r]+")
_FORMULA_STARTS = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")  # also full-width


def write_csv(file: TextIO, rows: Iterable[Iterable[object]]) -> None:
    """Write rows of cells; None is an empty cell.

    Spreadsheets compute texts that start like a formula, and names may come from somebody else:
    such a text gets a leading apostrophe, as OWASP recommends
    (https://owasp.org/www-community/attacks/CSV_Injection). Numbers stay numbers, also as text.
    """
    csv.writer(file, lineterminator="\n").writerows(map(_cell, row) for row in rows)


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return value
    text = printable(_BREAKS.sub(" ", value).strip())
    return f"'{text}" if text.startswith(_FORMULA_STARTS) and not _is_number(text) else text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
