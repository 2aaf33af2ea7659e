"""Object File Format: OFF and its relatives with colours, normals or texture coordinates (COFF,
NOFF, STOFF).
"""

import re
from collections.abc import Iterator
from pathlib import Path

from abfm.mesh.readers.contents import FileContents, PointList, PolygonList, text, whole_number
from abfm.mesh.readers.polygons import split_polygons
from abfm.reading import read_bytes

HEADER = re.compile(r"(?:ST)?C?N?OFF\b", re.IGNORECASE)


def read_off(path: Path) -> FileContents:
    """Read vertices and faces of a text OFF file."""
    rows = _rows(text(read_bytes(path)))
    first = next(rows, [""])
    if not HEADER.fullmatch(first[0]):
        raise ValueError("the first line is not OFF, COFF, NOFF or STOFF")
    counts = first[1:] or next(rows, [])
    if len(counts) < 2:
        raise ValueError("the numbers of vertices and faces are missing")
    vertex_count, face_count = whole_number(counts[0]), whole_number(counts[1])
    if min(vertex_count, face_count) < 0:
        raise ValueError(
            f"{vertex_count} vertices and {face_count} faces are announced: give their numbers"
        )
    points, polygons, lines = PointList(), PolygonList(), 0
    try:
        while lines < vertex_count + face_count:
            words = next(rows)
            lines += 1
            if lines <= vertex_count:
                points.append(words)
            else:
                polygons.append(_polygon(words))
    except (StopIteration, ValueError) as error:
        lines += sum(1 for _ in rows)
        if lines >= vertex_count + face_count:
            raise
        raise ValueError(
            f"{vertex_count} vertices and {face_count} faces are announced, but {lines} lines "
            "follow: the file is cut off"
        ) from error
    return split_polygons(points.array(), *polygons.arrays())


def _rows(content: str) -> Iterator[list[str]]:
    """Return the words of the lines that have any."""
    for line in content.splitlines():
        if words := line.partition("#")[0].split():
            yield words


def _polygon(words: list[str]) -> list[int]:
    count = whole_number(words[0])
    if not 0 <= count < len(words):
        raise ValueError(f"a face announces {count} corners, but its line has {len(words) - 1}")
    return list(map(whole_number, words[1 : 1 + count]))
