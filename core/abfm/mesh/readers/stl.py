"""Stereolithography (STL), text and binary: separate triangles, joined where corners coincide."""

import re
from pathlib import Path

import numpy as np

from abfm.mesh.readers.contents import FileContents, coordinates, merge_by_position

HEADER_LENGTH = 84  # bytes: 80 of comment, then the number of triangles
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE | re.MULTILINE)


def read_stl(path: Path) -> FileContents:
    """Triangles of an STL file, corners at exactly the same position merged.

    Raises
    ------
    ValueError
        If the file is cut off or not STL.
    """
    data = path.read_bytes()
    count = int.from_bytes(data[HEADER_LENGTH - 4 : HEADER_LENGTH], "little")
    if len(data) == HEADER_LENGTH + count * TRIANGLE.itemsize:
        corners = np.frombuffer(data, TRIANGLE, count, HEADER_LENGTH)["corners"].reshape(-1, 3).astype(np.float64)
    elif data.lstrip()[:5].lower() == b"solid" and b"endsolid" in data.lower():
        corners = coordinates([[word.decode("ascii", "replace") for word in words] for words in VERTEX.findall(data)])
    else:
        raise ValueError("it is neither a complete text file nor as long as its binary header says: it may be cut off")
    if len(corners) % 3:
        raise ValueError(f"its {len(corners)} corners do not make whole triangles")
    return merge_by_position(corners, np.arange(len(corners)).reshape(-1, 3))
