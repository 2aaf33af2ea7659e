"""What is no file is refused unread; and no mesh file makes its reader work or keep more than
its length allows.
"""

import os
import socket
import tracemalloc

import numpy as np
import pytest

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from tests.attack.heavy_meshes import HEAVY
from tests.mesh_writers import write

SIZE, LARGER = 20_000, 300_000  # the larger one for STL, whose blank lines took minutes
# bytes; what is compressed may come to 64 MiB, which some Pythons hold twice for a moment
MOST = 150_000_000


@pytest.mark.parametrize("name", HEAVY)
def test_heavy_files_are_bounded(tmp_path, name):
    """They end at all: each is one that once took minutes, or a neighbour of these."""
    path = write(tmp_path, name, HEAVY[name](LARGER if name.endswith("stl") else SIZE))
    tracemalloc.start()
    try:
        outcome = outcome_of(path)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(outcome.splitlines()) == 1
    assert len(outcome.replace(str(path), "")) <= 400
    assert most < MOST


def outcome_of(path):
    """What the mesh is called, or why it is refused."""
    try:
        return repr(load_mesh(path))
    except MeshError as error:
        return str(error)


@pytest.mark.parametrize("ending", ["obj", "off", "ply", "stl", "glb", "gltf", "gii", "gii.gz"])
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


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n"),
        ("a.off", "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -99999999999999999999\n"),
    ],
)
def test_indices_beyond_64_bits(tmp_path, name, content):
    with pytest.raises(
        MeshError, match="face 0, counting from 0, names a vertex beyond all numbers"
    ):
        load_mesh(write(tmp_path, name, content))


def test_text_stl_coordinates_may_go_on_after_a_line_end(tmp_path):
    corners = "vertex 0 0 0\n\n  vertex\n1 0\t0\nVertex 0 1\n0\n"
    mesh = load_mesh(write(tmp_path, "a.stl", f"solid\n{corners}endsolid\n"))
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
