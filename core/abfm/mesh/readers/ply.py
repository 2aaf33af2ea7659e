"""Polygon file format (PLY), text and binary, with any mixture of polygons and any further
properties.

trimesh's reader takes text files that are cut off, and no binary ones with polygons of several
sizes.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from abfm.mesh.readers.contents import FileContents, few_corners, whole_number
from abfm.mesh.readers.ply_body import CODES, Body, Property
from abfm.mesh.readers.polygons import split_polygons
from abfm.reading import read_bytes

ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
END = re.compile(rb"(?:\r\n|\n|\r)[ \t]*+end_header\b[^\r\n]*+(\r\n|\n|\r|\Z)")
CORNERS = ("vertex_index", "vertex_indices")


class Element(NamedTuple):
    name: str
    rows: int
    properties: list[Property]


def read_ply(path: Path) -> FileContents:
    """Read vertices and faces of a PLY file; all other elements and properties are passed over."""
    data = read_bytes(path)
    end = END.search(data)
    if (
        end is None
        or data[: end.start()].split(None, 1)[:1] != [b"ply"]
        or not data.startswith(b"ply")
    ):
        raise ValueError("it does not begin with a PLY header")
    header = data[: end.start()].decode("utf-8", errors="replace").splitlines()
    order = _order(line.split() for line in header)
    # after a header whose lines end with carriage returns, a line feed is already data
    start = end.end(1) - (end[1] == b"\r\n" and re.match(rb"ply[ \t]*+\r(?!\n)", data) is not None)
    body = Body(data, start, order)
    vertices, sizes, corners = (
        np.zeros((0, 3)),
        np.zeros(0, dtype=np.int64),
        np.zeros(0, dtype=np.int64),
    )
    for element in _elements(line.split() for line in header):
        wanted = {"vertex": ("x", "y", "z"), "face": CORNERS}.get(element.name, ())
        found = body.take(element.name, element.rows, element.properties, wanted)
        if element.name == "vertex":
            missing = [
                name for name in "xyz" if name not in found or found[name].counts is not None
            ]
            if missing:
                raise ValueError(f"it has no property {missing[0]}")
            vertices = np.stack([found[name].values.astype(np.float64) for name in "xyz"], axis=1)
        elif element.name == "face":
            lists = next((found[name] for name in CORNERS if name in found), None)
            if lists is None or lists.counts is None:
                raise ValueError("its faces have no list property vertex_indices")
            if lists.values.dtype.kind == "f":
                raise ValueError(
                    "its faces name vertices by numbers of type float: make them whole numbers"
                )
            sizes, corners = lists.counts, lists.values
    if sizes.size and sizes.min() < 3:
        raise few_corners(int(np.argmin(sizes)), int(sizes.min()))
    return split_polygons(vertices, sizes, corners)


def _order(header: Iterable[list[str]]) -> str:
    kind = next(
        (words[1] for words in header if words[:1] == ["format"] and len(words) > 1), "missing"
    )
    if kind not in ORDERS:
        raise ValueError(
            f"its format is {kind[:40]}, not ascii, binary_little_endian or binary_big_endian"
        )
    return ORDERS[kind]


def _elements(header: Iterable[list[str]]) -> list[Element]:
    elements: list[Element] = []
    for words in header:
        match words:
            case ["element", name, count] if count.isascii() and count.isdigit():
                elements.append(Element(name, whole_number(count), []))
            case ["property", "list", length, kind, name] if (
                elements and kind in CODES and length in CODES
            ):
                if CODES[length] in "fd":
                    raise ValueError(
                        f"its list {name[:40]} has a length of type {length}: make it a whole "
                        "number"
                    )
                elements[-1].properties.append(Property(name, CODES[kind], CODES[length]))
            case ["property", kind, name] if elements and kind in CODES:
                elements[-1].properties.append(Property(name, CODES[kind]))
            case ["element" | "property", *_]:
                raise ValueError(
                    f"its header has a line that PLY does not know: {' '.join(words)[:60]}"
                )
    return elements
