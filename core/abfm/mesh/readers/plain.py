"""OBJ and STL: formats that are little more than lists of numbers."""

import re
from collections.abc import Iterator

import numpy as np

from abfm.mesh.readers.contents import FileContents, Lists, merge_by_position
from abfm.reading import Opened, decoded, whole_number
from abfm.types import FloatArray

_HEAD = 1000  # characters in which a file of bytes has a zero
_COMMENT = re.compile(r"#.*")  # to the end of its line, also if that is a backslash
_OLD_KEYWORDS = {"fo": "f"}  # of OBJ
_STL_HEADER = 84  # bytes: 80 of comment, then the number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
# possessive, and blanks before it on its own line alone: the time grows with the file's length
_STL_VERTEX = re.compile(
    r"^[^\S\n]*+vertex\s++(\S++)\s++(\S++)\s++(\S++)", re.IGNORECASE | re.MULTILINE
)


def read_obj(opened: Opened) -> FileContents:
    """Read a Wavefront OBJ file: one vertex per ``v`` line, whatever else the faces name."""
    lists = Lists()
    for keyword, words in obj_lines(opened.data):
        if keyword == "v":
            lists.add_vertex(words)
        elif keyword == "f":
            lists.add_polygon([obj_index(word, lists.vertex_count) for word in words])
        elif keyword == "surf" and not lists.polygon_count:
            raise ValueError("it has free-form surfaces, which are not read: export polygons")
    return lists.contents()


def obj_lines(data: bytes) -> Iterator[tuple[str, list[str]]]:
    """Return the keyword, in lower case, and the words of each line of an OBJ or MTL file."""
    text = decoded(data, "replace")
    if "\0" in text[:_HEAD]:
        raise ValueError(
            "it is binary, but OBJ files and MNI objects are read as text: export text"
        )
    for line in _COMMENT.sub("", text).replace("\\\n", " ").splitlines():
        keyword, *words = line.split() or [""]
        yield _OLD_KEYWORDS.get(keyword, keyword.lower()), words


def obj_index(word: str, count: int) -> int:
    """Return the index from 0 in ``vertex/texture/normal``: from 1, or back from the last one."""
    index = whole_number(word.partition("/")[0])
    if index == 0:
        raise ValueError("a face names vertex 0, but OBJ counts vertices from 1")
    return index - 1 if index > 0 else count + index


def read_stl(opened: Opened) -> FileContents:
    """Read the triangles of an STL file, corners at exactly the same position merged."""
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
        raise ValueError(f"its {len(corners)} corners do not make whole triangles")
    merged = merge_by_position(corners, np.arange(len(corners)).reshape(-1, 3))
    return merged._replace(messages=(*messages, *merged.messages))


def _text_of_stl(data: bytes) -> str | None:
    """Return the text of a file, or None if it is binary, though its header may begin alike."""
    head = decoded(data[:_STL_HEADER], "replace")
    is_text = "\0" not in head and head.lstrip()[:5].lower() in ("solid", "")
    return decoded(data, "replace") if is_text else None


def _binary_corners(data: bytes, count: int) -> FloatArray:
    triangles = np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEADER)
    return triangles["corners"].reshape(-1, 3).astype(np.float64)


def _count_by_length(count: int, body: int) -> tuple[int, tuple[str, ...]]:
    """Return how many triangles a file has whose header does not give its length.

    If it has more bytes, by whole triangles or with no triangles announced, the header is wrong,
    as VTK and MeshLab take it; else the bytes that follow the triangles are something else.
    """
    size = _STL_TRIANGLE.itemsize
    if body < size:
        raise ValueError("it is neither text that begins with solid, nor has it a whole triangle")
    if body < count * size:
        raise ValueError(
            f"its header announces {count} triangles, but its length is that of {body // size}: it "
            "may be cut off"
        )
    if count == 0 or body % size == 0:
        note = f"its header announces {count} triangles; all {body // size} in the file were read"
        return body // size, (note,)
    return count, (f"{body - count * size} bytes after its {count} triangles were ignored",)


def _text_corners(text: str) -> tuple[FloatArray, tuple[str, ...]]:
    lists = Lists()
    end = 0
    for found in _STL_VERTEX.finditer(text):
        lists.add_vertex(found.groups())
        end = found.end()
    if "endsolid" in text[end:].lower():
        return lists.vertices(), ()
    if text.rstrip()[-8:].lower() != "endfacet":
        raise ValueError("it is text that does not end with endsolid: it may be cut off")
    note = "the file does not end with endsolid: check that no triangles are missing"
    return lists.vertices(), (note,)
