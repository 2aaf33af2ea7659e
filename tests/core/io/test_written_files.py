import csv
import fcntl
import os
import resource
import signal
import socket
import stat
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal

from abfm import ResultError
from abfm.io import (
    atomic,
    check_writable,
    export_energy_csv,
    export_ply,
    export_vtu,
    remove_temporary,
    temporary_folder,
    write_atomically,
)
from abfm.io.atomic import temporary_file
from tests.messages import check_message, raises
from tests.shapes import tetrahedron, torus


def written(path, text="new"):
    with write_atomically(path) as temporary:
        temporary.write_text(text)


def refusal(path):
    """Return the error of both the check and the writer, which leave no files."""

    def there():
        return sorted(path.parent.iterdir()) if path.parent.is_dir() else []

    before = there()
    with pytest.raises(ResultError) as refused:
        check_writable(path)
    with pytest.raises(ResultError) as again:
        written(path)
    assert str(again.value) == str(refused.value)
    assert "\n" not in str(refused.value)
    assert there() == before
    return str(refused.value)


def make_socket(path):
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(str(path))


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (os.mkdir, "folder"),
        (os.mkfifo, "pipe"),
        (make_socket, "socket"),
        (lambda path: path.symlink_to("/dev/null"), "device"),
    ],
)
def test_special_files_are_not_replaced(tmp_path, monkeypatch, make, named):
    monkeypatch.chdir(tmp_path)  # names of sockets must be short
    make(Path("m.npz"))
    kind = stat.S_IFMT(os.stat("m.npz").st_mode)
    check_message(refusal(tmp_path / "m.npz"), named)
    assert stat.S_IFMT(os.stat("m.npz").st_mode) == kind


@pytest.mark.parametrize("name", ["a" * 256, "none/m.npz", "file/m.npz", "m\0.npz", "loop"])
def test_invalid_paths_are_refused(tmp_path, name):
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to("loop")
    check_message(refusal(tmp_path / name))


@pytest.mark.parametrize(
    "name", ["a" * 251 + ".npz", "a." + "b" * 253, "ä" * 125 + ".npz", "." * 9]
)
def test_longest_names_are_written(tmp_path, name):
    check_writable(tmp_path / name)
    written(tmp_path / name)
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("raised", [OSError(28, "No space left on device"), None])
def test_cleanup_does_not_hide_the_error(tmp_path, raised):
    """An error of the writer is raised, even if its temporary folder disappears meanwhile."""

    def write():
        with write_atomically(tmp_path / "folder" / "m.npz") as temporary:
            temporary.unlink()
            temporary.parent.rmdir()
            if raised:
                (tmp_path / "folder").touch()
                raise raised

    (tmp_path / "folder").mkdir()
    strerror = raised.strerror if raised else ""
    with raises(ResultError, "m.npz", strerror):
        write()


@pytest.fixture
def old(tmp_path):
    path = tmp_path / "m.npz"
    written(path, "old")
    yield path
    assert os.listdir(tmp_path) == ["m.npz"]


def test_full_disk_keeps_the_old_file(old):
    """A full disk, simulated by a limit of the file size, leaves the existing file unchanged."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))
    try:
        with raises(ResultError):
            written(old, "new" * 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert old.read_text() == "old"


def test_interrupt_keeps_the_old_file(old):
    def interrupted():
        with write_atomically(old) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert old.read_text() == "old"


def test_data_are_synced_before_the_replacement(old, monkeypatch):
    flushed = []
    monkeypatch.setattr(os, "fsync", lambda _: flushed.append(old.read_text()))
    written(old)
    assert flushed[0] == "old"


@pytest.mark.parametrize("mode", [0o600, 0o644])
def test_permissions_are_preserved(old, mode):
    old.chmod(mode)
    written(old)
    assert stat.S_IMODE(old.stat().st_mode) == mode


def test_new_files_have_default_permissions(tmp_path):
    (tmp_path / "usual").touch()
    (tmp_path / "link").symlink_to(tmp_path / "new.gz")
    with write_atomically(tmp_path / "link") as temporary:
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".gz")
        temporary.write_text("new")
    new = tmp_path / "new.gz"
    assert new.stat().st_mode == (tmp_path / "usual").stat().st_mode
    assert (tmp_path / "link").is_symlink()
    assert new.read_text() == "new"


KILLED = """
import os, sys
from pathlib import Path
from abfm.io.atomic import temporary_file, temporary_folder
place = Path(sys.argv[1])
with temporary_file(place, ".npz") as file, temporary_folder(place) as folder:
    (folder / "frame").touch()
    print("there", flush=True)
    sys.stdin.read()
"""


def test_files_of_killed_processes_are_removed(tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, env=environment, **pipes) as other:
        other.stdout.readline()
        theirs = set(os.listdir(tmp_path))
        assert len(theirs) == 2
        written(tmp_path / "m.npz")
        assert set(os.listdir(tmp_path)) == theirs | {"m.npz"}
        other.kill()
    assert set(os.listdir(tmp_path)) == theirs | {"m.npz"}
    written(tmp_path / "m.npz")
    assert os.listdir(tmp_path) == ["m.npz"]


def test_removed_folder_is_created_again(tmp_path, monkeypatch):
    """A temporary folder that another process removes before it is locked is created again."""
    mkdir, made = Path.mkdir, []

    def removed_once(path, mode):
        mkdir(path, mode)
        made.append(path)
        if len(made) == 1:
            path.rmdir()

    monkeypatch.setattr(Path, "mkdir", removed_once)
    with temporary_folder(tmp_path) as folder:
        assert os.listdir(tmp_path) == [folder.name]
    assert made == [folder, folder]
    assert os.listdir(tmp_path) == []


def test_files_of_other_computers_are_kept(tmp_path):
    # names with the process of another computer, or without a process
    names = [".abfm-00000000-0123456789ab.npz", ".m-0123456789ab.npz", ".abfm"]
    for name in names:
        (tmp_path / name).touch()
    written(tmp_path / "m.npz")
    assert sorted(os.listdir(tmp_path)) == sorted([*names, "m.npz"])


def test_concurrent_writers_share_one_folder(tmp_path):
    def write(number):
        for _ in range(20):
            written(tmp_path / f"{number}.txt", str(number))

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(8)))  # raises errors of the writers
    found = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert found == {f"{n}.txt": str(n) for n in range(8)}


def test_file_created_again_is_not_abandoned(tmp_path, monkeypatch):
    """A new temporary file is kept if its name was that of a file removed a moment before."""
    with temporary_file(tmp_path) as path:
        path.unlink()
    path.touch()
    lock = atomic._locked

    def locked_late(path, flags=0):
        descriptor = lock(path, flags)
        path.unlink()
        path.touch()
        return descriptor

    monkeypatch.setattr(atomic, "_locked", locked_late)
    atomic.remove_abandoned(tmp_path)
    assert path.exists()


def test_finished_file_is_unlocked_after_a_check(tmp_path, monkeypatch):
    """Its writer may rename a temporary file while another process checks it."""
    path = tmp_path / f"{atomic._PREFIX}0123456789ab.txt"
    path.touch()
    lock = atomic._locked

    def locked_late(path, flags=0):
        descriptor = lock(path, flags)
        path.rename(tmp_path / "m.txt")
        return descriptor

    with monkeypatch.context() as patch:
        patch.setattr(atomic, "_locked", locked_late)
        atomic.remove_abandoned(tmp_path)
    os.close(lock(tmp_path / "m.txt", fcntl.LOCK_NB))
    assert os.listdir(tmp_path) == ["m.txt"]


def test_temporary_files_can_be_removed_at_exit(tmp_path):
    with temporary_file(tmp_path), temporary_folder(tmp_path) as folder:
        (folder / "frame").touch()
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700  # with permissions for the user only
        assert len(os.listdir(tmp_path)) == 2
        remove_temporary()
        assert os.listdir(tmp_path) == []
    with temporary_folder(tmp_path) as folder:
        (folder / "frame").touch()
    assert os.listdir(tmp_path) == []


MESH = torus(7, 5)
RANDOM = np.random.default_rng(3)
F, COLORS, MAP = (RANDOM.normal(size=shape) for shape in (35, (35, 4), (35, 3)))
AREA, VELOCITY = RANDOM.uniform(size=70), RANDOM.normal(size=(70, 3))


def read_vtu(path):
    """Return all arrays of a VTU file with raw appended data, by name."""
    head, _, data = path.read_bytes().partition(b'<AppendedData encoding="raw">')
    data = data[data.index(b"_") + 1 :]
    root = ElementTree.fromstring(head + b"</VTKFile>")
    order = {"little": "LittleEndian", "big": "BigEndian"}[sys.byteorder]
    kind = {"type": "UnstructuredGrid", "version": "1.0", "header_type": "UInt64"}
    assert root.attrib == {**kind, "byte_order": order}
    arrays = {}
    for element in root.iter("DataArray"):
        dtype = np.dtype(element.attrib["type"].lower())
        start = int(element.attrib["offset"])
        size = int(np.frombuffer(data, np.uint64, 1, start)[0])
        array = np.frombuffer(data, dtype, size // dtype.itemsize, start + 8)
        components = int(element.attrib["NumberOfComponents"])
        arrays[element.attrib["Name"]] = array.reshape(-1, components) if components > 1 else array
    return arrays


def columns(arrays, name, count):
    return np.stack([np.ravel(arrays[f"{name}_{k}"]) for k in range(count)], axis=1)


def test_vtu_has_all_digits(tmp_path):
    path = tmp_path / "a.b.vtu"
    points = {"f": F, "colours": COLORS, "map": MAP}
    cells = {"area": AREA, "velocity": VELOCITY, "flipped": AREA > 0.5}
    export_vtu(path, MESH, points, cells)
    assert os.listdir(tmp_path) == ["a.b.vtu"]
    arrays = read_vtu(path)
    arrays["colours"] = columns(arrays, "colours", 4)
    places = {"points": MESH.vertices, "connectivity": MESH.faces.ravel()}
    triangles = {"types": np.full(70, 5), "offsets": np.arange(3, 211, 3)}  # VTK_TRIANGLE
    for name, wanted in {**places, **triangles, **points, **cells}.items():
        assert_array_equal(arrays[name], wanted)


def test_ply_has_all_digits(tmp_path):
    path = tmp_path / "a.ply"
    export_ply(path, MESH, {"f": F, "colours": COLORS}, {"area": AREA, "velocity": VELOCITY})
    read = trimesh.load_mesh(path, process=False)
    assert_array_equal(read.vertices, MESH.vertices)
    assert_array_equal(read.faces, MESH.faces)
    points, cells = (read.metadata["_ply_raw"][name]["data"] for name in ("vertex", "face"))
    assert_array_equal(points["f"], F)
    assert_array_equal(columns(points, "colours", 4), COLORS)
    assert_array_equal(cells["area"].ravel(), AREA)
    assert_array_equal(columns(cells, "velocity", 3), VELOCITY)
    export_ply(path, tetrahedron(), {}, {})
    end = b"property double z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    assert end in path.read_bytes()


@pytest.mark.parametrize(
    ("points", "cells", "named"),
    [
        ({"f": np.ones(34)}, {}, ("f", "(34,)", "(35,)", 35)),
        ({}, {"v": np.ones((35, 3))}, ("v", "(35, 3)", "(70,)")),
        ({"f": np.ones((35, 2, 2))}, {}, ("f", "(35, 2, 2)")),
        ({"my f": np.ones(35)}, {}, ("my f",)),
        ({}, {"<v>": np.ones(70)}, ("<v>",)),
        ({"f": np.ones((35, 2)), "f_1": np.ones(35)}, {}, ("f_1",)),
    ],
)
def test_invalid_data_are_refused(tmp_path, points, cells, named):
    for export, name in ((export_ply, "a.ply"), (export_vtu, "a.vtu")):
        with raises(ResultError, *named):
            export(tmp_path / name, MESH, points, cells)
    with raises(ResultError, "x"):
        export_ply(tmp_path / "a.ply", MESH, {"x": F}, {})
    with raises(ResultError, ".vtu"):
        export_vtu(tmp_path / "a.vtk", MESH, {}, {})
    assert os.listdir(tmp_path) == []


def test_energy_table_has_a_row_for_each_iteration(tmp_path):
    history = np.random.default_rng(1).uniform(size=(3, 3)) ** 40
    export_energy_csv(tmp_path / "energy.csv", history, np.array([0, 0, 1]))
    with (tmp_path / "energy.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == ["iteration", "stage", "total", "regularity", "mismatch"]
    assert [row[:2] for row in rows] == [["0", "0"], ["1", "0"], ["2", "1"]]
    assert_array_equal(np.array([row[2:] for row in rows], dtype=float), history)
