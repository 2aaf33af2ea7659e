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
from itertools import accumulate
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.numerics.real_numbers import as_float64
from abfm.reading.plain_files import inflated, most_inflated, read_bytes
from abfm.reading.vtk_file import (
    POLYGON,
    STRIP,
    PointData,
    Polygons,
    VtkFile,
    polygons_of_cells,
)
from abfm.reading.xml_trees import count_in, meaning_of, numbers_in, xml_tree
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
_APPENDED_DATA = re.compile(rb"<AppendedData[^>]*>\s*_")
_END = b"</AppendedData>"
_MOST_BLOCKS = 1 << 24

Beginning = Callable[[int, int], bytes]
"""Returns the beginning of an array, by the bytes of its header and those of both."""


def xml_contents(content: bytes) -> VtkFile:
    """Read a .vtu or .vtp file; a ValueError reports what is wrong with it."""
    file = _File(content)
    if file.kind not in _KINDS:
        raise ValueError(f"it is VTK's {brief(file.kind)}; expected {' or '.join(_KINDS)}")
    if len(file.pieces) != 1:
        raise ValueError(f"it has {len(file.pieces)} pieces; expected one: merge them in ParaView")
    count = count_in(file.pieces[0], "NumberOfPoints")
    points = file.arrays("Points")
    if len(points) != 1:
        raise ValueError(f"it has {len(points)} arrays of points; expected one")
    places = file.values(points[0], count)
    if places.shape[1] != 3:
        raise ValueError(f"its points have {places.shape[1]} coordinates; expected 3")
    data = PointData(
        (array.get("Name", ""), partial(file.values, array, count))
        for array in file.arrays("PointData")
    )
    times = [array for array in file.arrays("FieldData") if array.get("Name") == "TimeValue"]
    time = float(file.values(times[-1], 1)[0, 0]) if times else math.nan
    return VtkFile(places, file.polygons, data, time)


def read_collection(path: str | os.PathLike[str]) -> list[tuple[float, str]]:
    """Read times, and names of files relative to its own, from a .pvd; see `vtk_contents`."""
    file = _File(read_bytes(path))
    if file.kind != "Collection":
        raise ValueError(f"it is VTK's {brief(file.kind)}; expected a Collection")
    found = []
    for entry in file.root.iter("DataSet"):
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
    """The tree of a file, whose arrays are decoded when they are looked up."""

    def __init__(self, content: bytes) -> None:
        self._left = most_inflated(len(content))
        self._appended = b""
        if found := _APPENDED_DATA.search(content):
            end = content.rfind(_END)
            if end < found.end():
                raise ValueError("its appended data does not end: it may be cut off")
            self._appended = content[found.end() : end]
            content = content[: found.end()] + content[end:]
        self.root = root = xml_tree(content)
        if root.tag != "VTKFile":
            raise ValueError("it is XML, but not VTK's")
        self.kind, self.pieces = root.get("type", ""), [*root.iter("Piece")]
        native = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
        self._order = meaning_of(root, "byte_order", _ORDERS, native)
        self._size = np.dtype(self._order + meaning_of(root, "header_type", _HEADS, "UInt32"))

    def arrays(self, place: str) -> list[Element]:
        """Return the data arrays directly inside elements of a name."""
        return [array for each in self.root.iter(place) for array in each.findall("DataArray")]

    def polygons(self) -> Polygons:
        """Return the polygons of the piece, those that are strips as triangles."""
        piece = self.pieces[0]
        if self.kind == "UnstructuredGrid":
            sizes, corners, types = self._cells("Cells", count_in(piece, "NumberOfCells", "0"))
            return polygons_of_cells(sizes, corners, types)
        polygons = self._cells("Polys", count_in(piece, "NumberOfPolys", "0"), POLYGON)
        strips = self._cells("Strips", count_in(piece, "NumberOfStrips", "0"), STRIP)
        return polygons_of_cells(*map(np.concatenate, zip(polygons, strips, strict=True)))

    def _cells(self, place: str, count: int, kind: int = 0) -> tuple[IntArray, IntArray, IntArray]:
        """Return sizes, corners and types of the cells in a place."""
        if count == 0:
            return (np.zeros(0, dtype=np.int64),) * 3
        named = {array.get("Name", ""): array for array in self.arrays(place)}
        needed = {"connectivity", "offsets", *(["types"] if kind == 0 else [])}
        if missing := needed - named.keys():
            raise ValueError(f"its {place} have no array {' and no array '.join(sorted(missing))}")
        sizes = np.diff(self._whole_numbers(named["offsets"], count), prepend=0)
        if sizes.min() < 0 or sizes.max() == 0:
            raise ValueError(f"the offsets of its {place} do not increase")
        corners = self._whole_numbers(named["connectivity"], int(sizes.sum()))
        types = np.full(count, kind) if kind else self._whole_numbers(named["types"], count)
        return sizes, corners, types

    def _whole_numbers(self, array: Element, count: int) -> IntArray:
        found = self.values(array, count).astype(np.int64).ravel()
        if len(found) != count:
            raise ValueError(f"an array of its cells has {len(found)} numbers; expected {count}")
        return found

    def values(self, array: Element, count: int) -> FloatArray:
        """Return an array (count, C)."""
        called, form = brief(array.get("Name", "")), array.get("format", "ascii")
        columns = count_in(array, "NumberOfComponents", "1")
        kind = meaning_of(array, "type", _TYPES)
        if count < 1 or columns < 1:
            raise ValueError(f"its array {called} is empty: {count} points, {columns} components")
        size = count * columns * (8 if form == "ascii" else kind.itemsize)
        self._left -= size
        if self._left < 0:
            raise ValueError(f"its array {called} is more than a file of this size may hold")
        # without what VTK writes into it besides
        text = (array.text or "") + "".join(each.tail or "" for each in array)
        if form == "ascii":
            numbers = numbers_in(text, np.dtype(np.float64) if kind.kind == "f" else kind)
        elif form == "binary":
            numbers = self._decoded(_base64(text.encode("ascii", "replace")), size, kind)
        elif form == "appended":
            begin = count_in(array, "offset")
            if begin >= len(self._appended):
                raise ValueError(f"its array {called} begins behind the end of what is appended")
            data, place = self._appended[begin:], self.root.find("AppendedData")
            is_raw = place is not None and place.get("encoding") == "raw"
            numbers = self._decoded(_raw(data) if is_raw else _base64(data), size, kind)
        else:
            raise ValueError(f"its array {called} has the format {brief(form)}; expected binary")
        if len(numbers) != count * columns:
            raise ValueError(
                f"its array {called} has {len(numbers)} numbers; expected {count * columns}"
            )
        return as_float64(numbers).reshape(count, columns)

    def _decoded(self, begin: Beginning, size: int, kind: np.dtype[Any]) -> NDArray[Any]:
        """Return the numbers of so many bytes that follow the header of an array."""
        count, words, lengths = 1, 1, [size]
        if compressor := self.root.get("compressor", ""):
            expand = meaning_of(self.root, "compressor", _COMPRESSORS)
            count, block, rest = self._header(begin, 3)
            total = (count - (rest > 0)) * block + rest
        else:
            (total,) = self._header(begin, 1)
        if total != size or count > min(_MOST_BLOCKS, size):
            raise ValueError(f"an array says to have {total} bytes; expected {size}")
        if compressor:
            words = 3 + count
            lengths = self._header(begin, words)[3:]
        head = words * self._size.itemsize
        data = begin(head, head + sum(lengths))[head:]
        if compressor:
            wholes = [block] * (count - (rest > 0)) + [rest] * (rest > 0)
            ends = accumulate(lengths)
            parts = (data[end - length : end] for end, length in zip(ends, lengths, strict=True))
            data = b"".join(map(expand, parts, wholes))
        if len(data) != size:
            raise ValueError(f"an array has {len(data)} bytes; expected {size}: it may be cut off")
        return np.frombuffer(data, kind.newbyteorder(self._order))

    def _header(self, begin: Beginning, count: int) -> list[int]:
        size = count * self._size.itemsize
        data = begin(size, size)
        if len(data) != size:
            raise ValueError("an array is cut off: it lacks its header")
        return [int(number) for number in np.frombuffer(data, self._size)]


def _raw(data: bytes) -> Beginning:
    return lambda head, size: data[:size]


def _base64(text: bytes) -> Beginning:
    """Return the beginning of what base64 holds, in which the header may be encoded by itself."""
    text = b"".join(text.split())

    def beginning(head: int, size: int) -> bytes:
        end = _letters(head)
        if text[end - 1 : end] != b"=":
            return _unpacked(text[: _letters(size)])[:size]
        return _unpacked(text[:end]) + _unpacked(text[end : end + _letters(size - head)])

    return beginning


def _letters(size: int) -> int:
    """Return how many letters of base64 so many bytes have."""
    return 4 * -(-size // 3)


def _unpacked(text: bytes) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except ValueError as error:
        raise ValueError(f"an array in base64 is damaged or cut off: {error}") from None


def _unlzma(data: bytes, size: int) -> bytes:
    try:
        return lzma.LZMADecompressor(memlimit=1 << 28).decompress(data, size + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"its compressed data is damaged: {error}") from error


_COMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "vtkZLibDataCompressor": inflated,
    "vtkLZMADataCompressor": _unlzma,
}
