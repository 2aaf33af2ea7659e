"""What follows the header of a PLY file, taken element by element, from front to back: words of text, or bytes."""

import re
import struct
from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.mesh.readers.contents import number, whole_number
from abfm.types import IntArray

CODES = {  # of the header's types in Python's struct
    **dict(zip(("char", "uchar", "short", "ushort", "int", "uint", "float", "double"), "bBhHiIfd", strict=True)),
    **dict(zip(("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"), "bBhHiIfd", strict=True)),
    "int64": "q",
    "uint64": "Q",
}
COMMENT = re.compile(rb"^[ \t]*+comment\b[^\r\n]*+", re.MULTILINE)


class Property(NamedTuple):
    """A column of an element: a number, or a list of numbers with its length before it."""

    name: str
    code: str
    length_code: str = ""


class Column(NamedTuple):
    """The numbers of a property, those of lists one list after the other, and how many each list has."""

    values: NDArray[Any]
    counts: IntArray | None


class Body(ABC):
    """Numbers at positions, counted in `size` units each; see `BinaryBody` and `TextBody`."""

    length: int
    position: int

    def take(self, element: str, rows: int, properties: list[Property], wanted: Sequence[str]) -> dict[str, Column]:
        """The wanted ones of the properties of the next element; the last one of a name.

        Raises
        ------
        ValueError
            If the file ends before, or a list has a length below 0.
        """
        shortest = sum(self.size(p.length_code or p.code) for p in properties)
        if rows * shortest > self.length - self.position:
            raise self._cut_off(element)
        if not any(p.length_code for p in properties):
            found = {}
            place = self.position
            for p in properties:
                if p.name in wanted:
                    found[p.name] = Column(self.column(place, rows, shortest, p.code), None)
                place += self.size(p.code)
            self.position += rows * shortest
            return found
        return self._walk(element, rows, properties, wanted)

    @abstractmethod
    def size(self, code: str) -> int:
        """Units that a number takes."""

    @abstractmethod
    def column(self, start: int, rows: int, step: int, code: str) -> NDArray[Any]:
        """Numbers that are as far from each other as the rows of a table."""

    @abstractmethod
    def reader(self, code: str) -> Callable[[int], int]:
        """What gives the whole number at a position."""

    @abstractmethod
    def runs(self, starts: IntArray, counts: IntArray, code: str) -> NDArray[Any]:
        """So many numbers from each start."""

    def _walk(self, element: str, rows: int, properties: list[Property], wanted: Sequence[str]) -> dict[str, Column]:
        """The same where lengths of lists must be read to know where the next row begins."""
        places = {p.name: (array("q"), array("q")) for p in properties if p.name in wanted}
        steps = [
            (self.reader(p.length_code) if p.length_code else None, self.size(p.length_code or "B"), self.size(p.code),
             places.get(p.name))
            for p in properties
        ]  # fmt: skip
        position, end = self.position, self.length
        try:
            for _ in range(rows):
                for read, before, size, kept in steps:
                    count = 1
                    if read:
                        count = read(position)
                        position += before
                    if kept:
                        kept[0].append(position)
                        kept[1].append(count)
                    position += count * size
                    if count < 0 or position > end:
                        raise self._cut_off(element) if count >= 0 else ValueError(f"a list has the length {count}")
        except (IndexError, struct.error) as error:
            raise self._cut_off(element) from error
        self.position = position
        found = {}
        for p in properties:
            if p.name in places:
                starts, counts = (np.frombuffer(numbers, dtype=np.int64) for numbers in places[p.name])
                found[p.name] = Column(self.runs(starts, counts, p.code), counts if p.length_code else None)
        return found

    @staticmethod
    def _cut_off(element: str) -> ValueError:
        return ValueError(f"the file is cut off: it has fewer rows of {element[:40]} than its header announces")


class BinaryBody(Body):
    """Bytes of a file from a position on, with an order of bytes, ``<`` or ``>``."""

    def __init__(self, data: bytes, start: int, order: str) -> None:
        self.data, self.position, self.length, self.order = data, start, len(data), order

    def size(self, code: str) -> int:
        return struct.calcsize(f"={code}")

    def column(self, start: int, rows: int, step: int, code: str) -> NDArray[Any]:
        if not rows:
            return np.zeros(0)
        return np.ndarray((rows,), self.order + code, self.data, start, (step,))

    def reader(self, code: str) -> Callable[[int], int]:
        if code == "B":
            return self.data.__getitem__
        number = struct.Struct(self.order + code)
        return lambda position: int(number.unpack_from(self.data, position)[0])

    def runs(self, starts: IntArray, counts: IntArray, code: str) -> NDArray[Any]:
        kind = np.dtype(self.order + code)
        before = np.cumsum(counts) - counts
        places = np.repeat(starts - before * kind.itemsize, counts)
        places += np.arange(len(places)) * kind.itemsize
        content, found = np.frombuffer(self.data, np.uint8), np.empty((len(places), kind.itemsize), np.uint8)
        for k in range(kind.itemsize):
            found[:, k] = content[places]
            places += 1
        return found.view(kind).reshape(-1)


class TextBody(Body):
    """Words; lines that begin with ``comment`` are none."""

    def __init__(self, text: bytes) -> None:
        self.words = (COMMENT.sub(b"", text) if b"comment" in text else text).split()
        self.position, self.length = 0, len(self.words)

    def size(self, code: str) -> int:
        return 1

    def column(self, start: int, rows: int, step: int, code: str) -> NDArray[Any]:
        return np.frombuffer(array("d", map(number, self.words[start : start + rows * step : step])))

    def reader(self, code: str) -> Callable[[int], int]:
        return lambda position: whole_number(self.words[position])

    def runs(self, starts: IntArray, counts: IntArray, code: str) -> NDArray[Any]:
        pairs = zip(starts.tolist(), counts.tolist(), strict=True)
        words = chain.from_iterable(self.words[start : start + count] for start, count in pairs)
        if code in "fd":
            return np.frombuffer(array("d", map(number, words)))
        try:
            return np.frombuffer(array("q", map(whole_number, words)), dtype=np.int64)
        except OverflowError:
            raise ValueError("a number in a list is beyond 64 bits") from None
