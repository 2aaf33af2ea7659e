"""Readers of XML files of VTK (.vtu, .vtp) and of collections of them (.pvd).

Format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html. Arrays are text,
base64 or raw bytes, inline or appended, and may be compressed in blocks by zlib or LZMA. Other
readers are not used. meshio is no longer maintained, fails if arrays share bytes, and decompresses
without a bound. VTK needs 570 MB, and one damaged file in thirty crashes the process.
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
from abfm.reading.regular_files import inflated, inflated_size_max, read_bytes
from abfm.reading.vtk_file import POLYGON, STRIP, PointData, Polygons, VtkFile, polygons_of_cells
from abfm.reading.xml_trees import choice_in, count_in, numbers_in, xml_tree
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
_BLOCKS_MAX = 1 << 24

Beginning = Callable[[int, int], bytes]
"""Function that takes the size of the header and the total size, and returns that many bytes."""


def xml_contents(content: bytes) -> VtkFile:
    """Read a .vtu or .vtp file; raise a ValueError for an invalid file."""
    file = _File(content)
    if file.kind not in _KINDS:
        raise ValueError(
            f"the VTK file has type {brief(file.kind)}; expected {' or '.join(_KINDS)}"
        )
    if len(file.pieces) != 1:
        raise ValueError(
            f"the file has {len(file.pieces)} pieces; expected one. Merge them in ParaView"
        )
    count = count_in(file.pieces[0], "NumberOfPoints")
    points = file.arrays("Points")
    if len(points) != 1:
        raise ValueError(f"the file has {len(points)} arrays of points; expected one")
    places = file.values(points[0], count)
    if places.shape[1] != 3:
        raise ValueError(f"the points have {places.shape[1]} coordinates; expected 3")
    data = PointData(
        (array.get("Name", ""), partial(file.values, array, count))
        for array in file.arrays("PointData")
    )
    times = [array for array in file.arrays("FieldData") if array.get("Name") == "TimeValue"]
    time = float(file.values(times[-1], 1)[0, 0]) if times else math.nan
    return VtkFile(places, file.polygons, data, time)


def read_collection(path: str | os.PathLike[str]) -> list[tuple[float, str]]:
    """Read the times and relative file names of a .pvd file; errors are those of `vtk_contents`."""
    file = _File(read_bytes(path))
    if file.kind != "Collection":
        raise ValueError(f"the VTK file has type {brief(file.kind)}; expected a Collection")
    found = []
    for entry in file.root.iter("DataSet"):
        word = entry.get("timestep", "")
        try:
            time = float(word)
        except ValueError:
            raise ValueError(
                f"the timestep of a DataSet is {brief(word)}; expected a time"
            ) from None
        if not (name := entry.get("file", "")):
            raise ValueError(f"the DataSet of timestep {word} has no file name")
        found.append((time, name))
    return found


class _File:
    """The XML tree of a VTK file; arrays are decoded on access."""

    def __init__(self, content: bytes) -> None:
        self._budget = inflated_size_max(len(content))
        self._appended = b""
        if found := _APPENDED_DATA.search(content):
            end = content.rfind(_END)
            if end < found.end():
                raise ValueError("the appended data have no end; the file may be cut off")
            self._appended = content[found.end() : end]
            content = content[: found.end()] + content[end:]
        self.root = root = xml_tree(content)
        if root.tag != "VTKFile":
            raise ValueError("the file is XML, but not a VTK file")
        self.kind, self.pieces = root.get("type", ""), [*root.iter("Piece")]
        native = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
        self._order = choice_in(root, "byte_order", _ORDERS, native)
        self._size = np.dtype(self._order + choice_in(root, "header_type", _HEADS, "UInt32"))

    def arrays(self, place: str) -> list[Element]:
        """Return all data arrays that are children of elements of the name ``place``."""
        return [array for each in self.root.iter(place) for array in each.findall("DataArray")]

    def polygons(self) -> Polygons:
        piece = self.pieces[0]
        if self.kind == "UnstructuredGrid":
            sizes, corners, types = self._cells("Cells", count_in(piece, "NumberOfCells", "0"))
            return polygons_of_cells(sizes, corners, types)
        polygons = self._cells("Polys", count_in(piece, "NumberOfPolys", "0"), POLYGON)
        strips = self._cells("Strips", count_in(piece, "NumberOfStrips", "0"), STRIP)
        return polygons_of_cells(*map(np.concatenate, zip(polygons, strips, strict=True)))

    def _cells(self, place: str, count: int, kind: int = 0) -> tuple[IntArray, IntArray, IntArray]:
        if count == 0:
            return (np.zeros(0, dtype=np.int64),) * 3
        named = {array.get("Name", ""): array for array in self.arrays(place)}
        required = {"connectivity", "offsets", *(["types"] if kind == 0 else [])}
        if missing := required - named.keys():
            raise ValueError(
                f"the element {place} has no array {' and no array '.join(sorted(missing))}"
            )
        sizes = np.diff(self._integers(named["offsets"], count), prepend=0)
        if sizes.min() < 0 or sizes.max() == 0:
            raise ValueError(f"the offsets of {place} do not increase; the file is damaged")
        corners = self._integers(named["connectivity"], int(sizes.sum()))
        types = np.full(count, kind) if kind else self._integers(named["types"], count)
        return sizes, corners, types

    def _integers(self, array: Element, count: int) -> IntArray:
        found = self.values(array, count).astype(np.int64).ravel()
        if len(found) != count:
            raise ValueError(f"an array of cells has {len(found)} numbers; expected {count}")
        return found

    def values(self, array: Element, count: int) -> FloatArray:
        """Return the numbers of a data array, shape (count, C), for ``count`` points."""
        name, form = brief(array.get("Name", "")), array.get("format", "ascii")
        columns = count_in(array, "NumberOfComponents", "1")
        kind = choice_in(array, "type", _TYPES)
        if count < 1 or columns < 1:
            raise ValueError(f"the array {name} is empty: {count} points, {columns} components")
        size = count * columns * (8 if form == "ascii" else kind.itemsize)
        self._budget -= size
        if self._budget < 0:
            raise ValueError(f"a file of this size cannot have all values of the array {name}")
        # the text of the array without the child elements that VTK writes
        text = (array.text or "") + "".join(each.tail or "" for each in array)
        if form == "ascii":
            numbers = numbers_in(text, np.dtype(np.float64) if kind.kind == "f" else kind)
        elif form == "binary":
            numbers = self._decoded(_base64(text.encode("ascii", "replace")), size, kind)
        elif form == "appended":
            begin = count_in(array, "offset")
            if begin >= len(self._appended):
                raise ValueError(
                    f"the array {name} begins after the end of the appended data; the file may be "
                    "cut off"
                )
            data, place = self._appended[begin:], self.root.find("AppendedData")
            is_raw = place is not None and place.get("encoding") == "raw"
            numbers = self._decoded(_raw(data) if is_raw else _base64(data), size, kind)
        else:
            raise ValueError(f"the array {name} has the format {brief(form)}; expected binary")
        if len(numbers) != count * columns:
            raise ValueError(
                f"the array {name} has {len(numbers)} numbers; expected {count * columns}"
            )
        return as_float64(numbers).reshape(count, columns)

    def _decoded(self, begin: Beginning, size: int, kind: np.dtype[Any]) -> NDArray[Any]:
        """Return the numbers of a binary array, which have ``size`` bytes after decompression.

        ``begin`` returns the first bytes of the array: its header, then the numbers.
        """
        count, words, lengths = 1, 1, [size]
        if compressor := self.root.get("compressor", ""):
            expand = choice_in(self.root, "compressor", _COMPRESSORS)
            count, block, rest = self._header(begin, 3)
            total = (count - (rest > 0)) * block + rest
        else:
            (total,) = self._header(begin, 1)
        if total != size or count > min(_BLOCKS_MAX, size):
            raise ValueError(f"the header of an array announces {total} bytes; expected {size}")
        if compressor:
            words = 3 + count
            lengths = self._header(begin, words)[3:]
        head = words * self._size.itemsize
        data = begin(head, head + sum(lengths))[head:]
        if compressor:
            sizes = [block] * (count - (rest > 0)) + [rest] * (rest > 0)
            ends = accumulate(lengths)
            parts = (data[end - length : end] for end, length in zip(ends, lengths, strict=True))
            data = b"".join(map(expand, parts, sizes))
        if len(data) != size:
            raise ValueError(
                f"an array has {len(data)} bytes; expected {size}. The file may be cut off"
            )
        return np.frombuffer(data, kind.newbyteorder(self._order))

    def _header(self, begin: Beginning, count: int) -> list[int]:
        size = count * self._size.itemsize
        data = begin(size, size)
        if len(data) != size:
            raise ValueError("the file is cut off: an array has no complete header")
        return [int(number) for number in np.frombuffer(data, self._size)]


def _raw(data: bytes) -> Beginning:
    return lambda head, size: data[:size]


def _base64(text: bytes) -> Beginning:
    """Return a function that decodes the first bytes of an array in base64.

    Its arguments are the sizes of the header and of all requested bytes. The header may be encoded
    separately.
    """
    text = b"".join(text.split())

    def beginning(head: int, size: int) -> bytes:
        end = _letters(head)
        if text[end - 1 : end] != b"=":
            return _unpacked(text[: _letters(size)])[:size]
        return _unpacked(text[:end]) + _unpacked(text[end : end + _letters(size - head)])

    return beginning


def _letters(size: int) -> int:
    """Return the number of base64 characters that encode ``size`` bytes."""
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
        raise ValueError(f"the compressed data are damaged: {error}") from error


_COMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "vtkZLibDataCompressor": inflated,
    "vtkLZMADataCompressor": _unlzma,
}
