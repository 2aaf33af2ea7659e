"""Stereolithography (STL), text and binary: separate triangles, joined where corners coincide."""

import re
from pathlib import Path

import numpy as np

from abfm.mesh.readers.contents import FileContents, PointList, merge_by_position
from abfm.reading import read_bytes

HEADER_LENGTH = 84  # bytes: 80 of comment, then the number of triangles
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
# possessive, and blanks before it on its own line alone: the time grows with the file's length
VERTEX = re.compile(
    rb"^[^\S\n]*+vertex\s++(\S++)\s++(\S++)\s++(\S++)", re.IGNORECASE | re.MULTILINE
)


def read_stl(path: Path) -> FileContents:
    """Read triangles of an STL file, corners at exactly the same position merged."""
    data = read_bytes(path)
    count = int.from_bytes(data[HEADER_LENGTH - 4 : HEADER_LENGTH], "little")
    if len(data) == HEADER_LENGTH + count * TRIANGLE.itemsize:
        corners = (
            np.frombuffer(data, TRIANGLE, count, HEADER_LENGTH)["corners"]
            .reshape(-1, 3)
            .astype(np.float64)
        )
    elif data.lstrip()[:5].lower() == b"solid" and b"endsolid" in data.lower():
        points = PointList()
        for found in VERTEX.finditer(data):
            points.append([word.decode("ascii", "replace") for word in found.groups()])
        corners = points.array()
    else:
        raise ValueError(
            "it is neither a complete text file nor as long as its binary header says: it may be "
            "cut off"
        )
    if len(corners) % 3:
        raise ValueError(f"its {len(corners)} corners do not make whole triangles")
    return merge_by_position(corners, np.arange(len(corners)).reshape(-1, 3))
