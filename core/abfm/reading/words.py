"""Numbers in texts."""

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
    """Return the number that a word is, also with the exponent of Fortran, as in ``1.0D+00``.

    A ValueError reports any other word; `whole_number` does alike.
    """
    try:
        return float(word)
    except ValueError:
        text = _text(word)
    try:
        return float(text.translate(_FORTRAN))
    except ValueError:
        raise _no_number(text, "a number") from None


def whole_number(word: str | bytes) -> int:
    """Return the whole number that a word is."""
    try:
        return int(word)
    except ValueError:
        expected = "a number of fewer digits" if word.isdigit() else "a whole number"
        raise _no_number(_text(word), expected) from None


def _text(word: str | bytes) -> str:
    return word if isinstance(word, str) else word.decode("utf-8", "replace")


def _no_number(word: str, expected: str) -> ValueError:
    if _COMMA.fullmatch(word[:40]):
        return ValueError(
            f"it has {brief(word)}, a number with a decimal comma: write decimal points"
        )
    return ValueError(f"it has {brief(word)} where {expected} is expected")


class Words:
    """Takes numbers from a text, one after the other, however its lines end."""

    def __init__(self, text: str, begin: int = 0) -> None:
        self.place = begin
        """The end of the last word that was taken."""
        self._words = _WORD.finditer(text, begin)

    def numbers(self, count: int, of: str) -> FloatArray:
        """Return the next numbers, (count,), of what is named; a ValueError reports fewer."""
        return np.frombuffer(self._taken(array("d"), number, count, of), np.float64)

    def whole_numbers(self, count: int | None, of: str) -> IntArray:
        """Return the next numbers, (count,), as `numbers` does; all that follow if it is None."""
        return np.frombuffer(self._taken(array("q"), whole_number, count, of), np.int64)

    def _taken(
        self, found: Numbers, read: Callable[[str], Any], count: int | None, of: str
    ) -> Numbers:
        for word in islice(self._words, count):
            try:
                found.append(read(word[0]))
            except OverflowError:
                raise ValueError(f"it has {brief(word[0])}, which is beyond all numbers") from None
            self.place = word.end()
        if count is None or len(found) == count:
            return found
        if not found:
            raise ValueError(f"the file is cut off: {of} is missing")
        raise ValueError(f"the file is cut off: {of} has {len(found)} of {count} numbers")

    def count(self, of: str) -> int:
        """Return the next number, of what is announced."""
        found = self.whole_numbers(1, f"the number of {of}")
        count = int(found[0])
        if count < 0:
            raise ValueError(f"it announces {count} {of}")
        return count


def split_lists(flat: IntArray, count: int | None = None) -> tuple[IntArray, IntArray]:
    """Split numbers, (n,), into lists that each have their length before them.

    Parameters
    ----------
    count : int, optional
        Number of lists; by default as many as there are.

    Returns
    -------
    sizes : (count,) array
        The lengths.
    entries : (n - count,) array
        What is in the lists, one after the other.

    Raises
    ------
    ValueError
        If there are more or fewer numbers than the lists have.
    """
    width = int(flat[0]) + 1 if len(flat) else 0
    if width > 0 and len(flat) % width == 0 and count in (None, len(flat) // width):
        rows = flat.reshape(-1, width)
        if (rows[:, 0] == rows[0, 0]).all():  # lists of one length, much faster
            return rows[:, 0], rows[:, 1:].ravel()
    starts, place = array("q"), 0
    while place < len(flat) if count is None else len(starts) < count:
        if not 0 <= place < len(flat) or not 0 <= (size := int(flat[place])) < len(flat) - place:
            break
        starts.append(place)
        place += 1 + size
    if place != len(flat) or (count is not None and len(starts) < count):
        raise ValueError(f"its {count} lists of corners do not fit into {len(flat)} numbers")
    headers = np.frombuffer(starts, np.int64)
    return flat[headers], np.delete(flat, headers)
