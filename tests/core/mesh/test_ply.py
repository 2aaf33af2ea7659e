"""PLY headers in all their spellings, and what is not taken for numbers of vertices."""

import struct

import pytest

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from tests.mesh_writers import ply_bytes, write
from tests.shapes import tetrahedron

HEADER = (
    *("ply", "format ascii 1.0", "element vertex 3"),
    *("property float x", "property float y", "property float z"),
    *("element face 1", "property list uchar int vertex_indices", "end_header"),
)
ROWS = ("0 0 0", "1 0 0", "0 1 0", "3 0 1 2")


def text(header=HEADER, rows=ROWS, end="\n"):
    return end.join([*header, *rows, ""]).encode()


def changed(old, new, header=HEADER):
    return [new if line == old else line for line in header]


def binary(end, order="little", name="end_header"):
    """The first byte of what follows the header is that of a line feed."""
    header = end.join([*changed("format ascii 1.0", f"format binary_{order}_endian 1.0"), ""])
    header = header.replace("end_header", name).replace("float", "double")
    sign = "<" if order == "little" else ">"
    first = struct.unpack(f"{sign}d", b"\x0a" * 8)[0]
    rows = [struct.pack(f"{sign}3d", *row) for row in ((first, 0, 0), (1, 0, 0), (0, 1, 0))]
    return header.encode() + b"".join(rows) + struct.pack(f"{sign}B3i", 3, 0, 1, 2)


ACCEPTED = {
    "CRLF": text(end="\r\n"),
    "CR": text(end="\r"),
    "binary": binary("\n"),
    "binary CRLF": binary("\r\n"),
    "binary CR": binary("\r", "big"),
    "words after the end": text(changed("end_header", "end_header made by hand")),
    "blanks after the end": binary("\n", name="end_header  "),
    "a comment that names the end": text(
        changed("format ascii 1.0", "format ascii 1.0\ncomment end_header follows")
    ),
    "a comment of the end alone": binary("\n").replace(
        b"element face", b"comment\ncomment end_header\nelement face"
    ),
    "comments in the body": text(
        rows=("comment a", *ROWS[:2], "comment 9 9 9", *ROWS[2:], "comment")
    ),
    "a blank before": text(changed("element face 1", "  element  face 1")),
    "lists elsewhere": text(
        changed("element face 1", "property list uchar float w\nelement face 1"),
        ("0 0 0 0", "1 0 0 2 7 7", "0 1 0 1 5", "3 0 1 2"),
    ),
    "another element without columns": text(
        changed("element face 1", "element nothing 1000000000000\nelement face 1")
    ),
}


@pytest.mark.parametrize("content", ACCEPTED.values(), ids=ACCEPTED)
def test_accepted(tmp_path, content):
    mesh = load_mesh(write(tmp_path, "a.ply", content))
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert mesh.vertices[1:].tolist() == [[1, 0, 0], [0, 1, 0]]


FACES, FORMAT = "property list uchar int vertex_indices", "format ascii 1.0"
MANY = "1000000000000"
BIG = ply_bytes(tetrahedron().vertices, tetrahedron().faces.tolist(), "binary_big_endian")
REFUSED = {
    "float indices": (text(changed(FACES, FACES.replace("int ", "float "))), "of type float"),
    "double indices": (BIG.replace(b"uchar int", b"uchar float"), "numbers of type float"),
    "float lengths": (
        text(changed(FACES, FACES.replace("uchar", "float"))),
        "a length of type",
    ),
    "fractional index": (text(rows=(*ROWS[:3], "3 0 1 1.5")), "1.5 where a whole number is"),
    "no list": (text(changed(FACES, "property int vertex_indices")), "no list property"),
    "x is a list": (
        text(changed("property float x", "property list uchar float x")),
        "no property",
    ),
    "negative length": (
        text(changed(FACES, FACES.replace("uchar", "char")), (*ROWS[:3], "-3 0 1 2")),
        "a list has the length -3",
    ),
    "too long a list": (text(rows=(*ROWS[:3], "200 0 1 2")), "cut off: it has fewer rows of face"),
    "too many rows": (text(changed("element face 1", f"element face {MANY}")), "cut off"),
    "rows of nothing": (
        text(["ply", FORMAT, f"element vertex {MANY}", "end_header"], ()),
        "no property",
    ),
    "negative rows": (
        text(changed("element vertex 3", "element vertex -3")),
        "does not know: element vertex -3",
    ),
    "two corners": (text(rows=(*ROWS[:3], "2 0 1")), "face 0, counting from 0, has 2 corners"),
    "a large index": (
        text(rows=(*ROWS[:3], "3 0 1 99999999999999999999")),
        r"1e\+20 where a whole number is .* at most 16 digits",
    ),
    "no end": (text(changed("end_header", "comment end_header")), "begin with a PLY header"),
    "a long word": (text(changed(FORMAT, "format " + "a" * 10**5)), "its format is a{40},"),
}


@pytest.mark.parametrize(("content", "message"), REFUSED.values(), ids=REFUSED)
def test_refused(tmp_path, content, message):
    with pytest.raises(MeshError, match=message) as caught:
        load_mesh(write(tmp_path, "a.ply", content))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
