"""The files of FreeSurfer: surfaces, values, annotations and labels of vertices.

Format: https://surfer.nmr.mgh.harvard.edu/fswiki/FileFormats; numbers are big endian. Names of
surfaces and values have no ending of their own (``lh.white``, ``lh.sulc``): their first three bytes
tell. Own code, as nibabel believes the sizes that files give.
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

FREESURFER_SURFACES = (
    *(".white", ".pial", ".inflated", ".smoothwm", ".orig", ".sphere", ".sphere.reg"),
)
FREESURFER_VALUES = (".sulc", ".curv", ".thickness", ".area", ".volume")
"""What names of surfaces and of values usually end in; they may end in anything."""
_SURFACE = b"\xff\xff\xfe"
_VALUES = b"\xff\xff\xff"
_QUADRANGLES = b"\xff\xff\xfd"
_LONGEST_LINE = 1 << 16  # of the two lines that say who made a surface
_MGH_TYPES = {0: ">u1", 1: ">i4", 3: ">f4", 4: ">i2", 10: ">u2"}
_MGH_DATA = 284  # where it begins
_BYTE_MAX = 255


def freesurfer_surface(data: bytes) -> tuple[FloatArray, IntArray]:
    """Read vertices (V, 3) and triangles (F, 3) of a surface.

    Coordinates are those of the file, FreeSurfer's surface RAS, as nibabel gives them: the centre
    of the volume (``cras``), which may follow the triangles, is not added.

    A ValueError reports what is wrong with it.
    """
    if data[:3] != _SURFACE:
        raise ValueError("it is no FreeSurfer surface of triangles")
    begin = len(_SURFACE)
    for line in range(2):  # who made it and when, and an empty line, which some versions leave out
        if line and data[begin : begin + 1] == b"\0":  # of the number of vertices
            break
        begin = data.find(b"\n", begin, begin + _LONGEST_LINE) + 1
        if begin == 0:
            raise ValueError("the lines that say who made it do not end: it may be cut off")
    bytes_ = _Bytes(data, begin)
    vertex_count, face_count = bytes_.count("vertices"), bytes_.count("triangles")
    vertices = bytes_.array(">f4", (vertex_count, 3), "vertices")
    faces = bytes_.array(">i4", (face_count, 3), "triangles")
    return vertices.astype(np.float64), faces.astype(np.int64)


def freesurfer_quadrangles(data: bytes) -> tuple[FloatArray, IntArray]:
    """Read vertices (V, 3) and quadrangles (Q, 4) of an old surface, with numbers of three bytes.

    Coordinates are hundredths, or, in the newer of both kinds, floats. A ValueError reports what is
    wrong with it.
    """
    bytes_ = _Bytes(data, len(_QUADRANGLES))
    vertex_count, quad_count = bytes_.threes(2, "counts")
    kind, parts = (">f4", 1) if data[:3] == _QUADRANGLES else (">i2", 100)
    vertices = bytes_.array(kind, (vertex_count, 3), "vertices").astype(np.float64)
    quads = bytes_.threes(4 * quad_count, "corners of quadrangles").reshape(-1, 4)
    return vertices / parts, quads


def freesurfer_values(data: bytes) -> FloatArray:
    """Read the values at vertices, (n,), of a file such as ``lh.sulc``, also of an old one.

    A ValueError reports what is wrong with it.
    """
    if data[:3] != _VALUES:  # counts of 3 bytes, and hundredths
        count = int.from_bytes(data[:3], "big")
        if len(data) != 6 + 2 * count:
            raise ValueError("it does not begin as FreeSurfer's files of values do")
        return np.frombuffer(data, ">i2", count, 6) / 100
    bytes_ = _Bytes(data, len(_VALUES))
    count, _, each = bytes_.count("values"), bytes_.count("faces"), bytes_.count("values a vertex")
    if each != 1:
        raise ValueError(f"it says to have {each} values a vertex; expected 1")
    values = bytes_.array(">f4", (count,), "values")
    if bytes_.left:
        raise ValueError(f"{bytes_.left} bytes follow the {count} values that it says to have")
    return values


def freesurfer_frames(data: bytes) -> tuple[NDArray[Any], float]:
    """Read the image in an .mgh file, (columns, rows, slices, frames), and the milliseconds between
    frames, which may follow it; NaN if they do not. Errors as in `freesurfer_values`.
    """
    bytes_ = _Bytes(data)
    version = bytes_.number()
    if version != 1:
        raise ValueError(f"it is no .mgh file, or of version {version}; expected 1")
    counts = [bytes_.count(of) for of in ("columns", "rows", "slices", "frames")]
    kind = bytes_.number()
    if kind not in _MGH_TYPES:
        raise ValueError(f"its values have the type {kind}; expected one of {[*_MGH_TYPES]}")
    bytes_.skip(_MGH_DATA)
    if math.prod(counts) == 0:
        count = math.prod(counts[:3])
        raise ValueError(f"it holds {counts[3]} frames of {count} values, which is nothing")
    values = bytes_.array(_MGH_TYPES[kind], tuple(counts[::-1]), "frames").T
    return values, float(bytes_.array(">f4", (1,), "times")[0]) if bytes_.left >= 4 else math.nan


def freesurfer_annotation(data: bytes) -> Labels:
    """Read an .annot file, with a table of colours of version 1 or 2, or without one.

    The file gives each vertex a colour; keys are the numbers of the colours in the table, from 0
    (version 2 has numbers of its own for them). Vertices without a colour, or with one that the
    table does not have, have the key -1. Without a table, keys are the colours as the file has
    them, red + 256 green + 65536 blue, and have no names. Errors as in `freesurfer_values`.
    """
    bytes_ = _Bytes(data)
    count = bytes_.count("vertices")
    vertices, colors = bytes_.array(">i4", (count, 2), "vertices").astype(np.int64).T
    if not np.array_equal(np.sort(vertices), np.arange(count)):
        raise ValueError(f"its {count} rows are not one for each of the vertices from 0")
    names, codes, found = dict[int, str](), dict[int, Color](), dict[int, int]()
    has_table = bool(bytes_.left and bytes_.number())
    for key, name, (red, green, blue, clear) in _table(bytes_) if has_table else ():
        if key in names:
            raise ValueError(f"its table has two entries of the number {key}")
        names[key] = name
        codes[key] = red / _BYTE_MAX, green / _BYTE_MAX, blue / _BYTE_MAX, 1 - clear / _BYTE_MAX
        found.setdefault(red | green << 8 | blue << 16, key)  # of one colour the first
    if has_table:
        known, place = np.unique(colors, return_inverse=True)
        keys = np.array([found.get(color, NO_LABEL) for color in known.tolist()], dtype=np.int64)
        if colors.any() and (keys == NO_LABEL).all():
            raise ValueError(f"no vertex has one of the {len(codes)} colours in its table")
        colors = keys[place]
    values = np.empty(count, dtype=np.int64)
    values[vertices] = colors
    return Labels(values, names, codes)


def freesurfer_label(data: bytes) -> Columns:
    """Read a .label file, a text: vertices of one region, counted from 0, each with a value."""
    lines = data.decode("utf-8", "replace").splitlines()
    rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    if not rows or len(rows[0]) != 1 or not rows[0][0].isdecimal():
        raise ValueError("its second line is not the number of its vertices")
    if len(rows) - 1 != int(rows[0][0][:18]):
        raise ValueError(f"it says to have {brief(rows[0][0])} vertices, and has {len(rows) - 1}")
    return replace(_rows_of_vertices(rows[1:]), names=("value",))


def freesurfer_text(data: bytes) -> Columns:
    """Read values in a text without a header, as mris_convert writes them; lines as in .label."""
    if data.startswith(b"#!ascii"):
        raise ValueError("it is a surface; use a file of values")
    rows = [line.split() for line in data.decode("utf-8", "replace").splitlines() if line.strip()]
    return _rows_of_vertices(rows)


def _rows_of_vertices(rows: list[list[str]]) -> Columns:
    for k, row in enumerate(rows):
        if len(row) != 5 or not (row[0].isdecimal() and len(row[0]) < 10 and _is_number(row[4])):
            raise ValueError(
                f"vertex {k} of it, counting from 0, is {brief(' '.join(row))}; expected its "
                "number, three coordinates and a value"
            )
    values = np.array([float(row[4]) for row in rows], dtype=np.float64).reshape(-1, 1)
    return Columns(values, vertices=np.array([int(row[0]) for row in rows], dtype=np.int64))


class _Bytes:
    """Numbers and arrays taken from bytes one after the other, never more than there are."""

    def __init__(self, data: bytes, begin: int = 0) -> None:
        self._data, self._begin = data, begin

    @property
    def left(self) -> int:
        return len(self._data) - self._begin

    def threes(self, count: int, of: str) -> IntArray:
        """Return whole numbers (count,) of three bytes each."""
        high, middle, low = self.array("u1", (count, 3), of).astype(np.int64).T
        found: IntArray = high << 16 | middle << 8 | low
        return found

    def skip(self, to: int) -> None:
        if to > len(self._data):
            raise ValueError(f"it is cut off: it has {len(self._data)} bytes of a header of {to}")
        self._begin = to

    def number(self) -> int:
        if self.left < 4:
            raise ValueError("it is cut off: a number is missing")
        self._begin += 4
        return int(struct.unpack_from(">i", self._data, self._begin - 4)[0])

    def count(self, of: str) -> int:
        count = self.number()
        if count < 0:
            raise ValueError(f"it says to have {count} {of}")
        return count

    def text(self) -> str:
        count = self.count("letters of a name")
        if count > self.left:
            raise ValueError(f"it is cut off: a name of {count} letters is missing")
        self._begin += count
        found = self._data[self._begin - count : self._begin]
        return found.partition(b"\0")[0].decode("utf-8", "replace")

    def array(self, dtype: str, shape: tuple[int, ...], of: str) -> NDArray[Any]:
        count = math.prod(shape)
        size = count * np.dtype(dtype).itemsize
        if size > self.left:
            raise ValueError(
                f"it is cut off: {self.left} bytes are left for {shape[0]} {of}, which have {size}"
            )
        self._begin += size
        return np.frombuffer(self._data, dtype, count, self._begin - size).reshape(shape)


def _table(bytes_: _Bytes) -> list[tuple[int, str, tuple[int, int, int, int]]]:
    """Return number, name, and red, green, blue and transparency of a table's colours."""
    count = bytes_.number()
    version = 1 if count > 0 else -count
    if version not in (1, 2):
        raise ValueError(f"its table of colours has version {version}; expected 1 or 2")
    if version == 2:
        bytes_.count("colours")  # at most
    bytes_.text()  # the file that the table was in
    count = count if version == 1 else bytes_.count("colours")
    found = []
    for place in range(count):  # which ends with an error where the bytes do
        key = place if version == 1 else bytes_.count("as the number of a colour")
        name = bytes_.text()
        red, green, blue, clear = (bytes_.number() for _ in range(4))
        if not all(0 <= part <= _BYTE_MAX for part in (red, green, blue, clear)):
            raise ValueError(f"the colour of {brief(name)} has parts that are not from 0 to 255")
        found.append((key, name, (red, green, blue, clear)))
    return found


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
