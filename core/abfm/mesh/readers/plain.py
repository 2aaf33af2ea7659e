"""Readers of OBJ and STL files."""

import re
from collections.abc import Iterator

import numpy as np

from abfm.mesh.readers.contents import FileContents, Lists, merge_by_position
from abfm.reading import Opened, decoded, integer
from abfm.types import FloatArray
from abfm.wording import counted

_HEAD = 1000  # a binary file has a zero byte in this number of characters
_COMMENT = re.compile(r"#.*")  # a comment ends with its line, even after a backslash
_OLD_KEYWORDS = {"fo": "f"}  # OBJ keywords of old files
_STL_HEADER = 84  # bytes: 80 of a comment, then the number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
# possessive quantifiers, and blanks only on the same line, make the time linear in the file size
_STL_VERTEX = re.compile(
    r"^[^\S\n]*+vertex\s++(\S++)\s++(\S++)\s++(\S++)", re.IGNORECASE | re.MULTILINE
)


def read_obj(opened: Opened) -> FileContents:
    """Read a Wavefront OBJ file with a vertex for each ``v`` line, also if no face refers to it."""
    lists = Lists()
    for keyword, words in obj_lines(opened.data):
        if keyword == "v":
            lists.add_vertex(words)
        elif keyword == "f":
            lists.add_polygon([obj_index(word, lists.vertex_count) for word in words])
        elif keyword == "surf" and not lists.polygon_count:
            raise ValueError(
                "the file has free-form surfaces, which are not supported. Export polygons"
            )
    return lists.contents()


def obj_lines(data: bytes) -> Iterator[tuple[str, list[str]]]:
    """Yield the keyword, in lower case, and the words of each line of an OBJ or MTL file."""
    text = decoded(data, "replace")
    if "\0" in text[:_HEAD]:
        raise ValueError(
            "the file is binary, but only text OBJ files and MNI objects are supported. Export text"
        )
    for line in _COMMENT.sub("", text).replace("\\\n", " ").splitlines():
        keyword, *words = line.split() or [""]
        yield _OLD_KEYWORDS.get(keyword, keyword.lower()), words


def obj_index(word: str, count: int) -> int:
    """Return the vertex index, counted from 0, of a corner such as ``vertex/texture/normal``.

    The file counts from 1, or backwards from -1, the last of ``count`` vertices.
    """
    index = integer(word.partition("/")[0])
    if index == 0:
        raise ValueError("a face refers to vertex 0, but OBJ counts vertices from 1")
    return index - 1 if index > 0 else count + index


def read_stl(opened: Opened) -> FileContents:
    """Read the triangles of an STL file; corners at exactly the same position are merged."""
    data, messages = opened.data, tuple[str, ...]()
    count = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
    body = len(data) - _STL_HEADER
    if body == count * _STL_TRIANGLE.itemsize:
        corners = _binary_corners(data, count)
    elif (text := _text_of_stl(data)) is not None:
        corners, messages = _text_corners(text)
    else:
        count, messages = _count_by_length(count, body)
        corners = _binary_corners(data, count)
    if len(corners) % 3:
        raise ValueError(
            f"the file has {len(corners)} corners of triangles; expected a multiple of 3"
        )
    merged = merge_by_position(corners, np.arange(len(corners)).reshape(-1, 3))
    return merged._replace(messages=(*messages, *merged.messages))


def _text_of_stl(data: bytes) -> str | None:
    """Return the text of an STL file; None if it is binary, even if it begins with "solid"."""
    head = decoded(data[:_STL_HEADER], "replace")
    is_text = "\0" not in head and head.lstrip()[:5].lower() in ("solid", "")
    return decoded(data, "replace") if is_text else None


def _binary_corners(data: bytes, count: int) -> FloatArray:
    triangles = np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEADER)
    return triangles["corners"].reshape(-1, 3).astype(np.float64)


def _count_by_length(count: int, body: int) -> tuple[int, tuple[str, ...]]:
    """Return the number of triangles of a binary STL file, and notes about a wrong header.

    ``count`` is the number in the header, and ``body`` the number of bytes after the header. The
    latter determines the result if the header announces no triangles, or if all bytes form complete
    triangles, as in VTK and MeshLab. Otherwise the bytes after ``count`` triangles are ignored.
    """
    size, announced = _STL_TRIANGLE.itemsize, counted(count, "triangle")
    if body < size:
        raise ValueError(
            "the file is not STL: it has no text that begins with solid, and no complete triangle"
        )
    if body < count * size:
        raise ValueError(
            f"the header announces {announced}, but the file has bytes for {body // size}; it may "
            "be cut off"
        )
    if count == 0 or body % size == 0:
        note = f"the header announces {announced}; all {body // size} in the file were read"
        return body // size, (note,)
    ignored = counted(body - count * size, "byte was", "bytes were")
    return count, (f"{ignored} ignored after {announced}",)


def _text_corners(text: str) -> tuple[FloatArray, tuple[str, ...]]:
    lists = Lists()
    end = 0
    for found in _STL_VERTEX.finditer(text):
        lists.add_vertex(found.groups())
        end = found.end()
    if "endsolid" in text[end:].lower():
        return lists.vertices(), ()
    if text.rstrip()[-8:].lower() != "endfacet":
        raise ValueError("the text does not end with endsolid; the file may be cut off")
    note = "the file does not end with endsolid. Check that no triangles are missing"
    return lists.vertices(), (note,)
