"""OFF, OBJ and STL: formats that are little more than lists of numbers."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from abfm.mesh.readers.contents import FileContents, Lists, merge_by_position, whole_number
from abfm.reading import read_bytes

_OFF_HEADER = re.compile(r"(?:ST)?C?N?OFF\b", re.IGNORECASE)
_STL_HEADER = 84  # bytes: 80 of comment, then the number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
# possessive, and blanks before it on its own line alone: the time grows with the file's length
_STL_VERTEX = re.compile(
    rb"^[^\S\n]*+vertex\s++(\S++)\s++(\S++)\s++(\S++)", re.IGNORECASE | re.MULTILINE
)


def _text(path: Path) -> str:
    """Return the text of a file, whose lines end with line feeds; what is no text is replaced."""
    content = read_bytes(path).decode("utf-8-sig", errors="replace")
    return content.replace("\r\n", "\n").replace("\r", "\n")


def read_off(path: Path) -> FileContents:
    """Read a text OFF file, also with colours, normals or texture coordinates."""
    lines = _text(path).splitlines()
    rows = (words for line in lines if (words := line.partition("#")[0].split()))
    first = next(rows, [""])
    if not _OFF_HEADER.fullmatch(first[0]):
        raise ValueError("the first line is not OFF, COFF, NOFF or STOFF")
    counts = first[1:] or next(rows, [])
    if len(counts) < 2:
        raise ValueError("the numbers of vertices and faces are missing")
    vertex_count, face_count = whole_number(counts[0]), whole_number(counts[1])
    announced = f"{vertex_count} vertices and {face_count} faces are announced"
    if min(vertex_count, face_count) < 0:
        raise ValueError(f"{announced}: give their numbers")
    lists, taken = Lists(), 0
    try:
        while taken < vertex_count + face_count:
            words = next(rows)
            taken += 1
            if taken <= vertex_count:
                lists.add_vertex(words)
                continue
            corners = whole_number(words[0])
            if not 0 <= corners < len(words):
                raise ValueError(
                    f"a face announces {corners} corners, but its line has {len(words) - 1}"
                )
            lists.add_polygon(list(map(whole_number, words[1 : 1 + corners])))
    except (StopIteration, ValueError) as error:
        taken += sum(1 for _ in rows)
        if taken >= vertex_count + face_count:
            raise
        raise ValueError(f"{announced}, but {taken} lines follow: the file is cut off") from error
    return lists.contents()


def read_obj(path: Path) -> FileContents:
    """Read a Wavefront OBJ file: one vertex per ``v`` line, whatever else the faces name."""
    lists = Lists()
    for keyword, words in obj_lines(path):
        if keyword == "v":
            lists.add_vertex(words)
        elif keyword == "f":
            lists.add_polygon([obj_index(word, lists.vertex_count) for word in words])
    return lists.contents()


def obj_lines(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Return keyword and words of each line of an OBJ or MTL file."""
    for line in _text(path).replace("\\\n", " ").splitlines():
        keyword, *words = line.partition("#")[0].split() or [""]
        yield keyword, words


def obj_index(word: str, count: int) -> int:
    """Return the index from 0 in ``vertex/texture/normal``: from 1, or back from the last one."""
    index = whole_number(word.partition("/")[0])
    if index == 0:
        raise ValueError("a face names vertex 0, but OBJ counts vertices from 1")
    return index - 1 if index > 0 else count + index


def read_stl(path: Path) -> FileContents:
    """Read the triangles of an STL file, corners at exactly the same position merged."""
    data = read_bytes(path)
    count = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
    if len(data) == _STL_HEADER + count * _STL_TRIANGLE.itemsize:
        triangles = np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEADER)
        corners = triangles["corners"].reshape(-1, 3).astype(np.float64)
    elif data.lstrip()[:5].lower() == b"solid" and b"endsolid" in data.lower():
        lists = Lists()
        for found in _STL_VERTEX.finditer(data):
            lists.add_vertex([word.decode("ascii", "replace") for word in found.groups()])
        corners = lists.vertices()
    else:
        raise ValueError(
            "it is neither a complete text file nor as long as its binary header says: it may be "
            "cut off"
        )
    if len(corners) % 3:
        raise ValueError(f"its {len(corners)} corners do not make whole triangles")
    return merge_by_position(corners, np.arange(len(corners)).reshape(-1, 3))
