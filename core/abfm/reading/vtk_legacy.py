"""Reader of legacy VTK files (.vtk): text, or big-endian numbers after lines of text.

Format: https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html. Cells may have
the layout of versions before 5, or that of offsets and connectivity.
"""

import math
import re
from array import array
from itertools import islice
from typing import Any, TypeAlias
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.reading.vtk_file import POLYGON, STRIP, PointData, Polygons, VtkFile, polygons_of_cells
from abfm.reading.words import integer, number, split_lists
from abfm.types import FloatArray

_TYPES = {
    "unsigned_char": ">u1",
    "char": ">i1",
    "signed_char": ">i1",
    "unsigned_short": ">u2",
    "short": ">i2",
    "unsigned_int": ">u4",
    "int": ">i4",
    "vtkidtype": ">i4",
    "unsigned_long": ">u8",
    "long": ">i8",
    "float": ">f4",
    "double": ">f8",
    **{f"vtktypeint{8 * size}": f">i{size}" for size in (1, 2, 4, 8)},
    **{f"vtktypeuint{8 * size}": f">u{size}" for size in (1, 2, 4, 8)},
    **{f"vtktypefloat{8 * size}": f">f{size}" for size in (4, 8)},
}
_KINDS = ("POLYDATA", "UNSTRUCTURED_GRID")
_CELLS = ("POLYGONS", "TRIANGLE_STRIPS", "CELLS", "VERTICES", "LINES")
_COLUMNS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}
_COLUMNS |= {"GLOBAL_IDS": 1, "PEDIGREE_IDS": 1, "EDGE_FLAGS": 1}
_TIMES = ("TimeValue", "TIME")  # names of field data with the time
_LINE = re.compile(rb"\s*+([^\n]{1,65536}+)")
_WORD = re.compile(rb"\S+")
_OFFSETS = re.compile(rb"\s*OFFSETS\s", re.IGNORECASE)

Cells: TypeAlias = Polygons  # number of corners of each cell, and the concatenated corners


def legacy_contents(data: bytes) -> VtkFile:
    """Read points, polygons and point data; raise a ValueError for an invalid file."""
    parser = _Parser(data)
    try:
        parser.parse()
    except IndexError:
        raise ValueError("a line has fewer words than its keyword requires") from None
    return VtkFile(parser.points, parser.polygons, PointData(parser.arrays()), parser.time)


class _Parser:
    """Parser that reads a file sequentially, keyword by keyword."""

    def __init__(self, data: bytes) -> None:
        self._data, self._begin, self._is_text = data, 0, True
        self.points, self.time = np.zeros((0, 3)), math.nan
        self._kind, self._cells = "", dict[str, Cells]()
        self._types = np.zeros(0, dtype=np.int64)
        self._values: list[tuple[str, FloatArray]] = []
        self._of_points, self._count = False, 0

    def parse(self) -> None:
        for _ in range(2):  # the version, and a title that may be empty
            self._begin = self._data.find(b"\n", self._begin) + 1 or len(self._data)
        word = self._words()[0]
        if (form := word.upper()) not in ("ASCII", "BINARY"):
            raise ValueError(f"the third line is {brief(word)}; expected ASCII or BINARY")
        self._is_text = form == "ASCII"
        while words := self._words():
            self._take(words[0].upper(), words[1:])
        if not self._kind:
            raise ValueError("the file has no line DATASET; it may be cut off")

    def _take(self, keyword: str, words: list[str]) -> None:
        if keyword == "DATASET":
            self._kind = words[0].upper()
            if self._kind not in _KINDS:
                raise ValueError(
                    f"the dataset is {brief(words[0])}; expected {' or '.join(_KINDS)}"
                )
        elif keyword == "METADATA":  # metadata continue up to an empty line
            end = re.compile(rb"\n[ \t\r]*\n").search(self._data, self._begin - 1)
            self._begin = end.end() if end else len(self._data)
        elif keyword == "POINTS":
            self.points = self._numbers(3 * _count(words[0]), words[1]).reshape(-1, 3)
            self.points = self.points.astype(np.float64)
        elif keyword in _CELLS:
            self._cells[keyword] = self._cells_of(_count(words[0]), _count(words[1]))
        elif keyword == "CELL_TYPES":
            self._types = self._numbers(_count(words[0]), "int").astype(np.int64)
        elif keyword in ("POINT_DATA", "CELL_DATA"):
            self._of_points, self._count = keyword == "POINT_DATA", _count(words[0])
        elif keyword == "FIELD":
            self._take_field(_count(words[1]))
        elif keyword == "LOOKUP_TABLE":
            self._numbers(4 * _count(words[1]), "unsigned_char")
        else:
            self._take_attribute(keyword, words)

    def _take_attribute(self, keyword: str, words: list[str]) -> None:
        if keyword == "SCALARS":
            columns, kind = _count(words[2]) if len(words) > 2 else 1, words[1]
            begin = self._begin
            if self._words()[:1] != ["LOOKUP_TABLE"]:  # the line LOOKUP_TABLE is optional
                self._begin = begin
        elif keyword == "COLOR_SCALARS":
            columns, kind = _count(words[1]), "unsigned_char"
        elif keyword == "TEXTURE_COORDINATES":
            columns, kind = _count(words[1]), words[2]
        elif keyword in _COLUMNS:
            columns, kind = _COLUMNS[keyword], words[1]
        else:
            raise ValueError(f"a line begins with {brief(keyword)}; expected a keyword of VTK")
        self._store(words[0], self._numbers(self._count * columns, kind), columns)

    def _take_field(self, count: int) -> None:
        """Read ``count`` arrays of a field, each after a line of name, columns, rows and type."""
        for _ in range(count):
            words = self._words()
            while words[0].upper() == "METADATA":
                self._take("METADATA", [])
                words = self._words()
            columns, rows = _count(words[1]), _count(words[2])
            if words[3].lower() == "string":
                self._skip_strings(columns * rows)
                continue
            found = self._numbers(columns * rows, words[3])
            if rows == self._count and self._count:
                self._store(words[0], found, columns)
            elif words[0] in _TIMES and len(found) == 1:
                self.time = float(found[0])

    def _skip_strings(self, count: int) -> None:
        """Skip ``count`` texts: one on each line, or, in binary files, bytes after their number.

        Its two highest bits determine how many bytes the number itself has.
        """
        for _ in range(count):
            if self._begin >= len(self._data):
                raise _cut_off(count)
            if self._is_text:
                self._begin = self._data.find(b"\n", self._begin) + 1 or len(self._data)
                continue
            width = 8 >> (self._data[self._begin] >> 6)
            head = int.from_bytes(self._data[self._begin : self._begin + width], "big")
            self._begin += width + (head & ((1 << (8 * width - 2)) - 1))

    def _store(self, name: str, values: NDArray[Any], columns: int) -> None:
        if self._of_points and values.size:
            self._values.append((unquote(name), values.reshape(-1, columns).astype(np.float64)))

    def _cells_of(self, count: int, size: int) -> Cells:
        """Read cells; return the number of corners of each cell, and the concatenated corners.

        In old files, ``size`` numbers follow: for ``count`` cells, the number of corners and then
        the corners. In new files, ``count`` offsets and then ``size`` corners follow.
        """
        if _OFFSETS.match(self._data, self._begin):
            offsets = self._numbers(count, self._words()[1]).astype(np.int64)
            corners = self._numbers(size, self._words()[1]).astype(np.int64)
            sizes = np.diff(offsets)
            if (sizes < 0).any() or (count and (offsets[0] != 0 or offsets[-1] != size)):
                raise ValueError(
                    f"the offsets of cells do not increase from 0 to {size}; the file is damaged"
                )
            return sizes, corners
        return split_lists(self._numbers(size, "int").astype(np.int64), count)

    def polygons(self) -> Polygons:
        empty = np.zeros(0, dtype=np.int64)
        if self._kind == "UNSTRUCTURED_GRID":
            sizes, corners = self._cells.get("CELLS", (empty, empty))
            if len(self._types) != len(sizes):
                raise ValueError(
                    f"the file has types of {len(self._types)} cells for {len(sizes)} cells; "
                    "expected the same numbers"
                )
            return polygons_of_cells(sizes, corners, self._types)
        parts = [self._cells.get(name, (empty, empty)) for name in ("POLYGONS", "TRIANGLE_STRIPS")]
        sizes, corners = (np.concatenate(each) for each in zip(*parts, strict=True))
        types = np.repeat([POLYGON, STRIP], [len(part[0]) for part in parts])
        return polygons_of_cells(sizes, corners, types)

    def arrays(self) -> list[tuple[str, Any]]:
        """Return the names of the point data, each with a function that returns the values."""
        return [(name, lambda values=values: values) for name, values in self._values]

    def _words(self) -> list[str]:
        found = _LINE.match(self._data, self._begin)
        if found is None:
            return []
        self._begin = found.end() + 1
        return [word.decode("utf-8", "replace") for word in found[1].split()]

    def _numbers(self, count: int, kind: str) -> NDArray[Any]:
        if kind.lower() not in _TYPES:
            raise ValueError(f"the file has numbers of type {brief(kind)}, which is not supported")
        dtype = np.dtype(_TYPES[kind.lower()])
        remaining = max(len(self._data) - self._begin, 0)
        if count * (1 if self._is_text else dtype.itemsize) > remaining:
            raise _cut_off(count)
        if not self._is_text:
            begin, self._begin = self._begin, self._begin + count * dtype.itemsize
            return np.frombuffer(self._data, dtype, count, begin if count else 0)
        found = array("d")
        for word in islice(_WORD.finditer(self._data, self._begin), count):
            found.append(number(word[0]))
            self._begin = word.end()
        if len(found) != count:
            raise _cut_off(count)
        return np.frombuffer(found, np.float64)


def _count(word: str) -> int:
    count = integer(word)
    if count < 0:
        raise ValueError(f"the file announces {count} numbers; expected 0 or more")
    return count


def _cut_off(count: int) -> ValueError:
    return ValueError(f"the file is cut off: it announces {count} numbers, but fewer follow")
