"""Polygon file format (PLY), text and binary, with any mixture of polygons and further properties.

trimesh's reader takes text files that are cut off, and no binary ones with polygons of several
sizes.
"""

import re
import struct
from array import array
from collections.abc import Sequence, Set
from contextlib import suppress
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.mesh.readers.contents import FileContents, split_polygons
from abfm.reading import (
    Opened,
    PointData,
    Polygons,
    decoded,
    number,
    triangles_of_strips,
    whole_number,
)
from abfm.types import FloatArray, IntArray

_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"(?:\r\n|\n|\r)[ \t]*+end_header\b[^\r\n]*+(\r\n|\n|\r|\Z)")
_COMMENT = re.compile(rb"^[ \t]*+comment\b[^\r\n]*+", re.MULTILINE)
_CORNERS = ("vertexindex", "vertexindices", "vertexindexs", "vertices")
"""Without underscores, in lower case."""
_COLORS = ("red", "green", "blue", "alpha")
_WHITES = {"B": 255.0, "H": 65535.0, "f": 1.0, "d": 1.0}  # by the type of a colour
_NAMES = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double")
_BITS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
# of the header's types in Python's struct
_CODES = dict(zip(_NAMES + _BITS, 2 * "bBhHiIfd", strict=True)) | {"int64": "q", "uint64": "Q"}
_WHOLE_NUMBER_MAX = 2.0**53  # above, doubles do not tell one whole number from the next


class _Property(NamedTuple):
    """A column of an element: a number, or a list of numbers with its length before it."""

    name: str
    code: str
    length_code: str = ""


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]


# the numbers of a property, list after list, and how many each list has
_Column = tuple[NDArray[Any], IntArray | None]


class PlyFile(NamedTuple):
    """Vertices (V, 3), the sizes of polygons, (P,), the corners of one after the other, and what
    vertices have: columns (V,) by their names.
    """

    vertices: FloatArray
    sizes: IntArray
    corners: IntArray
    columns: PointData
    colors: FloatArray | None
    """(V, 4), red, green, blue and opacity from 0 to 1, if there are any."""


def read_ply(opened: Opened) -> FileContents:
    """Read vertices, polygons and strips of a PLY file; all else is passed over."""
    file = ply_contents(opened)
    return split_polygons(file.vertices, file.sizes, file.corners)


def ply_contents(opened: Opened) -> PlyFile:
    """Read a PLY file with what it has at vertices; a ValueError reports what is wrong with it."""
    data = opened.data
    if not data.startswith(b"ply"):  # text in another encoding
        data = decoded(data, "replace").encode()
    end = _END.search(data)
    begins = data.startswith(b"ply")
    if end is None or not begins or data[: end.start()].split(None, 1)[0] != b"ply":
        raise ValueError("it does not begin with a PLY header")
    header = data[: end.start()].decode("utf-8", errors="replace").splitlines()
    order, elements = _parsed([line.split() for line in header])
    # after a header whose lines end with carriage returns, a line feed is already data
    start = end.end(1) - (end[1] == b"\r\n" and re.match(rb"ply[ \t]*+\r(?!\n)", data) is not None)
    body = _Body(data, start, order)
    if order:
        return _contents(body, elements)
    found, reason = None, None
    try:
        found = _contents(body, elements)
    except ValueError as error:
        reason = error
    if found is None or not body.is_at_end:  # rows may have more words than they announce
        with suppress(ValueError):
            return _contents(_Body(_announced_words(data[start:], elements), 0, order), elements)
    if found is None:
        raise reason or ValueError("it has no elements")
    return found


def _contents(body: "_Body", elements: Sequence[_Element]) -> PlyFile:
    vertices, columns, colors = np.zeros((0, 3)), PointData(()), None
    polygons: list[Polygons] = []
    for element in elements:
        if element.name == "vertex":
            plain = [p.name for p in element.properties if not p.length_code]
            found = body.take(element, set(plain))
            columns = PointData((name, partial(_doubles, found[name])) for name in plain)
            vertices = np.stack([_coordinate(columns, name) for name in "xyz"], axis=1)
            colors = _colors(element, columns)
        elif element.name in ("face", "tristrips") and element.rows:
            name = _name_of_corners(element)
            corners, sizes = body.take(element, {name})[name]
            assert sizes is not None  # of a list
            if corners.dtype.kind == "f":
                raise ValueError(
                    "its faces name vertices by numbers of type float: make them whole numbers"
                )
            if element.name == "tristrips":
                sizes, corners = _triangles(sizes, corners)
            polygons.append((sizes, corners))
        else:
            body.take(element, set())
    sizes, corners = polygons[0] if polygons else (np.zeros(0, dtype=np.int64),) * 2
    if len(polygons) > 1:
        sizes, corners = (np.concatenate(each) for each in zip(*polygons, strict=True))
    return PlyFile(vertices, sizes, corners, columns, colors)


def _doubles(column: _Column) -> FloatArray:
    return column[0].astype(np.float64)


def _coordinate(columns: PointData, name: str) -> FloatArray:
    chosen = name if name in columns else name.upper()
    if chosen not in columns:
        raise ValueError(f"it has no property {name}")
    return columns[chosen]


def _name_of_corners(element: _Element) -> str:
    """Return the list of corners: by its name, of which there are many, or as the only list."""
    lists = [p.name for p in element.properties if p.length_code]
    known = [name for name in lists if name.lower().replace("_", "") in _CORNERS]
    if not (chosen := known or lists[: len(lists) == 1]):
        raise ValueError("its faces have no list property vertex_indices")
    return chosen[0]


def _triangles(sizes: IntArray, corners: IntArray) -> tuple[IntArray, IntArray]:
    """Return the triangles of lists of strips, which -1 separates, as sizes and corners."""
    corners = np.insert(corners.astype(np.int64), np.cumsum(sizes), -1)
    ends = np.flatnonzero(corners == -1)
    faces = triangles_of_strips(np.diff(ends, prepend=-1) - 1, corners[corners != -1])
    return np.full(len(faces), 3), faces.ravel()


def _colors(element: _Element, columns: PointData) -> FloatArray | None:
    found = [p for p in element.properties if p.name in _COLORS and not p.length_code]
    whites = {p.name: _WHITES[p.code] for p in found if p.code in _WHITES}
    if not all(name in whites for name in _COLORS[:3]):
        return None
    shades = [columns[name] / whites[name] for name in _COLORS if name in whites]
    return np.clip(np.stack([*shades, np.ones(element.rows)], axis=1)[:, :4], 0, 1)


def _parsed(header: list[list[str]]) -> tuple[str, list[_Element]]:
    """Return the order of bytes, empty for text, and the elements that the lines announce."""
    kinds = (words[1] for words in header if words[:1] == ["format"] and len(words) > 1)
    kind = next(kinds, "missing")
    if kind not in _ORDERS:
        raise ValueError(
            f"its format is {kind[:40]}, not ascii, binary_little_endian or binary_big_endian"
        )
    order, elements = _ORDERS[kind], list[_Element]()
    for words in header:
        match words:
            case ["element", name, count] if count.isascii() and count.isdigit():
                elements.append(_Element(name, whole_number(count), []))
            case ["property", "list", length, kind, name] if (
                elements and kind in _CODES and length in _CODES
            ):
                if _CODES[length] in "fd":
                    raise ValueError(
                        f"its list {name[:40]} has a length of type {length}: make it a whole "
                        "number"
                    )
                elements[-1].properties.append(_Property(name, _CODES[kind], _CODES[length]))
            case ["property", kind, name] if elements and kind in _CODES:
                elements[-1].properties.append(_Property(name, _CODES[kind]))
            case ["element" | "property", *_]:
                raise ValueError(
                    f"its header has a line that PLY does not know: {' '.join(words)[:60]}"
                )
    return order, elements


def _announced_words(text: bytes, elements: Sequence[_Element]) -> bytes:
    """Return what the rows of elements announce, if each is a line, without what is behind it."""
    lines = (words for line in _COMMENT.sub(b"", text).splitlines() if (words := line.split()))
    rows = []
    for element in elements:
        for words in islice(lines, element.rows if element.properties else 0):
            size = 0
            for p in element.properties:
                if size >= len(words):
                    raise _cut_off(element)
                size += 1 + (max(whole_number(words[size]), 0) if p.length_code else 0)
            rows.append(b" ".join(words[:size]))
    return b"\n".join(rows)


class _Body:
    """What follows the header, taken element by element, from front to back: bytes in an order, or,
    where it is empty, the words of a text, all of them as doubles.
    """

    def __init__(self, data: bytes, start: int, order: str) -> None:
        if not order:
            text, start = data[start:], 0
            words = (_COMMENT.sub(b"", text) if b"comment" in text else text).split()
            data = array("d", map(number, words)).tobytes()
        self._data, self._position, self._order = data, start, order

    @property
    def is_at_end(self) -> bool:
        return self._position == len(self._data)

    def take(self, element: _Element, wanted: Set[str]) -> dict[str, _Column]:
        """Return the wanted properties of the next element, the last one of a name; or raise a
        ValueError if the file ends before, or a list has a length below 0.
        """
        step = sum(self._kind(p.length_code or p.code).itemsize for p in element.properties)
        if element.rows * step > len(self._data) - self._position:
            raise _cut_off(element)
        if any(p.length_code for p in element.properties):
            return self._walk(element, wanted)
        found: dict[str, _Column] = {}
        place = self._position
        for p in element.properties:
            kind = self._kind(p.code)
            if p.name in wanted:
                at = place if element.rows else 0
                found[p.name] = np.ndarray((element.rows,), kind, self._data, at, (step,)), None
            place += kind.itemsize
        self._position += element.rows * step
        return found

    def _kind(self, code: str) -> np.dtype[Any]:
        return np.dtype(self._order + code if self._order else "=d")

    def _walk(self, element: _Element, wanted: Set[str]) -> dict[str, _Column]:
        """Return the same where lengths of lists must be read to know where the next row begins."""
        found: dict[str, tuple[bytearray, array[int]]] = {}
        steps = []
        for p in element.properties:
            code = self._order + p.length_code if self._order else "=d"
            if p.name in wanted:
                found[p.name] = bytearray(), array("q")
            length = struct.Struct(code) if p.length_code else None
            steps.append((length, self._kind(p.code).itemsize, found.get(p.name)))
        try:
            for _ in range(element.rows):
                self._walk_row(steps)
        except (struct.error, EOFError) as error:
            raise _cut_off(element) from error
        kept = [p for p in element.properties if p.name in found]
        return {p.name: self._column(p, *found[p.name]) for p in kept}

    def _walk_row(
        self,
        steps: "Sequence[tuple[struct.Struct | None, int, tuple[bytearray, array[int]] | None]]",
    ) -> None:
        data, position = self._data, self._position
        for length, size, kept in steps:
            count = 1
            if length:
                count = _whole(length.unpack_from(data, position)[0])
                position += length.size
            if count < 0:
                raise ValueError(f"a list has the length {count}")
            end = position + count * size
            if end > len(data):
                raise EOFError
            if kept:
                kept[0].extend(data[position:end])
                if length:
                    kept[1].append(count)
            position = end
        self._position = position

    def _column(self, p: _Property, content: bytearray, counts: Sequence[int]) -> _Column:
        values = np.frombuffer(content, self._kind(p.code))
        if not self._order and p.code not in "fd":
            wrong = ~((np.abs(values) <= _WHOLE_NUMBER_MAX) & (values == np.floor(values)))
            if wrong.any():
                raise _not_whole(values[wrong][0])
            values = values.astype(np.int64)
        return values, np.asarray(counts, np.int64) if p.length_code else None


def _whole(value: float) -> int:
    if not float(value).is_integer():
        raise _not_whole(value)
    return int(value)


def _not_whole(value: float) -> ValueError:
    return ValueError(f"it has {value:g} where a whole number is expected, of at most 16 digits")


def _cut_off(element: _Element) -> ValueError:
    return ValueError(
        f"the file is cut off: it has fewer rows of {element.name[:40]} than its header announces"
    )
