"""Further mesh formats and variants are read as the shape that was written."""

import gzip
import struct

import nibabel
import numpy as np
import pytest

from abfm.errors import MeshError
from abfm.io import export_vtu
from abfm.mesh import load_mesh
from tests.mesh_writers import STL_WRITERS, WRITERS, exported, mni_obj, ply_bytes, write
from tests.messages import check_message, raises
from tests.shapes import icosphere, tetrahedron

SHAPE, SPHERE = tetrahedron(), icosphere(0)
TEXTS = [name for name, (make, _) in WRITERS.items() if name.endswith(("obj", "off", "ascii.ply"))]


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_text_encodings_are_detected(tmp_path, name, encoding):
    text = WRITERS[name][0](SHAPE.vertices, SHAPE.faces).decode()
    mesh = load_mesh(write(tmp_path, name, text.encode(encoding)))
    np.testing.assert_array_equal(mesh.faces, SHAPE.faces)


@pytest.mark.parametrize(
    "name", [name for name in (*WRITERS, *STL_WRITERS) if not name.endswith("gz")]
)
def test_compressed_meshes_are_read(tmp_path, name):
    make = WRITERS[name][0] if name in WRITERS else lambda v, f: exported(v, f, STL_WRITERS[name])
    content = make(SHAPE.vertices, SHAPE.faces)
    mesh = load_mesh(write(tmp_path, f"{name}.gz", gzip.compress(content)))
    assert len(mesh.faces) == 4


STL = exported(SPHERE.vertices, SPHERE.faces, "stl")
STL_LENGTHS = {
    "solid in the header": (b"solid cube".ljust(80) + STL[80:], ()),
    "count of 0": (STL[:80] + bytes(4) + STL[84:], (0, 20)),
    "count too small": (STL[:80] + struct.pack("<I", 15) + STL[84:], (15, 20)),
    "more bytes": (STL + bytes(7), (7, 20)),
    "count of 0 and more bytes": (STL[:80] + bytes(4) + STL[84:] + b"end", (0, 20)),
}


@pytest.mark.parametrize(("content", "named"), STL_LENGTHS.values(), ids=STL_LENGTHS)
def test_binary_stl_with_wrong_length_is_read(tmp_path, content, named):
    mesh = load_mesh(write(tmp_path, "a.stl", content))
    assert len(mesh.faces) == 20
    assert mesh.is_closed
    assert len(mesh.messages) == 1 + bool(named)
    if named:
        check_message(mesh.messages[0], *named)


TEXT_STL = exported(SPHERE.vertices, SPHERE.faces, "stl_ascii")


def test_text_stl_without_end_is_read(tmp_path):
    mesh = load_mesh(write(tmp_path, "a.stl", b"\xef\xbb\xbf" + TEXT_STL))
    assert mesh.is_closed
    end = TEXT_STL.rindex(b"endsolid")
    mesh = load_mesh(write(tmp_path, "a.stl", TEXT_STL[:end]))
    assert mesh.is_closed
    check_message(mesh.messages[0], "endsolid")
    with raises(MeshError, "endsolid"):
        load_mesh(write(tmp_path, "a.stl", TEXT_STL[: end - 12]))


PLY = ply_bytes(SHAPE.vertices, SHAPE.faces.tolist())
PLY_NAMES = {
    name: PLY.replace(b"vertex_indices", name.encode())
    for name in ("vertex_index", "vertex_indexs", "vertexIndices", "vertices", "corners")
}
PLY_NAMES["X Y Z"] = PLY.replace(b"double x", b"double X").replace(b"double y", b"double Y")
PLY_NAMES["X Y Z"] = PLY_NAMES["X Y Z"].replace(b"double z", b"double Z")


@pytest.mark.parametrize("content", PLY_NAMES.values(), ids=PLY_NAMES)
def test_ply_property_names_are_read(tmp_path, content):
    mesh = load_mesh(write(tmp_path, "a.ply", content))
    np.testing.assert_array_equal(mesh.faces, SHAPE.faces)


def test_ply_rows_may_have_more_words(tmp_path):
    """Rows with more words (colours of corners, by MeshLab) and other line breaks are read."""
    header, rows = PLY.split(b"end_header\n")
    for more in (b" 9 1 1 1", b" 7"):
        text = header + b"end_header\n" + rows.replace(b" 0.5", b" 0.5" + more)
        mesh = load_mesh(write(tmp_path, "a.ply", text))
        np.testing.assert_array_equal(mesh.vertices, SHAPE.vertices)
        np.testing.assert_array_equal(mesh.faces, SHAPE.faces)
    one_line = header + b"end_header\n" + rows.replace(b"\n", b" ")
    assert len(load_mesh(write(tmp_path, "a.ply", one_line)).faces) == 4


def test_ply_with_repeated_name_is_refused(tmp_path):
    with raises(MeshError, "x", 2):
        load_mesh(write(tmp_path, "a.ply", PLY.replace(b"double y", b"double x")))


@pytest.mark.parametrize("kind", ["ascii", "binary_big_endian"])
def test_ply_strips_have_one_orientation(tmp_path, kind):
    """Strips that share a list, as in Stanford files, and a separate strip have one orientation."""
    points = np.array([[x, y, 0] for x in range(4) for y in range(2)], dtype=float)
    rows = [[0, 2, 1, 3, -1, 2, 4, 3, 5, -1], [4, 6, 5, 7]]
    content = ply_bytes(points, rows, kind).replace(b"element face", b"element tristrips")
    if kind == "ascii":
        content = content.replace(b"uchar int", b"int int")
    mesh = load_mesh(write(tmp_path, "a.ply", content))
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].tolist() == [1] * 6


def test_ply_strips_may_be_unsigned(tmp_path):
    content = ply_bytes(SHAPE.vertices, [], "binary_little_endian")
    content = content.replace(b"face 0", b"tristrips 1")
    strip = struct.pack("<B4Hf", 4, 0, 1, 2, 3, 0)
    content = content.replace(b"uchar int", b"uchar ushort") + strip
    mesh = load_mesh(write(tmp_path, "a.ply", content))
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]


def _quads(kind):
    """Return a cube in an old FreeSurfer format, with coordinates of two decimals."""
    corners = np.array([[x, y, z] for x in (0, 1.25) for y in (0, 1) for z in (0, 1)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    counts = b"".join(n.to_bytes(3, "big") for n in (8, 6))
    numbers = b"".join(corner.to_bytes(3, "big") for quad in quads for corner in quad)
    if kind == "old":
        return b"\xff\xff\xff" + counts + (corners * 100).astype(">i2").tobytes() + numbers
    return b"\xff\xff\xfd" + counts + corners.astype(">f4").tobytes() + numbers


@pytest.mark.parametrize("kind", ["old", "new"])
def test_freesurfer_quadrangles_agree_with_nibabel(tmp_path, kind):
    path = write(tmp_path, "lh.orig", _quads(kind))
    vertices, faces = nibabel.freesurfer.read_geometry(path)
    mesh = load_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, faces)
    assert mesh.is_closed
    for end in range(10, len(_quads(kind)), 7):
        with raises(MeshError):
            load_mesh(write(tmp_path, "lh.orig", _quads(kind)[:end]))


def test_freesurfer_text_surface_is_read(tmp_path):
    rows = [[*row, 0] for row in [*SHAPE.vertices.tolist(), *SHAPE.faces.tolist()]]
    text = "#!ascii version of lh.white\n4 4\n" + "\n".join(" ".join(map(str, row)) for row in rows)
    for name in ("lh.white.asc", "lh.white.srf", "lh.white"):
        mesh = load_mesh(write(tmp_path, name, text))
        np.testing.assert_array_equal(mesh.vertices, SHAPE.vertices)
        np.testing.assert_array_equal(mesh.faces, SHAPE.faces)
    with raises(MeshError, "faces", 15, 16):
        load_mesh(write(tmp_path, "lh.white.asc", text[:-1]))


@pytest.mark.parametrize("colors", [0, 1, 2])
def test_mni_object_is_read(tmp_path, colors):
    text = mni_obj(SHAPE, colors)
    mesh = load_mesh(write(tmp_path, "a.obj", text))
    np.testing.assert_array_equal(mesh.vertices, SHAPE.vertices)
    np.testing.assert_array_equal(mesh.faces, SHAPE.faces)
    with raises(MeshError, "corners", 11, 12):
        load_mesh(write(tmp_path, "a.obj", text[:-3]))


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def test_obj_keyword_variants_are_read(tmp_path):
    for text in (OBJ + "fo 1 2 3\n", (OBJ + "f 1 2 3\n").upper()):
        assert load_mesh(write(tmp_path, "a.obj", text)).faces.tolist() == [[0, 1, 2]]
    with_comment = f"# C:\\models\\\n{OBJ}f 1 2 \\\n3 # end \\\n"
    assert load_mesh(write(tmp_path, "a.obj", with_comment)).faces.tolist() == [[0, 1, 2]]
    with raises(MeshError, "polygons"):
        load_mesh(write(tmp_path, "a.obj", OBJ + "cstype bezier\nsurf 0 1 0 1 1 2 3\nend\n"))
    with raises(MeshError, "binary", "MNI"):
        load_mesh(write(tmp_path, "a.obj", b"p" + bytes(30)))
    with raises(MeshError, "0,5", "decimal"):
        load_mesh(write(tmp_path, "a.obj", OBJ.replace("1 0 0", "0,5 0 0")))


def test_exported_vtu_is_a_mesh(tmp_path):
    export_vtu(tmp_path / "a.vtu", SPHERE, {"f": SPHERE.vertices[:, 0]}, {})
    mesh = load_mesh(tmp_path / "a.vtu")
    np.testing.assert_array_equal(mesh.vertices, SPHERE.vertices)
    np.testing.assert_array_equal(mesh.faces, SPHERE.faces)
