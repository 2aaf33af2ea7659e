"""Invalid mesh files raise a one-line error, with bounded time and memory."""

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

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from tests.core.mesh.heavy_meshes import HEAVY
from tests.mesh_writers import WRITERS, exported, freesurfer_bytes, ply_bytes, write
from tests.messages import raises
from tests.shapes import icosphere, tetrahedron

SMALL, SPHERE = tetrahedron(), icosphere(0)
PLY = ply_bytes(SMALL.vertices, SMALL.faces.tolist())
BINARY_PLY = ply_bytes(SMALL.vertices, SMALL.faces.tolist(), "binary_little_endian")
STL, TEXT_STL, GLB = (
    exported(SPHERE.vertices, SPHERE.faces, kind) for kind in ("stl", "stl_ascii", "glb")
)
POINTS = trimesh.PointCloud(np.eye(3))
TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
OFF_TRIANGLE = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n"
FREESURFER = freesurfer_bytes(SMALL.vertices, SMALL.faces)
BAD_FILES = {
    "empty.obj": (b"", ()),
    "words.obj": (b"hello\nworld", ()),
    "points.obj": (TRIANGLE, ()),
    "zero.obj": (TRIANGLE + b"f 0 1 2\n", (0, "OBJ", 1)),
    "beyond.obj": (TRIANGLE + b"f 1 2 4\n", (3,)),
    "line.obj": (TRIANGLE + b"f 1 2 3\nf 1 2\n", (1, 0, 2)),
    "short.obj": (b"v 0 0 0\nv 1 0\nv 0 1 0\n", (1, 2, 3)),
    "letters.obj": (b"v 0 0 0\nv 1 O 0\n", ("O",)),
    "letters_in_faces.obj": (TRIANGLE + b"f 1 2 x/3\n", ("x",)),
    "digits.obj": (b"f 1 2 " + b"3" * 5000, ()),
    "digits.ply": (PLY.replace(b"vertex 4", b"vertex " + b"3" * 5000), ()),
    "counts_in_words.off": (b"OFF\nthree 1 0\n", ("three",)),
    "letters.off": (b"OFF\n3 1 0\n0 0 0\n1 O 0\n0 1 0\n3 0 1 2\n", ("O",)),
    "letters_in_faces.off": (OFF_TRIANGLE + b"3 0 1 x\n", ("x",)),
    "letters.ply": (PLY.replace(b"\n1.0", b"\none"), ("one",)),
    "letters_in_faces.ply": (PLY.replace(b"\n3 0", b"\nx 0"), ("x",)),
    "letters.stl": (b"solid\nvertex 0 0 x\nendsolid", ("x",)),
    "bytes.gltf": (b"{\xff", (1, 0, "UTF-8")),
    "digits.gltf": (b"1" * 5000, ("JSON",)),
    "header.off": (b"PLY\n3 1 0\n", ("OFF",)),
    "counts.off": (b"OFF\n", ()),
    "corners.off": (OFF_TRIANGLE + b"4 0 1 2\n", (4, 3)),
    "beyond_64.obj": (TRIANGLE + b"f 1 2 %d\n" % 10**20, (0,)),
    "beyond_64.off": (OFF_TRIANGLE + b"3 0 1 -%d\n" % 10**20, (0,)),
    "huge.off": (b"OFF\n99999999999999999999 1 0\n0 0 0\n", ()),
    "cut.ply": (PLY[:-12], ()),
    "cut_binary.ply": (BINARY_PLY[:-1], ()),
    "header.ply": (b"ply\nformat ascii 1.0\n", ("PLY",)),
    "format.ply": (b"ply\nformat utf 1.0\nend_header\n", ("utf",)),
    "type.ply": (PLY.replace(b"double x", b"real x"), ("real",)),
    "no_z.ply": (PLY.replace(b"double z", b"double w"), ("z",)),
    "points.ply": (POINTS.export(file_type="ply"), ()),
    "words.stl": (b"hello world", ()),
    "cut.stl": (STL[:-1], (20, 19)),
    "cut_text.stl": (TEXT_STL[:-70], ()),
    "two.stl": (b"solid\nvertex 0 0 0\nvertex 1 0 0\nendsolid", (2,)),
    "nothing.stl": (b"solid\nendsolid", ()),
    "no_triangles.stl": (bytes(84), ()),
    "no_scene.glb": (b"glTF" + bytes(80), (".glb",)),
    "words.glb": (b"hello world", ()),
    "cut.glb": (GLB[:-70], ()),
    "points.glb": (trimesh.Scene([POINTS]).export(file_type="glb"), ()),
    "words.gltf": (b"hello world", ("JSON", 1)),
    "words.gii": (b"hello world", ()),
    "words.gii.gz": (b"hello world", ()),
    "no_surface.gii": (nibabel.gifti.GiftiImage().to_bytes(), (0,)),
    "surface.txt": (b"hello", (".obj", ".off", ".ply", ".stl", ".glb", ".gltf")),
    "surface": (b"hello", ()),
    "points_in_disguise.obj": (STL, ()),
    "lh.white": (FREESURFER[:-8], (47, 4, 48)),
    "lh.quadrangles": (b"\xff\xff\xfd" + FREESURFER[3:], ("vertices",)),
    "lh.sulc": (b"\xff\xff\xff" + bytes(12), ("values",)),
    "lh.aparc.annot": (bytes(8), ("annotation",)),
    "html.ply": (b"<!DOCTYPE html><html></html>", ("HTML",)),
    "a.csv": (b"1,2\n", ("table",)),
    "lh.V1.label": (b"#!ascii label\n0\n", ()),
    "lh.minus": (FREESURFER[:20] + struct.pack(">i", -4) + FREESURFER[24:], (-4,)),
    "lh.beyond": (FREESURFER[:-11] + bytes([9]) + FREESURFER[-10:], ()),
    "lh.nan": (FREESURFER[:28] + b"\xff" * 4 + FREESURFER[32:], ()),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file_error_begins_with_its_name(tmp_path, name):
    content, named = BAD_FILES[name]
    path = write(tmp_path, name, content)
    with raises(MeshError, *named) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert not re.search("invalid literal|could not convert|base 10|codec", str(caught.value))


def test_missing_files_and_folders_are_refused(tmp_path):
    with raises(MeshError, "none.obj"):
        load_mesh(tmp_path / "none.obj")
    (tmp_path / "folder.obj").mkdir()
    with raises(MeshError, "folder.obj"):
        load_mesh(str(tmp_path / "folder.obj"))
    with raises(MeshError, "bad?name.obj"):
        load_mesh("bad\0name.obj")


def test_missing_gltf_buffer_is_named(tmp_path):
    files = trimesh.Scene([trimesh.creation.box()]).export(file_type="gltf")
    path = write(tmp_path, "a.gltf", files["model.gltf"])
    with raises(MeshError, "a.gltf"):
        load_mesh(path)
    for name, content in files.items():
        write(tmp_path, name, content)
    assert load_mesh(path).is_closed


def test_gifti_is_read_without_nibabel(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "nibabel", None)
    content = WRITERS["a.surf.gii"][0](SPHERE.vertices, SPHERE.faces)
    assert load_mesh(write(tmp_path, "a.gii", content)).is_closed


ENDINGS = ["obj", "off", "ply", "stl", "glb", "gltf", "gii", "gii.gz", "white"]


def mesh_or_reason(path):
    try:
        return load_mesh(path)
    except MeshError as error:
        return str(error)


SIZE, LARGER = 20_000, 300_000  # the larger size is for STL, in which blank lines once took minutes
# bytes; data of 64 MiB may be decompressed, of which some versions of Python need two copies
PEAK_BYTES_MAX = 150_000_000


@pytest.mark.parametrize("name", HEAVY)
def test_heavy_files_are_bounded(tmp_path, name):
    """Files whose reading once took minutes have bounded memory and a short one-line outcome."""
    path = write(tmp_path, name, HEAVY[name](LARGER if name.endswith("stl") else SIZE))
    tracemalloc.start()
    try:
        outcome = str(mesh_or_reason(path))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(outcome.splitlines()) == 1
    assert len(outcome.replace(str(path), "")) <= 400
    assert peak < PEAK_BYTES_MAX


@pytest.mark.parametrize("ending", ENDINGS)
def test_special_files_are_refused(tmp_path, monkeypatch, ending):
    monkeypatch.chdir(tmp_path)  # names of sockets must be short
    os.mkfifo(f"pipe.{ending}")
    os.symlink("/dev/zero", f"device.{ending}")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(f"socket.{ending}")
        for kind in ("pipe", "device", "socket"):
            with raises(MeshError, kind):
                load_mesh(f"{kind}.{ending}")


@pytest.mark.parametrize(
    "name", ["a\nb.obj", "a\x1b[31m.off", "a\u2028b.ply", "b" * 250 + ".stl", "\udcff.obj"]
)
def test_file_names_in_errors_are_bounded(tmp_path, name):
    for path in (tmp_path / name, tmp_path / "x" / ("y" * 5000) / name):
        with pytest.raises(MeshError) as caught:
            load_mesh(path)
        assert len(str(caught.value).splitlines()) == 1
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 400


def test_memory_error_is_reported(tmp_path, monkeypatch):
    def check(*_):
        raise MemoryError

    monkeypatch.setattr("abfm.mesh.triangle_mesh.check", check)
    with raises(MeshError):
        load_mesh(write(tmp_path, "a.off", "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"))


def test_text_stl_coordinates_may_span_lines(tmp_path):
    corners = "vertex 0 0 0\n\n  vertex\n1 0\t0\nVertex 0 1\n0\n"
    mesh = load_mesh(write(tmp_path, "a.stl", f"solid\n{corners}endsolid\n"))
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
