"""Mesh files that cannot be used: one line that says why, and no more work than they are worth."""

import os
import re
import socket
import struct
import sys
import tracemalloc

import nibabel
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from tests.attack.heavy_meshes import HEAVY
from tests.mesh_writers import (
    STL_WRITERS,
    WRITERS,
    exported,
    freesurfer_bytes,
    off_text,
    ply_bytes,
    write,
)
from tests.shapes import icosphere, tetrahedron

SMALL, SPHERE = tetrahedron(), icosphere(0)
PLY = ply_bytes(SMALL.vertices, SMALL.faces.tolist())
BINARY_PLY = ply_bytes(SMALL.vertices, SMALL.faces.tolist(), "binary_little_endian")
OFF = off_text(SMALL.vertices, SMALL.faces).encode()
STL, TEXT_STL, GLB = (
    exported(SPHERE.vertices, SPHERE.faces, kind) for kind in ("stl", "stl_ascii", "glb")
)
POINTS = trimesh.PointCloud(np.eye(3))
TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
OFF_TRIANGLE = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n"
FREESURFER = freesurfer_bytes(SMALL.vertices, SMALL.faces)
DIGITS = "'3333.*' where a number of fewer digits is expected"
BAD_FILES = {
    "empty.obj": (b"", "the file is empty"),
    "words.obj": (b"hello\nworld", "no vertices"),
    "points.obj": (TRIANGLE, "no faces.*point cloud"),
    "zero.obj": (TRIANGLE + b"f 0 1 2\n", "vertex 0, but OBJ counts vertices from 1"),
    "beyond.obj": (TRIANGLE + b"f 1 2 4\n", "names vertex 3 of 3"),
    "line.obj": (TRIANGLE + b"f 1 2 3\nf 1 2\n", "face 1, counting from 0, has 2 corners"),
    "short.obj": (b"v 0 0 0\nv 1 0\nv 0 1 0\n", "vertex 1, .* has 2 coordinates instead of 3"),
    "letters.obj": (b"v 0 0 0\nv 1 O 0\n", "it has 'O' where a number is expected"),
    "letters_in_faces.obj": (TRIANGLE + b"f 1 2 x/3\n", "'x' where a whole number is expected"),
    "digits.obj": (b"f 1 2 " + b"3" * 5000, DIGITS),
    "digits.ply": (PLY.replace(b"vertex 4", b"vertex " + b"3" * 5000), f"it has {DIGITS}"),
    "counts_in_words.off": (b"OFF\nthree 1 0\n", "it has 'three' where a whole number is expected"),
    "letters.off": (b"OFF\n3 1 0\n0 0 0\n1 O 0\n0 1 0\n3 0 1 2\n", "'O' where a number is"),
    "letters_in_faces.off": (OFF_TRIANGLE + b"3 0 1 x\n", "'x' where a whole number is expected"),
    "letters.ply": (PLY.replace(b"\n1.0", b"\none"), "it has 'one' where a number is"),
    "letters_in_faces.ply": (PLY.replace(b"\n3 0", b"\nx 0"), "it has 'x' where a number is"),
    "letters.stl": (b"solid\nvertex 0 0 x\nendsolid", "it has 'x' where a number is expected"),
    "bytes.gltf": (b"{\xff", "byte 1, counting from 0, is no text in UTF-8"),
    "digits.gltf": (b"1" * 5000, "its JSON has a number of too many digits"),
    "header.off": (b"PLY\n3 1 0\n", "first line is not OFF"),
    "counts.off": (b"OFF\n", "numbers of vertices and faces are missing"),
    "cut.off": (OFF[:-10], "4 faces .* cut off"),
    "corners.off": (OFF_TRIANGLE + b"4 0 1 2\n", "announces 4 corners, but its line has 3"),
    "beyond_64.obj": (TRIANGLE + b"f 1 2 %d\n" % 10**20, "face 0, .* beyond all numbers"),
    "beyond_64.off": (OFF_TRIANGLE + b"3 0 1 -%d\n" % 10**20, "face 0, .* beyond all numbers"),
    "huge.off": (b"OFF\n99999999999999999999 1 0\n0 0 0\n", "cut off"),
    "cut.ply": (PLY[:-12], "cut off"),
    "cut_binary.ply": (BINARY_PLY[:-1], "cut off"),
    "header.ply": (b"ply\nformat ascii 1.0\n", "does not begin with a PLY header"),
    "format.ply": (b"ply\nformat utf 1.0\nend_header\n", "its format is utf"),
    "type.ply": (PLY.replace(b"double x", b"real x"), "a line .*property real x"),
    "no_z.ply": (PLY.replace(b"double z", b"double w"), "it has no property z"),
    "points.ply": (POINTS.export(file_type="ply"), "no faces.*point cloud"),
    "words.stl": (b"hello world", "neither a complete text file nor as long as its binary header"),
    "cut.stl": (STL[:-7], "may be cut off"),
    "cut_text.stl": (TEXT_STL[:-70], "may be cut off"),
    "two.stl": (b"solid\nvertex 0 0 0\nvertex 1 0 0\nendsolid", "2 corners do not make whole tri"),
    "nothing.stl": (b"solid\nendsolid", "no vertices"),
    "no_triangles.stl": (bytes(84), "no vertices"),
    "no_scene.glb": (b"glTF" + bytes(80), r"cannot be read as \.glb"),
    "words.glb": (b"hello world", "cannot be read"),
    "cut.glb": (GLB[:-70], "cannot be read"),
    "points.glb": (trimesh.Scene([POINTS]).export(file_type="glb"), "no vertices"),
    "words.gltf": (b"hello world", "its JSON is damaged in line 1: Expecting value"),
    "words.gii": (b"hello world", "cannot be read"),
    "words.gii.gz": (b"hello world", "cannot be read"),
    "no_surface.gii": (nibabel.gifti.GiftiImage().to_bytes(), "0 point sets and 0 triangle arrays"),
    "surface.txt": (b"", r"format is not known .* are \.obj, \.off, \.ply, \.stl, \.glb, \.gltf"),
    "surface": (b"hello", "format is not known"),
    "points_in_disguise.obj": (STL, "no vertices"),
    "lh.white": (FREESURFER[:-8], "cut off: 47 bytes are left for 4 triangles, which have 48"),
    "lh.pial": (FREESURFER[:60], "cut off: .* 4 vertices"),
    "lh.orig": (FREESURFER[:8], "lines that say who made it do not end"),
    "lh.inflated": (FREESURFER[:23], "cut off: a number is missing"),
    "lh.quadrangles": (b"\xff\xff\xfd" + FREESURFER[3:], "let mris_convert write it anew"),
    "lh.sulc": (b"\xff\xff\xff" + bytes(12), "it holds values at vertices"),
    "lh.aparc.annot": (bytes(8), "it holds labels of vertices"),
    "lh.V1.label": (b"#!ascii label\n0\n", "it holds a list of vertices"),
    "lh.minus": (
        FREESURFER[:20] + struct.pack(">i", -4) + FREESURFER[24:],
        "it says to have -4 vertices",
    ),
    "lh.beyond": (FREESURFER[:-11] + bytes([9]) + FREESURFER[-10:], "names vertex"),
    "lh.nan": (FREESURFER[:28] + b"\xff" * 4 + FREESURFER[32:], "not finite"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file_is_one_line_that_begins_with_its_name(tmp_path, name):
    content, message = BAD_FILES[name]
    path = write(tmp_path, name, content)
    with pytest.raises(MeshError, match=message) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert not re.search("invalid literal|could not convert|base 10|codec", str(caught.value))


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(MeshError, match=r"none\.obj: there is no such file"):
        load_mesh(tmp_path / "none.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(MeshError, match=r"folder\.obj: this is a folder"):
        load_mesh(str(tmp_path / "folder.obj"))
    with pytest.raises(MeshError, match=r"bad\?name\.obj: there is no such file"):
        load_mesh("bad\0name.obj")


def test_gltf_without_its_buffer_names_it(tmp_path):
    files = trimesh.Scene([trimesh.creation.box()]).export(file_type="gltf")
    path = write(tmp_path, "a.gltf", files["model.gltf"])
    told = r"a\.gltf: a file that it names is missing: .*gltf_buffer_[01]\.bin"
    with pytest.raises(MeshError, match=told):
        load_mesh(path)
    for name, content in files.items():
        write(tmp_path, name, content)
    assert load_mesh(path).is_closed


def test_gifti_needs_no_further_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "nibabel", None)
    content = WRITERS["a.surf.gii"][0](SPHERE.vertices, SPHERE.faces)
    assert load_mesh(write(tmp_path, "a.gii", content)).is_closed


ENDINGS = ["obj", "off", "ply", "stl", "glb", "gltf", "gii", "gii.gz", "white"]
BEGINNINGS = {"off": b"OFF\n", "stl": b"solid ", "glb": b"glTF\x02\0\0\0", "obj": b"v "}
BEGINNINGS["white"] = b"\xff\xff\xfea\n\n"
BEGINNINGS["ply"] = b"ply\nformat ascii 1.0\n"


@pytest.mark.parametrize("ending", ENDINGS)
@given(content=st.binary(max_size=300), begin=st.booleans())
@settings(max_examples=60)
def test_random_bytes_raise_nothing_but_mesh_errors(folder, ending, content, begin):
    path = write(folder, f"random.{ending}", BEGINNINGS.get(ending, b"") * begin + content)
    with pytest.raises(MeshError) as caught:
        load_mesh(path)
    assert "\n" not in str(caught.value)


def mesh_or_reason(path):
    try:
        return load_mesh(path)
    except MeshError as error:
        return str(error)


VALID = {name: make(SMALL.vertices, SMALL.faces) for name, (make, _) in WRITERS.items()} | {
    name: exported(SMALL.vertices, SMALL.faces, kind) for name, kind in STL_WRITERS.items()
}


@pytest.mark.parametrize("name", VALID)
@given(data=st.data())
@settings(max_examples=40)
def test_damaged_files_give_a_mesh_or_a_mesh_error(folder, name, data):
    content = bytearray(VALID[name])
    for position in data.draw(st.lists(st.integers(0, len(content) - 1), max_size=4)):
        content[position] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.integers(len(content) // 2, len(content)))]
    outcome = mesh_or_reason(write(folder, name, bytes(content)))
    if isinstance(outcome, str):
        assert "\n" not in outcome
    else:
        assert np.isfinite(outcome.vertices).all()


SIZE, LARGER = 20_000, 300_000  # the larger one for STL, whose blank lines took minutes
# bytes; what is compressed may come to 64 MiB, which some Pythons hold twice for a moment
MOST = 150_000_000


@pytest.mark.parametrize("name", HEAVY)
def test_heavy_files_are_bounded(tmp_path, name):
    """They end at all: each is one that once took minutes, or a neighbour of these."""
    path = write(tmp_path, name, HEAVY[name](LARGER if name.endswith("stl") else SIZE))
    tracemalloc.start()
    try:
        outcome = str(mesh_or_reason(path))
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(outcome.splitlines()) == 1
    assert len(outcome.replace(str(path), "")) <= 400
    assert most < MOST


@pytest.mark.parametrize("ending", ENDINGS)
def test_pipes_sockets_and_devices_are_refused_unread(tmp_path, monkeypatch, ending):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    os.mkfifo(f"pipe.{ending}")
    os.symlink("/dev/zero", f"device.{ending}")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(f"socket.{ending}")
        for kind in ("pipe", "device", "socket"):
            with pytest.raises(MeshError, match=f"it is a {kind}, not a file"):
                load_mesh(f"{kind}.{ending}")


@pytest.mark.parametrize(
    "name", ["a\nb.obj", "a\x1b[31m.off", "a\u2028b.ply", "b" * 250 + ".stl", "\udcff.obj"]
)
def test_names_of_files_stay_on_one_bounded_line(tmp_path, name):
    for path in (tmp_path / name, tmp_path / "x" / ("y" * 5000) / name):
        with pytest.raises(MeshError) as caught:
            load_mesh(path)
        assert len(str(caught.value).splitlines()) == 1
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 400


def test_what_does_not_fit_into_memory_says_so(tmp_path, monkeypatch):
    def check(*_):
        raise MemoryError

    monkeypatch.setattr("abfm.mesh.triangle_mesh.check", check)
    with pytest.raises(MeshError, match="does not fit into memory"):
        load_mesh(write(tmp_path, "a.off", "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"))


def test_text_stl_coordinates_may_go_on_after_a_line_end(tmp_path):
    corners = "vertex 0 0 0\n\n  vertex\n1 0\t0\nVertex 0 1\n0\n"
    mesh = load_mesh(write(tmp_path, "a.stl", f"solid\n{corners}endsolid\n"))
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
