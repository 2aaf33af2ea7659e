"""Readers of FreeSurfer files: surfaces, values, annotations and labels of vertices.

Format: https://surfer.nmr.mgh.harvard.edu/fswiki/FileFormats; numbers are big-endian. Names of
surfaces and values have no fixed ending (``lh.white``, ``lh.sulc``). Their first three bytes
determine the format. The readers of nibabel are not used, as they do not check the sizes in files.
"""

import math
import struct
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.reading.columns import Columns
from abfm.reading.labels import NO_LABEL, Color, Labels
from abfm.types import FloatArray, IntArray
from abfm.wording import counted

FREESURFER_SURFACES = (
    *(".white", ".pial", ".inflated", ".smoothwm", ".orig", ".sphere", ".sphere.reg"),
)
FREESURFER_VALUES = (".sulc", ".curv", ".thickness", ".area", ".volume")
"""Usual endings of the names of surfaces and values; they may have any other ending."""
_SURFACE = b"\xff\xff\xfe"
_VALUES = b"\xff\xff\xff"
_QUADRANGLES = b"\xff\xff\xfd"
_LINE_LENGTH_MAX = 1 << 16  # bytes of each of the two comment lines of a surface
_MGH_TYPES = {0: ">u1", 1: ">i4", 3: ">f4", 4: ">i2", 10: ">u2"}
_MGH_DATA_OFFSET = 284  # bytes of an .mgh file before the data
_BYTE_MAX = 255


def freesurfer_surface(data: bytes) -> tuple[FloatArray, IntArray]:
    """Read the vertices (V, 3) and triangles (F, 3) of a surface.

    Coordinates are FreeSurfer's surface RAS, as in the file and in nibabel. The centre of the
    volume (``cras``), which may follow the triangles, is not added. Raises ValueError if the file
    is not a surface, or is cut off.
    """
    if data[:3] != _SURFACE:
        raise ValueError("the file is not a FreeSurfer surface of triangles")
    begin = len(_SURFACE)
    for line in range(2):  # a comment, and an empty line, which some versions omit
        if line and data[begin : begin + 1] == b"\0":  # first byte of the number of vertices
            break
        begin = data.find(b"\n", begin, begin + _LINE_LENGTH_MAX) + 1
        if begin == 0:
            raise ValueError("the comment lines of the surface do not end; it may be cut off")
    reader = _BytesReader(data, begin)
    vertex_count, face_count = reader.count("vertices"), reader.count("triangles")
    vertices = reader.array(">f4", (vertex_count, 3), "vertices")
    faces = reader.array(">i4", (face_count, 3), "triangles")
    return vertices.astype(np.float64), faces.astype(np.int64)


def freesurfer_quadrangles(data: bytes) -> tuple[FloatArray, IntArray]:
    """Read the vertices (V, 3) and quadrangles (Q, 4) of an old surface.

    Vertex numbers have three bytes. Coordinates are integers in units of 0.01, or, in the newer
    version, floats. Raises ValueError if the file is cut off.
    """
    reader = _BytesReader(data, len(_QUADRANGLES))
    vertex_count, quad_count = reader.threes(2, "counts")
    kind, parts = (">f4", 1) if data[:3] == _QUADRANGLES else (">i2", 100)
    vertices = reader.array(kind, (vertex_count, 3), "vertices").astype(np.float64)
    quads = reader.threes(4 * quad_count, "corners of quadrangles").reshape(-1, 4)
    return vertices / parts, quads


def freesurfer_values(data: bytes) -> FloatArray:
    """Read the values (n,) at the vertices from a file such as ``lh.sulc``, new or old format.

    Raises ValueError if the file is not a file of values, or its size is wrong.
    """
    if data[:3] != _VALUES:  # old format: counts of 3 bytes, and integers in units of 0.01
        count = int.from_bytes(data[:3], "big")
        if len(data) != 6 + 2 * count:
            raise ValueError("the file does not begin as a FreeSurfer file of values")
        return np.frombuffer(data, ">i2", count, 6) / 100
    reader = _BytesReader(data, len(_VALUES))
    count, _ = reader.count("values"), reader.count("faces")
    values_per_vertex = reader.count("values per vertex")
    if values_per_vertex != 1:
        raise ValueError(f"the header announces {values_per_vertex} values per vertex; expected 1")
    values = reader.array(">f4", (count,), "values")
    if reader.remaining:
        raise ValueError(
            f"the header announces {counted(count, 'value')}, but "
            f"{counted(reader.remaining, 'byte')} more follow; expected none"
        )
    return values


def freesurfer_frames(data: bytes) -> tuple[NDArray[Any], float]:
    """Read the image (columns, rows, slices, frames) of an .mgh file, and the time between frames.

    The time is in milliseconds, or NaN if the file has none. Errors are those of
    `freesurfer_values`.
    """
    reader = _BytesReader(data)
    version = reader.number()
    if version != 1:
        raise ValueError(f"the file is not .mgh, or has version {version}; expected version 1")
    counts = [reader.count(of) for of in ("columns", "rows", "slices", "frames")]
    kind = reader.number()
    if kind not in _MGH_TYPES:
        raise ValueError(f"the type of the values is {kind}; expected one of {[*_MGH_TYPES]}")
    reader.skip(_MGH_DATA_OFFSET)
    if math.prod(counts) == 0:
        count = math.prod(counts[:3])
        raise ValueError(
            f"the file is empty: it has {counted(counts[3], 'frame')} of {counted(count, 'value')}"
        )
    values = reader.array(_MGH_TYPES[kind], tuple(counts[::-1]), "frames").T
    interval = float(reader.array(">f4", (1,), "times")[0]) if reader.remaining >= 4 else math.nan
    return values, interval


def freesurfer_annotation(data: bytes) -> Labels:
    """Read an .annot file, with a colour table of version 1 or 2, or without one.

    The file stores a colour for each vertex. The key of a label is the number of its colour in the
    table. It counts from 0 in version 1, and is stored in version 2. It is -1 for vertices without
    a colour, or with a colour that is not in the table. Without a table, keys are the colours of
    the file, red + 256 green + 65536 blue, and have no names. Errors are those of
    `freesurfer_values`.
    """
    reader = _BytesReader(data)
    count = reader.count("vertices")
    vertices, colors = reader.array(">i4", (count, 2), "vertices").astype(np.int64).T
    if not np.array_equal(np.sort(vertices), np.arange(count)):
        raise ValueError(
            f"the rows of the file do not belong to the vertices 0 to {count - 1}; "
            "expected one row for each vertex"
        )
    names, codes, key_of_color = dict[int, str](), dict[int, Color](), dict[int, int]()
    has_table = bool(reader.remaining and reader.number())
    for key, name, (red, green, blue, clear) in _table(reader) if has_table else ():
        if key in names:
            raise ValueError(f"the colour table has two entries with the number {key}")
        names[key] = name
        codes[key] = red / _BYTE_MAX, green / _BYTE_MAX, blue / _BYTE_MAX, 1 - clear / _BYTE_MAX
        key_of_color.setdefault(red | green << 8 | blue << 16, key)  # first of equal colours
    if has_table:
        unique, place = np.unique(colors, return_inverse=True)
        keys = np.array(
            [key_of_color.get(color, NO_LABEL) for color in unique.tolist()], dtype=np.int64
        )
        if colors.any() and (keys == NO_LABEL).all():
            raise ValueError(
                f"no vertex has one of the {len(codes)} colours of the colour table; the file may "
                "be damaged"
            )
        colors = keys[place]
    values = np.empty(count, dtype=np.int64)
    values[vertices] = colors
    return Labels(values, names, codes)


def freesurfer_label(data: bytes) -> Columns:
    """Read a .label text file: the vertices of one region, counted from 0, each with a value."""
    lines = data.decode("utf-8", "replace").splitlines()
    rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    if not rows or len(rows[0]) != 1 or not rows[0][0].isdecimal():
        raise ValueError("the second line of the file is not its number of vertices")
    if len(rows) - 1 != int(rows[0][0][:18]):
        raise ValueError(
            f"the file announces {brief(rows[0][0])} vertices, but has {len(rows) - 1}; it may be "
            "cut off"
        )
    return replace(_rows_of_vertices(rows[1:]), names=("value",))


def freesurfer_text(data: bytes) -> Columns:
    """Read values in the text format of ``mris_convert``.

    Its lines are those of a .label file without a header: vertex, coordinates and value.
    """
    if data.startswith(b"#!ascii"):
        raise ValueError("the file is a surface; expected a file of values")
    rows = [line.split() for line in data.decode("utf-8", "replace").splitlines() if line.strip()]
    return _rows_of_vertices(rows)


def _rows_of_vertices(rows: list[list[str]]) -> Columns:
    for k, row in enumerate(rows):
        if len(row) != 5 or not (row[0].isdecimal() and len(row[0]) < 10 and _is_number(row[4])):
            raise ValueError(
                f"the line of vertex {k}, counting from 0, is {brief(' '.join(row))}; expected its "
                "number, three coordinates and a value"
            )
    values = np.array([float(row[4]) for row in rows], dtype=np.float64).reshape(-1, 1)
    return Columns(values, vertices=np.array([int(row[0]) for row in rows], dtype=np.int64))


class _BytesReader:
    """Sequential reader of numbers and arrays, which raises a ValueError if bytes are missing."""

    def __init__(self, data: bytes, begin: int = 0) -> None:
        self._data, self._begin = data, begin

    @property
    def remaining(self) -> int:
        return len(self._data) - self._begin

    def threes(self, count: int, of: str) -> IntArray:
        high, middle, low = self.array("u1", (count, 3), of).astype(np.int64).T
        found: IntArray = high << 16 | middle << 8 | low
        return found

    def skip(self, to: int) -> None:
        if to > len(self._data):
            raise ValueError(
                f"the file is cut off: it has {len(self._data)} bytes, but its header "
                f"alone has {to}"
            )
        self._begin = to

    def number(self) -> int:
        if self.remaining < 4:
            raise ValueError("the file is cut off: a number is missing")
        self._begin += 4
        return int(struct.unpack_from(">i", self._data, self._begin - 4)[0])

    def count(self, of: str) -> int:
        count = self.number()
        if count < 0:
            raise ValueError(f"the file announces {count} {of}; expected 0 or more")
        return count

    def text(self) -> str:
        count = self.count("letters of a name")
        if count > self.remaining:
            raise ValueError(f"the file is cut off: a name of {count} letters is missing")
        self._begin += count
        found = self._data[self._begin - count : self._begin]
        return found.partition(b"\0")[0].decode("utf-8", "replace")

    def array(self, dtype: str, shape: tuple[int, ...], of: str) -> NDArray[Any]:
        count = math.prod(shape)
        size = count * np.dtype(dtype).itemsize
        if size > self.remaining:
            raise ValueError(
                f"the file is cut off: its {of} (number: {shape[0]}) have {size} bytes, but only "
                f"{self.remaining} remain"
            )
        self._begin += size
        return np.frombuffer(self._data, dtype, count, self._begin - size).reshape(shape)


def _table(reader: _BytesReader) -> list[tuple[int, str, tuple[int, int, int, int]]]:
    """Return the key, the name and the colour of each entry of a colour table.

    A colour is red, green, blue and transparency, from 0 to 255.
    """
    count = reader.number()
    version = 1 if count > 0 else -count
    if version not in (1, 2):
        raise ValueError(f"the colour table has version {version}; expected 1 or 2")
    if version == 2:
        reader.count("colours")  # this number is only an upper bound
    reader.text()  # the file that the table was read from
    count = count if version == 1 else reader.count("colours")
    found = []
    for place in range(count):  # if the count is wrong, bytes are missing, which raises an error
        key = place if version == 1 else reader.count("as the number of a colour")
        name = reader.text()
        red, green, blue, clear = (reader.number() for _ in range(4))
        if not all(0 <= part <= _BYTE_MAX for part in (red, green, blue, clear)):
            raise ValueError(
                f"the colour of {brief(name)} has components outside the range 0 to 255"
            )
        found.append((key, name, (red, green, blue, clear)))
    return found


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
