"""What follows the header of a PLY file, taken element by element, from front to back."""

import re
import struct
from array import array
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.mesh.readers.contents import number
from abfm.types import IntArray

_NAMES = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double")
_BITS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
CODES = dict(zip(_NAMES + _BITS, 2 * "bBhHiIfd", strict=True)) | {"int64": "q", "uint64": "Q"}
"""Of the header's types in Python's struct."""
_COMMENT = re.compile(rb"^[ \t]*+comment\b[^\r\n]*+", re.MULTILINE)
_LARGEST = 2.0**53  # above, doubles do not tell one whole number from the next


class Property(NamedTuple):
    """A column of an element: a number, or a list of numbers with its length before it."""

    name: str
    code: str
    length_code: str = ""


class Column(NamedTuple):
    """The numbers of a property, those of lists one list after the other, and how many each list
    has.
    """

    values: NDArray[Any]
    counts: IntArray | None


class Body:
    """The bytes of a file from a position on, with an order of bytes, ``<`` or ``>``; or, without
    one, the words of a text, all of them as doubles.
    """

    def __init__(self, data: bytes, start: int, order: str) -> None:
        if not order:
            text, start = data[start:], 0
            words = (_COMMENT.sub(b"", text) if b"comment" in text else text).split()
            data = array("d", map(number, words)).tobytes()
        self._data, self._position, self._end, self._order = data, start, len(data), order

    def take(
        self, element: str, rows: int, properties: list[Property], wanted: Sequence[str]
    ) -> dict[str, Column]:
        """Return the wanted ones of the properties of the next element; the last one of a name.

        Raises
        ------
        ValueError
            If the file ends before, or a list has a length below 0.
        """
        step = sum(self._kind(p.length_code or p.code).itemsize for p in properties)
        if rows * step > self._end - self._position:
            raise _cut_off(element)
        if any(p.length_code for p in properties):
            return self._walk(element, rows, properties, wanted)
        found, place = {}, self._position
        for p in properties:
            kind = self._kind(p.code)
            if p.name in wanted:
                values = np.ndarray((rows,), kind, self._data, place if rows else 0, (step,))
                found[p.name] = Column(values, None)
            place += kind.itemsize
        self._position += rows * step
        return found

    def _kind(self, code: str) -> np.dtype[Any]:
        return np.dtype(self._order + code if self._order else "=d")

    def _walk(
        self, element: str, rows: int, properties: list[Property], wanted: Sequence[str]
    ) -> dict[str, Column]:
        """Return the same where lengths of lists must be read to know where the next row begins."""
        places = {p.name: (array("q"), array("q")) for p in properties if p.name in wanted}
        steps = [
            (
                self._lengths(p.length_code) if p.length_code else None,
                self._kind(p.length_code or "B").itemsize,
                self._kind(p.code).itemsize,
                places.get(p.name),
            )
            for p in properties
        ]
        position, end = self._position, self._end
        try:
            for _ in range(rows):
                for length, before, size, kept in steps:
                    count = 1
                    if length:
                        count = length(position)
                        position += before
                    if kept:
                        kept[0].append(position)
                        kept[1].append(count)
                    position += count * size
                    if count < 0:
                        raise ValueError(f"a list has the length {count}")
                    if position > end:
                        raise _cut_off(element)
        except (IndexError, struct.error) as error:
            raise _cut_off(element) from error
        self._position = position
        found = {}
        for p in properties:
            if p.name in places:
                starts, counts = (np.frombuffer(kept, np.int64) for kept in places[p.name])
                values = self._runs(starts, counts, p.code)
                found[p.name] = Column(values, counts if p.length_code else None)
        return found

    def _lengths(self, code: str) -> Callable[[int], int]:
        """Return what reads the length of a list at a position."""
        if self._order and code == "B":
            return self._data.__getitem__
        one = struct.Struct(self._order + code if self._order else "=d")
        return lambda position: _whole(one.unpack_from(self._data, position)[0])

    def _runs(self, starts: IntArray, counts: IntArray, code: str) -> NDArray[Any]:
        """Return so many numbers from each start."""
        kind = self._kind(code)
        before = np.cumsum(counts) - counts
        places = np.repeat(starts - before * kind.itemsize, counts)
        places += np.arange(len(places)) * kind.itemsize
        content = np.frombuffer(self._data, np.uint8)
        found = np.empty((len(places), kind.itemsize), np.uint8)
        for k in range(kind.itemsize):
            found[:, k] = content[places]
            places += 1
        values = found.view(kind).reshape(-1)
        if self._order or code in "fd":
            return values
        wrong = ~((np.abs(values) <= _LARGEST) & (values == np.floor(values)))
        if wrong.any():
            raise _not_whole(values[wrong][0])
        return values.astype(np.int64)


def _whole(value: float) -> int:
    if not float(value).is_integer():
        raise _not_whole(value)
    return int(value)


def _not_whole(value: float) -> ValueError:
    return ValueError(f"it has {value:g} where a whole number is expected, of at most 16 digits")


def _cut_off(element: str) -> ValueError:
    return ValueError(
        f"the file is cut off: it has fewer rows of {element[:40]} than its header announces"
    )
