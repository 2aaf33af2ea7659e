"""Polygon file format (PLY), text and binary, with any mixture of polygons and any further properties."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from abfm.mesh.readers.contents import FileContents, split_polygons
from abfm.types import FloatArray

TYPE_NAMES = {  # of the header, by their code in Python's struct
    "b": ("char", "int8"),
    "B": ("uchar", "uint8"),
    "h": ("short", "int16"),
    "H": ("ushort", "uint16"),
    "i": ("int", "int32"),
    "I": ("uint", "uint32"),
    "q": ("int64",),
    "Q": ("uint64",),
    "f": ("float", "float32"),
    "d": ("double", "float64"),
}
CODES = {name: code for code, names in TYPE_NAMES.items() for name in names}


class Property(NamedTuple):
    """A column of an element: a number, or a list of numbers with its length before it."""

    name: str
    code: str
    length_code: str = ""


@dataclass
class Element:
    name: str
    count: int
    properties: list[Property] = field(default_factory=list)


class Body(Protocol):
    """What follows the header, taken from front to back."""

    def take(self, code: str, count: int) -> list[float]:
        """The next ``count`` numbers of one type."""

    def table(self, codes: str, rows: int) -> FloatArray:
        """The next ``rows`` rows of numbers of the types ``codes``, (rows, len(codes))."""


@dataclass
class TextBody:
    words: list[bytes]
    position: int = 0

    def take(self, code: str, count: int) -> list[float]:
        words = self.words[self.position : self.position + count]
        if not 0 <= count == len(words):
            raise ValueError("the file is cut off")
        self.position += count
        return [float(word) for word in words] if code in "fd" else [int(word) for word in words]

    def table(self, codes: str, rows: int) -> FloatArray:
        return np.array(self.take("d", rows * len(codes))).reshape(rows, len(codes))


@dataclass
class BinaryBody:
    data: bytes
    order: str
    position: int = 0

    def take(self, code: str, count: int) -> list[float]:
        size = count * struct.calcsize(self.order + code)
        if not 0 <= size <= len(self.data) - self.position:
            raise ValueError("the file is cut off")
        values = struct.unpack_from(f"{self.order}{count}{code}", self.data, self.position)
        self.position += size
        return list(values)

    def table(self, codes: str, rows: int) -> FloatArray:
        row = np.dtype([(str(column), self.order + code) for column, code in enumerate(codes)])
        if not 0 <= rows * row.itemsize <= len(self.data) - self.position:
            raise ValueError("the file is cut off")
        records = np.frombuffer(self.data, row, rows, self.position)
        self.position += rows * row.itemsize
        return np.stack([records[column].astype(np.float64) for column in records.dtype.names or ()], axis=1)


def read_ply(path: Path) -> FileContents:
    """Vertices and faces of a PLY file; all other elements and properties are passed over.

    Raises
    ------
    ValueError
        Saying what is wrong with the file.
    """
    header, end, rest = path.read_bytes().partition(b"end_header")
    lines = [line.split() for line in header.decode("utf-8", errors="replace").splitlines()]
    if not end or lines[:1] != [["ply"]]:
        raise ValueError("it does not begin with a PLY header")
    body = _body(lines, rest)
    vertices, polygons = np.zeros((0, 3)), []
    for element in _elements(lines):
        columns = _columns(element, body)
        if element.name == "vertex":
            vertices = np.stack([np.array(_column(columns, axis)).reshape(-1) for axis in "xyz"], axis=1)
        elif element.name == "face":
            name = "vertex_index" if "vertex_index" in columns else "vertex_indices"
            polygons = [[int(index) for index in polygon] for polygon in _column(columns, name)]
    return split_polygons(vertices, polygons)


def _body(header: list[list[str]], rest: bytes) -> Body:
    kind = next((words[1] for words in header if words[:1] == ["format"] and len(words) > 1), "missing")
    if kind == "ascii":
        return TextBody(rest.split())
    orders = {"binary_little_endian": "<", "binary_big_endian": ">"}
    if kind not in orders:
        raise ValueError(f"its format is {kind}, not ascii, binary_little_endian or binary_big_endian")
    return BinaryBody(rest, orders[kind], position=2 if rest.startswith(b"\r\n") else 1)


def _elements(header: list[list[str]]) -> list[Element]:
    elements: list[Element] = []
    for words in header:
        match words:
            case ["element", name, count]:
                elements.append(Element(name, int(count)))
            case ["property", "list", length, kind, name] if elements and kind in CODES and length in CODES:
                elements[-1].properties.append(Property(name, CODES[kind], CODES[length]))
            case ["property", kind, name] if elements and kind in CODES:
                elements[-1].properties.append(Property(name, CODES[kind]))
            case ["element" | "property", *_]:
                raise ValueError(f"its header has a line that PLY does not know: {' '.join(words)}")
    return elements


def _columns(element: Element, body: Body) -> dict[str, FloatArray | list[list[float]]]:
    """Values of every property: an array where the element has no lists, else a list per row."""
    if not any(p.length_code for p in element.properties):
        table = body.table("".join(p.code for p in element.properties), element.count)
        return {p.name: table[:, column] for column, p in enumerate(element.properties)}
    lists: dict[str, list[list[float]]] = {p.name: [] for p in element.properties}
    for _ in range(element.count):
        for p in element.properties:
            lists[p.name].append(body.take(p.code, int(body.take(p.length_code, 1)[0]) if p.length_code else 1))
    return dict(lists)


def _column(columns: dict[str, FloatArray | list[list[float]]], name: str) -> FloatArray | list[list[float]]:
    if name not in columns:
        raise ValueError(f"it has no property {name}")
    return columns[name]
