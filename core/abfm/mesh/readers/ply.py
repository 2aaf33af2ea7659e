"""Polygon file format (PLY), text and binary, with any mixture of polygons and any further properties.

trimesh's reader takes text files that are cut off, and no binary ones with polygons of several sizes.
"""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.mesh.readers.contents import FileContents, split_polygons
from abfm.types import FloatArray

ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CODES = {  # of the header's types in Python's struct
    **dict(zip(("char", "uchar", "short", "ushort", "int", "uint", "float", "double"), "bBhHiIfd", strict=True)),
    **dict(zip(("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"), "bBhHiIfd", strict=True)),
    "int64": "q",
    "uint64": "Q",
}


class Property(NamedTuple):
    """A column of an element: a number, or a list of numbers with its length before it."""

    name: str
    code: str
    length_code: str = ""


class Element(NamedTuple):
    name: str
    rows: int
    properties: list[Property]


class Body:
    """What follows the header, taken from front to back: words of text, or numbers in an order of bytes."""

    def __init__(self, rest: bytes, order: str) -> None:
        self.order = order
        self.data = rest if order else rest.split()
        self.position = (2 if rest.startswith(b"\r\n") else 1) if order else 0

    def take(self, code: str, count: int) -> list[float]:
        """The next ``count`` numbers of one type."""
        found = self._next(count * (struct.calcsize(self.order + code) if self.order else 1))
        if isinstance(found, bytes):
            return list(struct.unpack(f"{self.order}{count}{code}", found))
        return [float(word) if code in "fd" else int(word) for word in found]

    def table(self, codes: str, rows: int) -> FloatArray:
        """The next ``rows`` rows of numbers of the types ``codes``, (rows, len(codes))."""
        if not self.order:
            return np.array(self.take("d", rows * len(codes))).reshape(rows, len(codes))
        row = np.dtype([(str(column), self.order + code) for column, code in enumerate(codes)])
        found = self._next(rows * row.itemsize)
        assert isinstance(found, bytes)
        records: NDArray[np.void] = np.frombuffer(found, row)
        return np.stack([records[column].astype(np.float64) for column in row.names or ()], axis=1)

    def _next(self, count: int) -> bytes | list[bytes]:
        """That many bytes or words."""
        found = self.data[self.position : self.position + count]
        if not 0 <= count == len(found):
            raise ValueError("the file is cut off")
        self.position += count
        return found


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
    kind = next((words[1] for words in lines if words[:1] == ["format"] and len(words) > 1), "missing")
    if kind not in ORDERS:
        raise ValueError(f"its format is {kind}, not ascii, binary_little_endian or binary_big_endian")
    body = Body(rest, ORDERS[kind])
    vertices, polygons = np.zeros((0, 3)), []
    for element in _elements(lines):
        columns = _columns(element, body)
        try:
            if element.name == "vertex":
                vertices = np.stack([np.array(columns[axis]).reshape(-1) for axis in "xyz"], axis=1)
            elif element.name == "face":
                name = "vertex_index" if "vertex_index" in columns else "vertex_indices"
                polygons = [[int(index) for index in polygon] for polygon in columns[name]]
        except KeyError as error:
            raise ValueError(f"it has no property {error.args[0]}") from None
    return split_polygons(vertices, polygons)


def _elements(header: list[list[str]]) -> list[Element]:
    elements: list[Element] = []
    for words in header:
        match words:
            case ["element", name, count]:
                elements.append(Element(name, int(count), []))
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
        table = body.table("".join(p.code for p in element.properties), element.rows)
        return {p.name: table[:, column] for column, p in enumerate(element.properties)}
    lists: dict[str, list[list[float]]] = {p.name: [] for p in element.properties}
    for _ in range(element.rows):
        for p in element.properties:
            lists[p.name].append(body.take(p.code, int(body.take(p.length_code, 1)[0]) if p.length_code else 1))
    return dict(lists)
