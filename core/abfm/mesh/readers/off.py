"""Object File Format: OFF and its relatives with colours, normals or texture coordinates (COFF, NOFF, STOFF)."""

import re
from pathlib import Path

from abfm.mesh.readers.contents import FileContents, coordinates, split_polygons

HEADER = re.compile(r"(?:ST)?C?N?OFF\b", re.IGNORECASE)


def read_off(path: Path) -> FileContents:
    """Vertices and faces of a text OFF file.

    Raises
    ------
    ValueError
        Saying what is wrong with the text.
    """
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    rows = [words for line in lines if (words := line.partition("#")[0].split())]
    if not rows or not HEADER.fullmatch(rows[0][0]):
        raise ValueError("the first line is not OFF, COFF, NOFF or STOFF")
    rows[0] = rows[0][1:]
    rows = rows if rows[0] else rows[1:]
    if not rows or len(rows[0]) < 2:
        raise ValueError("the numbers of vertices and faces are missing")
    vertex_count, face_count = int(rows[0][0]), int(rows[0][1])
    if min(vertex_count, face_count) < 0 or len(rows) < 1 + vertex_count + face_count:
        raise ValueError(
            f"{vertex_count} vertices and {face_count} faces are announced, but {len(rows) - 1} lines follow: "
            "the file is cut off"
        )
    polygons = [_polygon(words) for words in rows[1 + vertex_count : 1 + vertex_count + face_count]]
    return split_polygons(coordinates(rows[1 : 1 + vertex_count]), polygons)


def _polygon(words: list[str]) -> list[int]:
    count = int(words[0])
    if not 0 <= count < len(words):
        raise ValueError(f"a face announces {count} corners, but its line has {len(words) - 1}")
    return [int(word) for word in words[1 : 1 + count]]
