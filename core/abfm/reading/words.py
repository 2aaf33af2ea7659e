"""Parsing of numbers in texts."""

import re
from array import array
from collections.abc import Callable
from itertools import islice
from typing import Any, TypeAlias

import numpy as np

from abfm.errors import brief
from abfm.types import FloatArray, IntArray

_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+(?:[eEdD][-+]?[0-9]+)?")
_WORD = re.compile(r"\S+")
_FORTRAN = str.maketrans("dD", "ee")
Numbers: TypeAlias = "array[Any]"


def number(word: str | bytes) -> float:
    """Convert a word to a number; ValueError if it is not a number.

    Exponents of Fortran are also read, such as in ``1.0D+00``.
    """
    try:
        return float(word)
    except ValueError:
        text = _text(word)
    try:
        return float(text.translate(_FORTRAN))
    except ValueError:
        raise _not_a_number(text, "a number") from None


def integer(word: str | bytes) -> int:
    try:
        return int(word)
    except ValueError:
        expected = "a number with fewer digits" if word.isdigit() else "an integer"
        raise _not_a_number(_text(word), expected) from None


def _text(word: str | bytes) -> str:
    return word if isinstance(word, str) else word.decode("utf-8", "replace")


def _not_a_number(word: str, expected: str) -> ValueError:
    if _COMMA.fullmatch(word[:40]):
        return ValueError(
            f"the file has {brief(word)}, a number with a decimal comma. Write decimal points"
        )
    return ValueError(f"the file has {brief(word)}; expected {expected}")


class Words:
    """Sequential reader of the numbers in a text, regardless of line breaks."""

    def __init__(self, text: str, begin: int = 0) -> None:
        self.place = begin
        """The end of the last word that was read."""
        self._words = _WORD.finditer(text, begin)

    def numbers(self, count: int, of: str) -> FloatArray:
        """Return the next numbers, shape (count,); ValueError about ``of`` if fewer follow."""
        return np.frombuffer(self._read(array("d"), number, count, of), np.float64)

    def integers(self, count: int | None, of: str) -> IntArray:
        """Return the next integers, shape (count,), or all remaining ones if ``count`` is None."""
        return np.frombuffer(self._read(array("q"), integer, count, of), np.int64)

    def _read(
        self, found: Numbers, read: Callable[[str], Any], count: int | None, of: str
    ) -> Numbers:
        for word in islice(self._words, count):
            try:
                found.append(read(word[0]))
            except OverflowError:
                raise ValueError(
                    f"the file has {brief(word[0])}, a number that does not fit in 64 bits"
                ) from None
            self.place = word.end()
        if count is None or len(found) == count:
            return found
        if not found:
            raise ValueError(f"the file is cut off: {of} is missing")
        raise ValueError(f"the file is cut off: {of} has {len(found)} of {count} numbers")

    def count(self, of: str) -> int:
        """Return the next number, which is the number of ``of`` (such as "faces") that follow."""
        found = self.integers(1, f"the number of {of}")
        count = int(found[0])
        if count < 0:
            raise ValueError(f"the file announces {count} {of}; expected 0 or more")
        return count


def split_lists(flat: IntArray, count: int | None = None) -> tuple[IntArray, IntArray]:
    """Split numbers (n,) into lists; the length of each list precedes its entries.

    ``count`` is the number of lists, by default as many as there are. Return the lengths of the
    lists, (count,), and their concatenated entries, (n - count,). Raises ValueError if the numbers
    do not form this number of lists.
    """
    width = int(flat[0]) + 1 if len(flat) else 0
    if width > 0 and len(flat) % width == 0 and count in (None, len(flat) // width):
        rows = flat.reshape(-1, width)
        if (rows[:, 0] == rows[0, 0]).all():  # all lists have the same length: much faster
            return rows[:, 0], rows[:, 1:].ravel()
    starts, place = array("q"), 0
    while place < len(flat) if count is None else len(starts) < count:
        if not 0 <= place < len(flat) or not 0 <= (size := int(flat[place])) < len(flat) - place:
            break
        starts.append(place)
        place += 1 + size
    if place != len(flat) or (count is not None and len(starts) < count):
        raise ValueError(
            f"{count} lists of corners do not fit {len(flat)} numbers; the file is damaged"
        )
    headers = np.frombuffer(starts, np.int64)
    return flat[headers], np.delete(flat, headers)
