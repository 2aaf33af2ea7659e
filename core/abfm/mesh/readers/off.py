"""Reader of OFF files, as written by Geomview, MeshLab and others.

Format: http://www.geomview.org/docs/html/OFF.html. Lines may break between any words. Normals,
colours and texture coordinates of a vertex follow its coordinates.
"""

import re
import struct
from array import array
from collections.abc import Iterator
from itertools import islice

import numpy as np

from abfm.mesh.readers.contents import FileContents, Lists, split_polygons
from abfm.reading import Opened, Words, decoded, integer, number, split_lists
from abfm.types import FloatArray, IntArray
from abfm.wording import counted

_HEADER = re.compile(r"\s*+((?:ST|[CN4])*)OFF", re.IGNORECASE)
_ANY_DIMENSION = re.compile(r"\s*+(?:ST|[CN4])*nOFF")
_BINARY = re.compile(rb"\s*+((?:ST|[CN4])*)OFF\s+BINARY[^\n]*+\n", re.IGNORECASE)
_COMMENT = re.compile(r"#[^\n]*+")
_EDGES = re.compile(r"[^\S\n]*+\S++|\s*+\d++[^\S\n]*+(?=\n)")  # count of edges after the others
_NORMAL_COLUMNS = 3
_COLOR_COLUMNS = (4, 3)  # numbers of a colour with and without opacity
_TEXTURE_COLUMNS = 2

_Parts = tuple[FloatArray, IntArray, IntArray]
"""Points, numbers of corners of the faces, and their concatenated corners."""


def read_off(opened: Opened) -> FileContents:
    """Read an OFF file, text or binary, also with colours, normals or texture coordinates."""
    if binary := _BINARY.match(opened.data):
        return _read_binary(opened.data, binary.end(), binary[1].decode().upper())
    text = decoded(opened.data, "replace")
    text = _COMMENT.sub("", text) if "#" in text else text
    if _ANY_DIMENSION.match(text):
        raise ValueError(
            "the file is nOFF, with points of any dimension; expected OFF with points of three "
            "dimensions"
        )
    header = _HEADER.match(text)
    if header is None and not text.lstrip()[:1].isdigit():
        raise ValueError(
            "the file does not begin with OFF or with its numbers of vertices and faces"
        )
    prefix, begin = (header[1].upper(), header.end()) if header else ("", 0)
    words = Words(text, begin)
    counts = words.count("vertices"), words.count("faces")
    edges = _EDGES.match(text, words.place)
    return _Text(text, edges.end() if edges else words.place, prefix, counts).contents()


class _Text:
    """The vertices and faces of a text file, from the position ``begin``.

    Usually each line is one vertex or face, but lines may break anywhere. Both layouts are tried.
    """

    def __init__(self, text: str, begin: int, prefix: str, counts: tuple[int, int]) -> None:
        self._text, self._begin = text, begin
        self._vertex_count, self._face_count = counts
        self._columns, self._width_min, self._widths = _layout(prefix)

    def contents(self) -> FileContents:
        found, reason, is_sure = None, None, False
        try:
            found, end = self._by_lines(self._width_min)
            is_sure = self._fits(*found) or not self._text[end:].strip()
        except ValueError as error:
            reason = self._cut_off() or error
        for width in () if is_sure else self._widths:
            try:
                other = self._by_words(width)
            except ValueError:
                continue
            if self._fits(*other):
                return _contents(*other)
        if reason is not None and self._width_min > self._columns:
            try:  # the colours or normals of the header may be missing
                found, _ = self._by_lines(self._columns)
            except ValueError as error:
                reason = self._cut_off() or error
        if found is None:
            raise reason or ValueError("the file has no vertices")
        return _contents(*found)

    def _fits(self, points: FloatArray, sizes: IntArray, corners: IntArray) -> bool:
        """Return whether all faces have three or more corners, which are existing vertices."""
        smallest, largest = corners.min(initial=0), corners.max(initial=-1)
        return bool(sizes.min(initial=3) >= 3 and smallest >= 0 and largest < len(points))

    def _cut_off(self) -> ValueError | None:
        """Return an error if there are fewer lines than vertices and faces; None otherwise."""
        expected = self._vertex_count + self._face_count
        found = sum(1 for _ in islice(_Rows(self._text, self._begin), expected))
        if found == expected:
            return None
        return ValueError(
            f"the file is cut off: it announces {self._vertex_count} vertices and "
            f"{self._face_count} faces, but only {counted(found, 'line follows', 'lines follow')}"
        )

    def _by_lines(self, width_min: int) -> tuple[_Parts, int]:
        """Read points, sizes and corners, with one vertex or face on each line.

        Vertices have ``width_min`` or more numbers. Also return the position after the last line.
        """
        points, rows = array("d"), _Rows(self._text, self._begin)
        for words in islice(rows, self._vertex_count):
            if len(words) < width_min:
                raise ValueError(
                    f"vertex {len(points) // self._columns}, counting from 0, has "
                    f"{counted(len(words), 'number')}; expected {width_min}"
                )
            points.extend(map(number, words[: self._columns]))
        if len(points) < self._vertex_count * self._columns:
            raise ValueError("the file is cut off: vertices are missing")
        places = np.frombuffer(points, np.float64).reshape(-1, self._columns)
        sizes, corners, end = self._faces_by_lines(rows.end)
        return (places, sizes, corners), end

    def _faces_by_lines(self, begin: int) -> tuple[IntArray, IntArray, int]:
        """Read faces, one on each line with an optional colour, from the position ``begin``.

        Return their numbers of corners, the concatenated corners, and the position after the faces.
        """
        lists, rows = Lists(), _Rows(self._text, begin)
        for words in islice(rows, self._face_count):
            corners = integer(words[0])
            if not 0 <= corners < len(words):
                raise ValueError(
                    f"face {lists.polygon_count}, counting from 0, announces {corners} corners, "
                    f"but its line has {len(words) - 1}"
                )
            lists.add_polygon(list(map(integer, words[1 : 1 + corners])))
        sizes, corners_of_all = lists.polygons()
        if len(sizes) < self._face_count:
            raise ValueError("the file is cut off: faces are missing")
        return sizes, corners_of_all, rows.end

    def _by_words(self, width: int) -> _Parts:
        """Read points, sizes and corners, regardless of lines; a vertex has ``width`` numbers."""
        words = Words(self._text, self._begin)
        numbers = words.numbers(self._vertex_count * width, "the list of vertices")
        table = numbers.reshape(-1, width)[:, : self._columns]
        try:
            return table, *self._faces_by_lines(words.place)[:2]
        except ValueError:
            return table, *split_lists(words.integers(None, "faces"), self._face_count)


def _layout(prefix: str) -> tuple[int, int, tuple[int, ...]]:
    """Return the layout of a vertex by the letters before OFF, such as "CN".

    It is the number of coordinates, the least number of columns, and all possible numbers of
    columns, since colours have several forms.
    """
    columns = 4 if "4" in prefix else 3
    width = columns + _NORMAL_COLUMNS * ("N" in prefix) + _TEXTURE_COLUMNS * ("ST" in prefix)
    widths = tuple(width + color for color in _COLOR_COLUMNS) if "C" in prefix else (width,)
    return columns, min(widths), widths


def _contents(points: FloatArray, sizes: IntArray, corners: IntArray) -> FileContents:
    """Return the contents with these polygons; 4D points are divided by their last coordinate."""
    if points.shape[1] == 4:
        if (points[:, 3] == 0).any():
            raise ValueError("a point has the fourth coordinate 0; expected no points at infinity")
        points = points[:, :3] / points[:, 3:]
    return split_polygons(np.ascontiguousarray(points[:, :3]), sizes, corners)


class _Rows:
    def __init__(self, text: str, begin: int) -> None:
        self._text, self.end = text, begin
        """The end of the last line that was returned."""

    def __iter__(self) -> Iterator[list[str]]:
        text, begin = self._text, self.end
        while begin < len(text):
            end = text.find("\n", begin)
            end = len(text) if end < 0 else end
            if words := text[begin:end].split():
                self.end = end
                yield words
            begin = end + 1


def _read_binary(data: bytes, begin: int, prefix: str) -> FileContents:
    """Read a binary file of big-endian numbers: vertices, then corners and colours of faces."""
    columns, _, (width, *_) = _layout(prefix)
    try:
        vertex_count, face_count, _ = struct.unpack_from(">3i", data, begin)
        if min(vertex_count, face_count) < 0:
            raise ValueError(
                f"the file announces {vertex_count} vertices and {face_count} faces; expected "
                "positive numbers"
            )
        begin += 12
        if vertex_count * width * 4 > len(data) - begin:
            raise ValueError("the file is cut off: vertices are missing")
        table = np.frombuffer(data, ">f4", vertex_count * width, begin).reshape(-1, width)
        begin += 4 * table.size
        lists = Lists()
        for _ in range(face_count):
            (size,) = struct.unpack_from(">i", data, begin)
            lists.add_polygon(struct.unpack_from(f">{max(size, 0)}i", data, begin + 4))
            begin += 4 * (1 + max(size, 0))
            (color,) = struct.unpack_from(">i", data, begin)
            begin += 4 * (1 + max(color, 0))
        if begin > len(data):
            raise ValueError("the file is cut off: a colour is missing")
    except struct.error:
        raise ValueError("the file is cut off: faces are missing") from None
    return _contents(table[:, :columns].astype(np.float64), *lists.polygons())
