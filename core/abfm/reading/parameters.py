"""Parameters as text, on the command line and in tables."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from abfm.errors import ParameterError, brief
from abfm.parameters import CHOICES, FIELDS, checked, is_whole
from abfm.reading.text_tables import parse_number


def parameter_reader(name: str, is_optional: bool) -> Callable[[str], Any]:
    """Return what turns a text into the value of a parameter, or raises a ParameterError.

    If it is optional, "auto" is None.
    """
    entry = FIELDS[name]
    noun = f"a {'whole ' * is_whole(entry)}number{', nor auto' * is_optional}"

    @lru_cache(maxsize=1000)  # of a column's cells, most are alike
    def read(text: str) -> Any:
        value: Any = text
        if is_optional and text == "auto":
            return None
        if name not in CHOICES:
            try:
                value = int(text) if is_whole(entry) else parse_number(text)
            except ValueError:
                raise ParameterError(f"{brief(text)} is not {noun}{hint(text)}") from None
        return checked(entry, value)

    return read


def hint(text: str) -> str:
    """Return how to write a number, for a text with a comma."""
    return ": write a decimal point, and no signs between thousands" if "," in text else ""
