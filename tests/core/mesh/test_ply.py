"""PLY headers in all their spellings, and what is not taken for numbers of vertices."""

import struct

import pytest

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from tests.mesh_writers import ply_bytes, write
from tests.shapes import tetrahedron

HEADER = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
TEXT = HEADER + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def text(old, new):
    assert old in TEXT
    return TEXT.replace(old, new)


def binary(end, order="little", name=b"end_header"):
    """The first byte of what follows the header is that of a line feed."""
    header = HEADER.replace(b"ascii", f"binary_{order}_endian".encode()).replace(b"\n", end)
    header = header.replace(b"end_header", name).replace(b"float", b"double")
    sign = "<" if order == "little" else ">"
    first = struct.unpack(f"{sign}d", b"\x0a" * 8)[0]
    rows = [struct.pack(f"{sign}3d", *row) for row in ((first, 0, 0), (1, 0, 0), (0, 1, 0))]
    return header + b"".join(rows) + struct.pack(f"{sign}B3i", 3, 0, 1, 2)


ACCEPTED = {
    "CRLF": text(b"\n", b"\r\n"),
    "CR": text(b"\n", b"\r"),
    "binary": binary(b"\n"),
    "binary CRLF": binary(b"\r\n"),
    "binary CR": binary(b"\r", "big"),
    "words after the end": text(b"end_header", b"end_header made by hand"),
    "blanks after the end": binary(b"\n", name=b"end_header  "),
    "a comment that names the end": text(b"1.0\n", b"1.0\ncomment end_header follows\n"),
    "a comment of the end alone": binary(b"\n").replace(
        b"element face", b"comment\ncomment end_header\nelement face"
    ),
    "comments in the body": text(b"0 0 0\n", b"comment a\n0 0 0\n").replace(
        b"0 1 0\n", b"comment 9 9 9\n0 1 0\n"
    )
    + b"comment\n",
    "a blank before": text(b"element face 1", b"  element  face 1"),
    "lists elsewhere": text(b"element face", b"property list uchar float w\nelement face")
    .replace(b"0 0 0\n", b"0 0 0 0\n", 1)
    .replace(b"1 0 0\n0 1 0\n", b"1 0 0 2 7 7\n0 1 0 1 5\n"),
    "another element without columns": text(
        b"element face 1", b"element nothing 1000000000000\nelement face 1"
    ),
}


@pytest.mark.parametrize("content", ACCEPTED.values(), ids=ACCEPTED)
def test_accepted(tmp_path, content):
    mesh = load_mesh(write(tmp_path, "a.ply", content))
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert mesh.vertices[1:].tolist() == [[1, 0, 0], [0, 1, 0]]


BIG = ply_bytes(tetrahedron().vertices, tetrahedron().faces.tolist(), "binary_big_endian")
REFUSED = {
    "float indices": (text(b"uchar int", b"uchar float"), "of type float"),
    "double indices": (BIG.replace(b"uchar int", b"uchar float"), "numbers of type float"),
    "float lengths": (text(b"uchar", b"float"), "a length of type"),
    "fractional index": (text(b"3 0 1 2", b"3 0 1 1.5"), "1.5 where a whole number is"),
    "no list": (text(b"list uchar int", b"int"), "no list property"),
    "x is a list": (text(b"float x", b"list uchar float x"), "no property"),
    "negative length": (
        text(b"uchar", b"char").replace(b"3 0 1 2", b"-3 0 1 2"),
        "a list has the length -3",
    ),
    "too long a list": (text(b"3 0 1 2", b"200 0 1 2"), "cut off: it has fewer rows of face"),
    "a list beyond all bytes": (
        BIG.replace(b"element face", b"property list uint64 char q\nelement face").replace(
            b"end_header\n", b"end_header\n" + bytes(24) + b"\xff" * 8
        ),
        "cut off: it has fewer rows of vertex",
    ),
    "too many rows": (text(b"face 1", b"face 1000000000000"), "cut off"),
    "rows of nothing": (
        b"ply\nformat ascii 1.0\nelement vertex 1000000000000\nend_header\n",
        "no property",
    ),
    "negative rows": (text(b"vertex 3", b"vertex -3"), "does not know: element vertex -3"),
    "two corners": (text(b"3 0 1 2", b"2 0 1"), "face 0, counting from 0, has 2 corners"),
    "a large index": (
        text(b"3 0 1 2", b"3 0 1 99999999999999999999"),
        r"1e\+20 where a whole number is .* at most 16 digits",
    ),
    "no end": (text(b"end_header", b"comment end_header"), "begin with a PLY header"),
    "a long word": (text(b"ascii", b"a" * 10**5), "its format is a{40},"),
}


@pytest.mark.parametrize(("content", "message"), REFUSED.values(), ids=REFUSED)
def test_refused(tmp_path, content, message):
    with pytest.raises(MeshError, match=message) as caught:
        load_mesh(write(tmp_path, "a.ply", content))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
