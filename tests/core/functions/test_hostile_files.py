"""Values and maps from files that lie, wait or bite: one line each, and no more work than the
file is worth.
"""

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from abfm.errors import FunctionError, did_you_mean
from abfm.functions import function
from abfm.mesh import TriangleMesh
from tests.core.reading.hostile import npy_of, one_byte_changed
from tests.processes import python
from tests.shapes import icosphere

MESH = icosphere(0)
COUNT = len(MESH.vertices)


def error_line(path, form="file:{}"):
    with pytest.raises(FunctionError) as caught:
        function(MESH, form.format(f'"{path}"'))
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) <= 600
    return message


@pytest.mark.parametrize("form", ["file:{}", "permuted:{}(coordinate:x)"])
@pytest.mark.parametrize("suffix", [".npy", ".csv", ".txt", ".vts", ".sym.vts", ".gii", ".gii.gz"])
def test_devices_pipes_and_folders_are_refused(tmp_path, suffix, form):
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    (tmp_path / f"folder{suffix}").mkdir()
    assert "cannot be read: it is a pipe" in error_line(tmp_path / f"pipe{suffix}", form)
    assert "cannot be read: it is a device" in error_line(tmp_path / f"zero{suffix}", form)
    assert "cannot be read: Is a directory" in error_line(tmp_path / f"folder{suffix}", form)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.npy", npy_of("(6442450944,)", data=bytes(8)), "size is not what its header says"),
        ("a.npy", npy_of("(12,)", "|O", bytes(96)), "type is object"),
        ("a.npy", b"\x93NUMPY\x01\x00v\x00" + b"(" * 118, "header is damaged"),
        ("a.csv", b"x" * 100_000 + b"\n1\n", "1 values were given"),
        ("a.csv", b"x" * 200_000 + b",y\n1,2\n", "field larger than field limit"),
        (
            "a.csv",
            b"a" * 10_000 + b",\x1b[31m,c\n1,2,3\n",
            "has 3 columns; choose column=0 to 2 or one of aaa",
        ),
        ("a.csv", b"1,2\n3," + b"x" * 10_000, "where a number is expected"),
        ("a.csv", b"\x1b" * 10_000, "it has only the line"),
        ("a.txt", b"1 " * 100_000, "has 100000 columns"),
        ("a.txt", b"1" * 100_000, "1 values were given"),
    ],
)
def test_what_is_wrong_fits_one_line(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    assert words in error_line(tmp_path / name)
    assert error_line(tmp_path / name, "permuted:{}(coordinate:x)")


def test_names_that_cannot_be_printed_are_told_in_one_line(tmp_path):
    for name in ("a\nb.csv", "\x1b[31m.csv", "x" * 200 + ".csv"):
        (tmp_path / name).write_bytes(b"")
        assert "it is empty" in error_line(tmp_path / name)


def test_columns_are_asked_for_in_one_line(tmp_path):
    (tmp_path / "a.csv").write_text(
        ",".join(f"name{number}" for number in range(5000)) + "\n" + ",".join(["1"] * 5000)
    )
    assert "none called" in error_line(tmp_path / "a.csv", "file:{},column=" + "9" * 5000)
    assert "did you mean 'name12'" in error_line(tmp_path / "a.csv", "file:{},column=nome12")


def test_likely_words_are_sought_among_few_and_short_ones():
    assert did_you_mean("sourc", ["x" * 1000, "source"]) == " (did you mean 'source'?)"
    assert did_you_mean("a" * 10_000, ["a" * 9999]) == ""

    def endless():
        while True:
            yield "word"

    assert did_you_mean("wort", endless()) == " (did you mean 'word'?)"


def check_outcomes(path):
    """As values and as a map, the file gives finite values or one line that refuses it."""
    for form in ("file:{}", "permuted:{}(coordinate:x)"):
        try:
            values = function(MESH, form.format(path))
        except FunctionError as error:
            outcome = str(error)
            assert outcome.isprintable()
        else:
            assert values.shape == (COUNT,)
            assert np.isfinite(values).all()


def test_one_wrong_byte_of_an_array_is_noticed_or_harmless(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.arange(float(COUNT)))
    for changed in one_byte_changed(path.read_bytes(), 128):
        path.write_bytes(changed)
        check_outcomes(path)


@settings(
    deadline=None, max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    content=st.binary(max_size=60)
    | st.text("0123456789.,;\t\n\r\"'#+-eE naif\x00\x1b", max_size=60).map(str.encode),
    suffix=st.sampled_from([".csv", ".txt", ".npy", ".gii", ".gii.gz", ".sym.vts"]),
)
def test_any_bytes_are_values_or_refused(tmp_path, content, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    check_outcomes(path)


def test_maps_to_meshes_of_files_with_many_more_vertices_need_no_room(tmp_path):
    """The address space has room for few numbers per vertex of the file."""
    np.save(tmp_path / "map.npy", np.arange(COUNT)[::-1] + 7)
    code = (
        "import resource, sys, numpy; from abfm import TriangleMesh; from abfm.functions import "
        "function\n"
        "vertices, faces, path = numpy.load(sys.argv[1]), numpy.load(sys.argv[2]), sys.argv[3]\n"
        "mesh = TriangleMesh(vertices, faces, numbers=(numpy.arange(len(vertices)) + 7, 10**9))\n"
        "function(mesh, f'permuted:{path}(coordinate:x)')\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + (1 << 29), used + (1 << 29)))\n"
        "assert (function(mesh, f'permuted:{path}(coordinate:x)') == vertices[::-1, 0]).all()\n"
    )
    for name, array in (("vertices", MESH.vertices), ("faces", MESH.faces)):
        np.save(tmp_path / f"{name}.npy", array)
    paths = [tmp_path / "vertices.npy", tmp_path / "faces.npy", tmp_path / "map.npy"]
    done = python(code, *paths)
    assert done.stderr == ""


def test_a_mesh_may_come_with_the_numbers_of_its_vertices():
    vertices = np.insert(MESH.vertices, 5, 9.0, axis=0)
    whole = TriangleMesh(vertices, MESH.faces + (MESH.faces >= 5))
    ids = np.delete(np.arange(COUNT + 1), 5)
    again = TriangleMesh(MESH.vertices, MESH.faces, numbers=(ids, COUNT + 1))
    assert again.messages == whole.messages
    assert (again.vertex_ids == whole.vertex_ids).all()
    assert again.file_vertex_count == whole.file_vertex_count
