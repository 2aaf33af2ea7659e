"""Reader of PLY files, text and binary, with polygons of any sizes and further properties.

The reader of trimesh accepts truncated text files, and refuses binary files with polygons of
different sizes.
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
from abfm.reading import Opened, PointData, Polygons, decoded, integer, number, triangles_of_strips
from abfm.types import FloatArray, IntArray

_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"(?:\r\n|\n|\r)[ \t]*+end_header\b[^\r\n]*+(\r\n|\n|\r|\Z)")
_COMMENT = re.compile(rb"^[ \t]*+comment\b[^\r\n]*+", re.MULTILINE)
_CORNERS = ("vertexindex", "vertexindices", "vertexindexs", "vertices")
"""Names of the list of corners of a face, without underscores, in lower case."""
_COLORS = ("red", "green", "blue", "alpha")
_WHITES = {"B": 255.0, "H": 65535.0, "f": 1.0, "d": 1.0}  # value of white by type of the colour
_NAMES = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double")
_BITS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
# the code of each type in Python's struct module
_CODES = dict(zip(_NAMES + _BITS, 2 * "bBhHiIfd", strict=True)) | {"int64": "q", "uint64": "Q"}
_INTEGER_MAX = 2.0**53  # doubles above it do not represent every integer


class _Property(NamedTuple):
    """A property of an element of a PLY file: a number, or a list after its length.

    ``code`` and ``length_code`` are the NumPy types of both.
    """

    name: str
    code: str
    length_code: str = ""


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]


# the numbers of a property, with lists concatenated, and the length of each list
_Column = tuple[NDArray[Any], IntArray | None]


class PlyFile(NamedTuple):
    """Contents of a PLY file."""

    vertices: FloatArray  # (V, 3) positions
    sizes: IntArray  # (P,) number of corners of each polygon
    corners: IntArray  # concatenated corners of the polygons
    columns: PointData  # other values of the vertices, (V,), by name
    colors: FloatArray | None  # (V, 4) red, green, blue and opacity from 0 to 1, or None


def read_ply(opened: Opened) -> FileContents:
    """Read the vertices, polygons and triangle strips of a PLY file."""
    file = ply_contents(opened)
    return split_polygons(file.vertices, file.sizes, file.corners)


def ply_contents(opened: Opened) -> PlyFile:
    """Read a PLY file with the values of its vertices; raise a ValueError if it is invalid."""
    data = opened.data
    if not data.startswith(b"ply"):  # the text has another encoding than UTF-8
        data = decoded(data, "replace").encode()
    end = _END.search(data)
    begins = data.startswith(b"ply")
    if end is None or not begins or data[: end.start()].split(None, 1)[0] != b"ply":
        raise ValueError("the file does not begin with a PLY header")
    header = data[: end.start()].decode("utf-8", errors="replace").splitlines()
    order, elements = _parsed([line.split() for line in header])
    # if lines of the header end with a carriage return alone, a line feed after it is data
    start = end.end(1) - (end[1] == b"\r\n" and re.match(rb"ply[ \t]*+\r(?!\n)", data) is not None)
    body = _Body(data, start, order)
    if order:
        return _contents(body, elements)
    found, reason = None, None
    try:
        found = _contents(body, elements)
    except ValueError as error:
        reason = error
    if found is None or not body.is_at_end:  # rows have more words than announced
        with suppress(ValueError):
            return _contents(_Body(_announced_words(data[start:], elements), 0, order), elements)
    if found is None:
        raise reason or ValueError("the header announces no elements")
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
            assert sizes is not None  # the property is a list
            if corners.dtype.kind == "f":
                raise ValueError("the vertex numbers of faces have a float type; expected integers")
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
        raise ValueError(f"the vertices have no property {name}")
    return columns[chosen]


def _name_of_corners(element: _Element) -> str:
    """Return the name of the list of the faces' corners: a usual name, or else the only list."""
    lists = [p.name for p in element.properties if p.length_code]
    usual = [name for name in lists if name.lower().replace("_", "") in _CORNERS]
    if not (chosen := usual or lists[: len(lists) == 1]):
        raise ValueError("the faces have no list property vertex_indices")
    return chosen[0]


def _triangles(sizes: IntArray, corners: IntArray) -> tuple[IntArray, IntArray]:
    """Return the triangles of triangle strips, which -1 separates: sizes (all 3) and corners."""
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
    """Return the byte order (empty for text) and the elements that a PLY header announces."""
    kinds = (words[1] for words in header if words[:1] == ["format"] and len(words) > 1)
    kind = next(kinds, "missing")
    if kind not in _ORDERS:
        raise ValueError(
            f"the format is {kind[:40]}; expected ascii, binary_little_endian or binary_big_endian"
        )
    order, elements = _ORDERS[kind], list[_Element]()
    for words in header:
        match words:
            case ["element", name, count] if count.isascii() and count.isdigit():
                elements.append(_Element(name, integer(count), []))
            case ["property", "list", length, kind, name] if (
                elements and kind in _CODES and length in _CODES
            ):
                if _CODES[length] in "fd":
                    raise ValueError(
                        f"the length of list {name[:40]} has type {length}; expected an integer "
                        "type"
                    )
                elements[-1].properties.append(_Property(name, _CODES[kind], _CODES[length]))
            case ["property", kind, name] if elements and kind in _CODES:
                elements[-1].properties.append(_Property(name, _CODES[kind]))
            case ["element" | "property", *_]:
                raise ValueError(f"a line of the header is not valid PLY: {' '.join(words)[:60]}")
    return order, elements


def _announced_words(text: bytes, elements: Sequence[_Element]) -> bytes:
    """Return a text, one row on each line, without the words that its header does not announce."""
    lines = (words for line in _COMMENT.sub(b"", text).splitlines() if (words := line.split()))
    rows = []
    for element in elements:
        for words in islice(lines, element.rows if element.properties else 0):
            size = 0
            for p in element.properties:
                if size >= len(words):
                    raise _cut_off(element)
                size += 1 + (max(integer(words[size]), 0) if p.length_code else 0)
            rows.append(b" ".join(words[:size]))
    return b"\n".join(rows)


class _Body:
    """The data after the header of a PLY file: bytes in a byte order, or words as doubles."""

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
        """Read the next element, and return its properties with ``wanted`` names.

        Of several properties of the same name, the last one is returned. Raises ValueError if the
        file is cut off, or if the length of a list is negative.
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
        """Return the properties with ``wanted`` names of an element with lists, read row by row."""
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
        return {
            p.name: self._column(p, *found[p.name]) for p in element.properties if p.name in found
        }

    def _walk_row(
        self,
        steps: "Sequence[tuple[struct.Struct | None, int, tuple[bytearray, array[int]] | None]]",
    ) -> None:
        data, position = self._data, self._position
        for length, size, column in steps:
            count = 1
            if length:
                count = _as_integer(length.unpack_from(data, position)[0])
                position += length.size
            if count < 0:
                raise ValueError(f"the length of a list is {count}; expected 0 or more")
            end = position + count * size
            if end > len(data):
                raise EOFError
            if column:
                column[0].extend(data[position:end])
                if length:
                    column[1].append(count)
            position = end
        self._position = position

    def _column(self, p: _Property, content: bytearray, counts: Sequence[int]) -> _Column:
        values = np.frombuffer(content, self._kind(p.code))
        if not self._order and p.code not in "fd":
            wrong = ~((np.abs(values) <= _INTEGER_MAX) & (values == np.floor(values)))
            if wrong.any():
                raise _not_an_integer(values[wrong][0])
            values = values.astype(np.int64)
        return values, np.asarray(counts, np.int64) if p.length_code else None


def _as_integer(value: float) -> int:
    if not float(value).is_integer():
        raise _not_an_integer(value)
    return int(value)


def _not_an_integer(value: float) -> ValueError:
    return ValueError(f"a number is {value:g}; expected an integer of at most 16 digits")


def _cut_off(element: _Element) -> ValueError:
    return ValueError(
        f"the file is cut off: it has fewer rows of {element.name[:40]} than the header announces"
    )
