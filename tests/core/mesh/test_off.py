"""OFF files as written by different programs, and errors for invalid ones."""

import struct

import pytest

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from tests.mesh_writers import write
from tests.messages import raises

POINTS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 2]]
POLYGONS = [[0, 3, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]  # a pyramid
TRIANGLES = [[0, 3, 2], [0, 2, 1], *POLYGONS[1:]]
NORMAL, COLOR, RGB, TEXTURE = "0 0 1", "255 0 0 255", "0.5 0 0", "0.25 0.75"


def off(prefix="", more="", counts="5 5 8", face_end="", scale=1, joint="\n"):
    """Return the lines of a pyramid with additional columns of vertices and faces."""
    points = [f"{x * scale} {y * scale} {z * scale} {more}".strip() for x, y, z in POINTS]
    faces = [" ".join(map(str, [len(polygon), *polygon])) + face_end for polygon in POLYGONS]
    return joint.join([f"{prefix}OFF", counts, *points, *faces]) + "\n"


PLAIN_OFF = off()
WORDS = PLAIN_OFF.split()
SPELLINGS = {
    "plain": PLAIN_OFF,
    "counts behind the keyword": PLAIN_OFF.replace("OFF\n", "OFF "),
    "counts in the keyword": PLAIN_OFF.replace("OFF\n", "OFF"),
    "counts on three lines": off(counts="5\n5\n8"),
    "no number of edges": off(counts="5 5"),
    "no header": PLAIN_OFF.removeprefix("OFF\n"),
    "small letters": PLAIN_OFF.lower(),
    "comments": "# made\n" + PLAIN_OFF.replace("5 5 8", "5 5 8 # counts\n\n# vertices"),
    "a word a line": "\n".join(WORDS),
    "one line": " ".join(WORDS),
    "faces on one line": PLAIN_OFF.replace("\n4 0", "\n4 0")
    .replace("1\n3", "1 3")
    .replace("4\n3", "4 3"),
    "wrapped vertices, coloured faces": off(face_end=" 255 0 0").replace("1 0 0\n", "1\n0 0\n"),
    "colours of faces": off(face_end=" 0.5 0.25 1 1"),
    "number of a colour of some faces": PLAIN_OFF.replace("4 0 3 2 1", "4 0 3 2 1 7"),
    "edges behind the faces": PLAIN_OFF + "2 0 1\n",
    "exponents of Fortran": PLAIN_OFF.replace("0 0 2", "0.0D+00 0 2.0d0"),
    "line ends of Windows": PLAIN_OFF.replace("\n", "\r\n"),
    "line ends of old Macs": PLAIN_OFF.replace("\n", "\r"),
    "byte order mark": b"\xef\xbb\xbf" + PLAIN_OFF.encode(),
    "UTF-16": PLAIN_OFF.encode("utf-16"),
    "UTF-16 without a mark": PLAIN_OFF.encode("utf-16-be"),
    "4OFF": off("4", "2", scale=2),
    "4OFF, wrapped": off("4", "2", scale=2, joint=" "),
    **{
        f"{prefix}OFF{how}": off(prefix, " ".join(more), joint=joint)
        for how, joint in (("", "\n"), (" on one line", " "))
        for prefix, more in {
            "C": [COLOR],
            "N": [NORMAL],
            "ST": [TEXTURE],
            "CN": [COLOR, NORMAL],
            "NC": [NORMAL, COLOR],
            "NST": [NORMAL, TEXTURE],
            "CST": [COLOR, TEXTURE],
            "NCST": [NORMAL, COLOR, TEXTURE],
            "STCN": [NORMAL, COLOR, TEXTURE],
        }.items()
    },
    "COFF without opacity": off("C", RGB),
    "COFF without opacity on one line": off("C", RGB, joint=" "),
    "COFF without colours": off("C"),
}


@pytest.mark.parametrize("content", SPELLINGS.values(), ids=SPELLINGS)
def test_off_variants_give_the_same_mesh(tmp_path, content):
    mesh = load_mesh(write(tmp_path, "a.off", content))
    assert mesh.vertices.tolist() == POINTS
    assert mesh.faces.tolist() == TRIANGLES


@pytest.mark.parametrize(("prefix", "more"), [("", 0), ("N", 3), ("C", 4), ("STCN", 9), ("4", 1)])
def test_binary_off_is_read(tmp_path, prefix, more):
    content = f"{prefix}OFF BINARY\n".encode() + struct.pack(">3i", 5, 5, 8)
    content += b"".join(struct.pack(f">{3 + more}f", *point, *[1] * more) for point in POINTS)
    for number, polygon in enumerate(POLYGONS):
        content += struct.pack(f">{1 + len(polygon)}i", len(polygon), *polygon)
        content += struct.pack(f">i{number}f", number, *[0.5] * number)  # colours
    mesh = load_mesh(write(tmp_path, "a.off", content))
    assert mesh.vertices.tolist() == POINTS
    assert mesh.faces.tolist() == TRIANGLES
    for end in range(len(content) - 24, len(content)):
        with raises(MeshError):
            load_mesh(write(tmp_path, "a.off", content[:end]))


REFUSED = {
    "decimal commas": (PLAIN_OFF.replace("0 0 2", "0,5 0 2"), ("0,5", "decimal")),
    "any dimension": ("nOFF\n3\n" + PLAIN_OFF.removeprefix("OFF\n"), ("nOFF",)),
    "at infinity": (off("4", "0"), (0,)),
    "an edge as a face": (PLAIN_OFF.replace("3 0 1 4", "2 0 1"), (1, 2)),
    "cut off": (PLAIN_OFF[:-8], (5, 9)),
    "words cut off": (" ".join(WORDS[:-2]), ()),
    "beyond": (PLAIN_OFF.replace("3 0 1 4", "3 0 1 5"), (5,)),
}


@pytest.mark.parametrize(("content", "named"), REFUSED.values(), ids=REFUSED)
def test_invalid_off_is_refused(tmp_path, content, named):
    with raises(MeshError, *named):
        load_mesh(write(tmp_path, "a.off", content))
