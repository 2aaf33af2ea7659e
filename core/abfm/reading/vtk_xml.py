"""VTK's XML files, .vtu and .vtp, and the collections of them, .pvd.

Format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html. Arrays are texts,
or bytes in base64 or as they are, in place or appended, plain or in blocks compressed by zlib or
LZMA. Own code: meshio is no longer maintained, fails where arrays share bytes, and decompresses
without a bound; VTK takes 570 MB and crashes the process on one damaged file in thirty.
"""

import base64
import lzma
import math
import os
import re
import sys
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.numerics.real_numbers import as_doubles
from abfm.reading.plain_files import inflated, most_inflated, read_bytes
from abfm.reading.vtk_file import (
    POLYGON,
    STRIP,
    PointData,
    Polygons,
    VtkFile,
    polygons_of_cells,
)
from abfm.reading.xml_events import take_events
from abfm.types import FloatArray, IntArray

_TYPES = {
    f"{name}{bits}": np.dtype(f"{code}{bits // 8}")
    for name, code, sizes in (
        ("Int", "i", (8, 16, 32, 64)),
        ("UInt", "u", (8, 16, 32, 64)),
        ("Float", "f", (32, 64)),
    )
    for bits in sizes
}
_ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
_HEADS = {"UInt32": "u4", "UInt64": "u8"}
_KINDS = ("UnstructuredGrid", "PolyData")
_PLACES = ("Points", "PointData", "FieldData", "Cells", "Polys", "Strips")
_APPENDED = re.compile(rb"<AppendedData[^>]*>\s*_")
_END = b"</AppendedData>"
_MOST_BLOCKS = 1 << 24

Expand = Callable[[bytes, int], bytes]


class _Array(NamedTuple):
    """A data array as it is declared, and the text in it."""

    attributes: dict[str, str]
    text: str


def xml_contents(content: bytes) -> VtkFile:
    """Read a .vtu or .vtp file; a ValueError reports what is wrong with it."""
    file = _File(content)
    if file.kind not in _KINDS:
        raise ValueError(f"it is VTK's {brief(file.kind)}; expected {' or '.join(_KINDS)}")
    if len(file.pieces) != 1:
        raise ValueError(f"it has {len(file.pieces)} pieces; expected one: merge them in ParaView")
    count = _whole(file.pieces[0], "NumberOfPoints")
    points = file.arrays["Points"]
    if len(points) != 1:
        raise ValueError(f"it has {len(points)} arrays of points; expected one")
    places = file.values(points[0], count)
    if places.shape[1] != 3:
        raise ValueError(f"its points have {places.shape[1]} coordinates; expected 3")
    data = PointData(
        (array.attributes.get("Name", ""), partial(file.values, array, count))
        for array in file.arrays["PointData"]
    )
    fields = file.arrays["FieldData"]
    times = [array for array in fields if array.attributes.get("Name") == "TimeValue"]
    time = float(file.values(times[-1], 1)[0, 0]) if times else math.nan
    return VtkFile(places, file.polygons, data, time)


def read_collection(path: str | os.PathLike[str]) -> list[tuple[float, str]]:
    """Read times, and names of files relative to its own, from a .pvd; see `vtk_contents`."""
    file = _File(read_bytes(path))
    if file.kind != "Collection":
        raise ValueError(f"it is VTK's {brief(file.kind)}; expected a Collection")
    found = []
    for entry in file.entries:
        word = entry.get("timestep", "")
        try:
            time = float(word)
        except ValueError:
            raise ValueError(f"a DataSet has the timestep {brief(word)}; expected a time") from None
        if not (name := entry.get("file", "")):
            raise ValueError(f"the DataSet of timestep {word} names no file")
        found.append((time, name))
    return found


class _File:
    """What a file declares, in its order; arrays are decoded when they are asked for."""

    def __init__(self, content: bytes) -> None:
        self.kind = ""
        self.pieces: list[dict[str, str]] = []
        self.arrays: dict[str, list[_Array]] = {place: [] for place in _PLACES}
        self.entries: list[dict[str, str]] = []
        self._head: dict[str, str] = {}
        self._open: list[str] = []
        self._array: dict[str, str] = {}
        self._text: list[str] = []
        self._left = most_inflated(len(content))
        self._appended, self._is_raw = b"", False
        if found := _APPENDED.search(content):
            end = content.rfind(_END)
            if end < found.end():
                raise ValueError("its appended data does not end: it may be cut off")
            self._appended = content[found.end() : end]
            content = content[: found.end()] + content[end:]
        take_events(content, self)
        order = self._head.get("byte_order", "")
        native = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
        self._order = _one_of(_ORDERS, order or native, "byte_order")
        head = _one_of(_HEADS, self._head.get("header_type", "UInt32"), "header_type")
        self._size = np.dtype(self._order + head)

    def start(self, name: str, attributes: dict[str, str]) -> None:
        if not self._open:
            if name != "VTKFile":
                raise ValueError("it is XML, but not VTK's")
            self._head, self.kind = attributes, attributes.get("type", "")
        self._open.append(name)
        if name == "Piece":
            self.pieces.append(attributes)
        elif name == "DataSet":
            self.entries.append(attributes)
        elif name == "AppendedData":
            self._is_raw = attributes.get("encoding", "base64") == "raw"
        elif name == "DataArray":
            self._array = attributes
            self._text.clear()

    def characters(self, text: str) -> None:
        if self._open[-1] == "DataArray":  # not of what VTK writes into it besides
            self._text.append(text)

    def end(self, name: str) -> None:
        self._open.pop()
        if name != "DataArray":
            return
        if (place := self.arrays.get(self._open[-1])) is not None:
            place.append(_Array(self._array, "".join(self._text)))

    def polygons(self) -> Polygons:
        """Return the polygons of the piece, those that are strips as triangles."""
        piece = self.pieces[0]
        if self.kind == "UnstructuredGrid":
            sizes, corners, types = self._cells("Cells", _whole(piece, "NumberOfCells", "0"))
            return polygons_of_cells(sizes, corners, types)
        polygons = self._cells("Polys", _whole(piece, "NumberOfPolys", "0"), POLYGON)
        strips = self._cells("Strips", _whole(piece, "NumberOfStrips", "0"), STRIP)
        return polygons_of_cells(*map(np.concatenate, zip(polygons, strips, strict=True)))

    def _cells(self, place: str, count: int, kind: int = 0) -> tuple[IntArray, IntArray, IntArray]:
        """Return sizes, corners and types of the cells in a place."""
        if count == 0:
            return (np.zeros(0, dtype=np.int64),) * 3
        named = {array.attributes.get("Name", ""): array for array in self.arrays[place]}
        if missing := {"connectivity", "offsets"} - named.keys():
            raise ValueError(f"its {place} have no array {' and no array '.join(sorted(missing))}")
        sizes = np.diff(self._whole_numbers(named["offsets"], count), prepend=0)
        if sizes.min() < 0 or sizes.max() == 0:
            raise ValueError(f"the offsets of its {place} do not increase")
        corners = self._whole_numbers(named["connectivity"], int(sizes.sum()))
        if kind == 0 and "types" not in named:
            raise ValueError(f"its {place} have no array types")
        types = np.full(count, kind) if kind else self._whole_numbers(named["types"], count)
        return sizes, corners, types

    def _whole_numbers(self, array: _Array, count: int) -> IntArray:
        found = self.values(array, count).astype(np.int64).ravel()
        if len(found) != count:
            raise ValueError(f"an array of its cells has {len(found)} numbers; expected {count}")
        return found

    def values(self, array: _Array, count: int) -> FloatArray:
        """Return an array (count, C)."""
        attributes = array.attributes
        called = brief(attributes.get("Name", ""))
        columns = _whole(attributes, "NumberOfComponents", "1")
        kind = _one_of(_TYPES, attributes.get("type", ""), "type")
        form = attributes.get("format", "ascii")
        if count < 1 or columns < 1:
            raise ValueError(f"its array {called} is empty: {count} points, {columns} components")
        size = count * columns * (8 if form == "ascii" else kind.itemsize)
        self._left -= size
        if self._left < 0:
            raise ValueError(f"its array {called} is more than a file of this size may hold")
        if form == "ascii":
            numbers = _numbers(array.text, kind)
        elif form == "binary":
            numbers = self._decoded(_Base64(array.text.encode("ascii", "replace")), size, kind)
        elif form == "appended":
            begin = _whole(attributes, "offset")
            if begin >= len(self._appended):
                raise ValueError(f"its array {called} begins behind the end of what is appended")
            data = self._appended[begin:]
            numbers = self._decoded(_Raw(data) if self._is_raw else _Base64(data), size, kind)
        else:
            raise ValueError(f"its array {called} has the format {brief(form)}; expected binary")
        if len(numbers) != count * columns:
            raise ValueError(
                f"its array {called} has {len(numbers)} numbers; expected {count * columns}"
            )
        return as_doubles(numbers).reshape(count, columns)

    def _decoded(self, data: "_Raw | _Base64", size: int, kind: np.dtype[Any]) -> NDArray[Any]:
        """Return the numbers of so many bytes that data hold behind their header."""
        width, compressor = self._size.itemsize, self._head.get("compressor", "")
        if not compressor:
            (length,) = np.frombuffer(data.header(width), self._size).tolist()
            if length != size:
                raise ValueError(f"an array says to have {length} bytes; expected {size}")
            found = data.body(width, [size])[0]
        else:
            expand = _one_of(_COMPRESSORS, compressor, "compressor")
            count, block, rest = np.frombuffer(data.header(3 * width), self._size).tolist()
            total = (count - (rest > 0)) * block + rest
            if total != size or count > min(_MOST_BLOCKS, size):
                raise ValueError(f"an array says to have {total} bytes; expected {size}")
            head = (3 + count) * width
            lengths = np.frombuffer(data.header(head), self._size)[3:].tolist()
            wholes = [block] * (count - (rest > 0)) + [rest] * (rest > 0)
            parts = data.body(head, lengths)
            found = b"".join(map(expand, parts, wholes))
        if len(found) != size:
            raise ValueError(f"an array has {len(found)} bytes; expected {size}: it may be cut off")
        return np.frombuffer(found, kind.newbyteorder(self._order))


class _Raw:
    """Bytes of an array, behind a header."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def header(self, size: int) -> bytes:
        return _whole_of(self._data[:size], size)

    def body(self, head: int, lengths: list[int]) -> list[bytes]:
        return _split(self._data, head, lengths)


class _Base64:
    """The same in base64: the header by itself, or, as others than VTK write it, in one with what
    follows.
    """

    def __init__(self, text: bytes) -> None:
        self._text = b"".join(text.split()) if text[:1].isspace() or b"\n" in text else text

    def header(self, size: int) -> bytes:
        return _whole_of(_unpacked(self._text[: _letters(size)])[:size], size)

    def body(self, head: int, lengths: list[int]) -> list[bytes]:
        letters, total = _letters(head), sum(lengths)
        is_alone = head % 3 == 0 or self._text[letters - 1 : letters] == b"="
        if is_alone:
            rest = self._text[letters : letters + _letters(total)]
            return _split(_unpacked(rest), 0, lengths)
        return _split(_unpacked(self._text[: _letters(head + total)]), head, lengths)


def _letters(size: int) -> int:
    """Return how many letters of base64 so many bytes have."""
    return 4 * -(-size // 3)


def _unpacked(text: bytes) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except ValueError as error:
        raise ValueError(f"an array in base64 is damaged or cut off: {error}") from None


def _whole_of(data: bytes, size: int) -> bytes:
    if len(data) != size:
        raise ValueError("an array is cut off: it lacks its header")
    return data


def _split(data: bytes, begin: int, lengths: list[int]) -> list[bytes]:
    parts = []
    for length in lengths:
        parts.append(data[begin : begin + length])
        begin += length
    return parts


def _unlzma(data: bytes, size: int) -> bytes:
    try:
        stream = lzma.LZMADecompressor(memlimit=1 << 28)
        found = stream.decompress(data, size + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"its compressed data is damaged: {error}") from error
    return found


_COMPRESSORS: dict[str, Expand] = {
    "vtkZLibDataCompressor": inflated,
    "vtkLZMADataCompressor": _unlzma,
}


def _numbers(text: str, kind: np.dtype[Any]) -> NDArray[Any]:
    words = text.split()
    try:
        return (
            np.array(words, dtype=np.float64) if kind.kind == "f" else np.array(words, dtype=kind)
        )
    except (ValueError, OverflowError) as error:
        raise ValueError("an array has something else than numbers of its type in it") from error


def _one_of(known: dict[str, Any], word: str, what: str) -> Any:
    if word not in known:
        raise ValueError(f"it has the {what} {brief(word)}; expected {' or '.join(known)}")
    return known[word]


def _whole(attributes: dict[str, str], name: str, default: str = "") -> int:
    text = (attributes.get(name) or default).strip()
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise ValueError(f"{name} is {brief(text)}; expected a whole number, 0 or more")
    return int(text)
