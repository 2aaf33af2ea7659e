import io
import json
import os
import pickle
import re
import shutil
import zipfile
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from abfm import Parameters, ResultError, load, match
from abfm.io import FORMAT_VERSION, load_arrays, save_arrays
from abfm.io.results import open_archive
from abfm.matching import Remedy, prepare
from abfm.reading import open_regular, read_bytes, regular_files
from abfm.workers import Control
from tests.core.fields import bump
from tests.core.reading import hostile
from tests.core.reading.hostile import members, npy_of, refusal, zipped
from tests.messages import check_message, raises
from tests.processes import ROOT, python
from tests.shapes import icosphere, square, with_loose_vertex


def result_arrays():
    """Return arrays of a match with two channels and three fields on a square."""
    mesh, random = square(3), np.random.default_rng(7)
    vertices, faces = len(mesh.vertices), len(mesh.faces)
    functions = {n: random.normal(size=(vertices, 2)) for n in ("source", "target", "advected")}
    return functions | {
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "velocity": random.normal(size=(3, faces, 3)),
        "energy_history": random.uniform(size=(5, 3)),
        "stages": np.array([0, 0, 1, 1, 2]),
        "residual": 0.03125,
        "stop_reason": "iteration limit",
        "verdict": np.array(["nearly", "none", "a reason", ""]),
        "parameters": json.dumps({"tau": 1, "method": "linearised", "note": "ümlaut ∇"}),
        "vertex_ids": np.arange(vertices) + 3,
        "file_vertex_count": vertices + 3,
        "channels_given": True,
        "weights": np.array([1.0, 2.0]),
        "mask": random.uniform(size=vertices),
    }


@pytest.fixture
def path(tmp_path):
    return tmp_path / "m.npz"


def saved_by_numpy(path, **changes):
    """Write a result file by NumPy, with some arrays changed, or omitted if None."""
    arrays = {"format_version": FORMAT_VERSION, **result_arrays(), **changes}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})


error_line = partial(refusal, load_arrays)


@pytest.mark.parametrize(("omitted", "is_open"), [((), False), (("mask",), True)])
def test_arrays_round_trip(path, omitted, is_open):
    given = {name: value for name, value in result_arrays().items() if name not in omitted}
    file = io.BytesIO() if is_open else path
    save_arrays(file, given)
    loaded = load_arrays(file)
    assert loaded.keys() == given.keys()
    for name, value in given.items():
        assert_array_equal(loaded[name], value, err_msg=name, strict=True)


def test_file_is_plain_numpy_and_reproducible(path):
    """NumPy alone reads the file, whose parameters are JSON; equal arrays give equal bytes."""
    again = path.with_name("result")  # saving does not add a suffix
    for each in (path, again):
        save_arrays(each, result_arrays())
    assert sorted(os.listdir(path.parent)) == ["m.npz", "result"]
    assert path.read_bytes() == again.read_bytes()
    assert len(load_arrays(again)["vertices"]) == 16
    with np.load(path, allow_pickle=False) as file:
        assert file["format_version"] == FORMAT_VERSION
        assert file["parameters"].shape == ()
        assert file["parameters"].dtype.kind == "U"
        assert json.loads(str(file["parameters"]))["tau"] == 1
        assert file["velocity"].shape == (3, 18, 3)


def test_number_types_are_converted(path):
    arrays = result_arrays()
    faces, velocity = arrays["faces"].astype(np.uint16), arrays["velocity"].astype(">f4")
    saved_by_numpy(path, faces=faces, velocity=velocity, residual=1, colour=np.ones(3))
    loaded = load_arrays(path)
    assert loaded["faces"].dtype == np.int64
    assert loaded["velocity"].dtype == loaded["residual"].dtype == np.float64
    assert "colour" not in loaded


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"velocity": None}, ("velocity",)),
        ({"source": None, "target": None}, ("source", "target")),
        ({"format_version": None}, ("format_version",)),
        ({"format_version": FORMAT_VERSION + 1}, ()),
        ({"format_version": 0}, ("format_version", 0)),
        ({"format_version": "one"}, ("one", "format_version")),
        ({"vertices": np.zeros((16, 2))}, ("(16, 2)", 3)),
        ({"faces": np.zeros((0, 3), dtype=int)}, ("(0, 3)",)),
        ({"faces": np.full((18, 3), 16)}, (0, 15)),
        ({"faces": np.full((18, 3), -1)}, (0, 15)),
        ({"faces": np.zeros((18, 3))}, ("float64",)),
        ({"source": np.zeros(16)}, ("source", "(16,)", 16)),
        ({"target": np.zeros((16, 3))}, ("target", "(16, 3)", "(16, 2)")),
        ({"advected": np.zeros((15, 2))}, ("advected", "(15, 2)", "(16, 2)")),
        ({"advected": np.full((16, 2), 1j)}, ("advected", "complex128")),
        ({"velocity": np.zeros((3, 17, 3))}, ("velocity", "(3, 17, 3)", 18, 3)),
        ({"velocity": np.zeros((0, 18, 3))}, ("velocity", "(0, 18, 3)")),
        ({"velocity": np.full((1, 18, 3), np.nan)}, ("velocity",)),
        ({"energy_history": np.full((5, 3), np.inf)}, ("energy_history",)),
        ({"stages": np.zeros(4, dtype=int)}, ("stages", "(4,)", 5)),
        ({"vertex_ids": np.arange(16) + 4}, ("vertex_ids", 0, 18)),
        ({"vertex_ids": np.arange(16)[::-1] + 3}, ("vertex_ids",)),
        ({"weights": np.ones(3)}, ("(3,)", "weights")),
        ({"mask": np.ones(15)}, ("mask", "(15,)")),
        ({"channels_given": 1}, ("channels_given", "int64")),
        ({"stop_reason": b"converged"}, ("stop_reason", "|S9")),
        ({"stop_reason": ["a", "b"]}, ("(2,)", "stop_reason")),
        ({"parameters": "{'tau': 1}"}, ("JSON",)),
        ({"parameters": "[1]"}, ("JSON",)),
        ({"parameters": '{"tau": 1, "more": {"a": 1}}'}, ("JSON",)),
        ({"source": np.array([[{}]], dtype=object)}, ()),
    ],
)
def test_invalid_arrays_are_named(path, change, named):
    saved_by_numpy(path, **change)
    message = error_line(path)
    check_message(message, *named)
    assert re.search(r"\. [A-Z]", message)  # the message advises this option


def test_other_files_are_refused(tmp_path, path):
    for content in (b"", b"OFF\n4 4 0\n", b"\x80\x04N."):
        path.write_bytes(content)
        check_message(error_line(path))
    for name, word in (("readme.txt", "result file"), ("format_version.npy", "format_version")):
        with zipfile.ZipFile(path, "w") as file:
            file.writestr(name, "hello")
        check_message(error_line(path), word)
    check_message(error_line(tmp_path / "none.npz"))
    assert "directory" in error_line(tmp_path)


def test_damage_is_detected(path):
    given = result_arrays()
    save_arrays(path, given)
    content = path.read_bytes()

    def check(loaded):
        assert loaded.keys() == given.keys()
        for name, array in loaded.items():
            assert_array_equal(array, given[name])

    hostile.with_flipped_bits(path, load_arrays, check)
    # the last copy of each name is in the directory of the zip
    for name in given:
        start = content.rindex(f"{name}.npy".encode())
        path.write_bytes(content[:start] + b"~" + content[start + 1 :])
        check_message(error_line(path))
    for length in range(0, len(content), len(content) // 50):
        path.write_bytes(content[:length])
        check_message(error_line(path))


def test_invalid_arrays_are_not_saved(path):
    nans = result_arrays() | {"velocity": np.full((1, 18, 3), np.nan)}
    with raises(ResultError, "m.npz"):
        save_arrays(path, nans)
    with raises(ResultError):
        save_arrays(path, result_arrays() | {"colour": np.ones(3)})
    assert os.listdir(path.parent) == []


SPHERE = with_loose_vertex(icosphere(0))
X, Y, Z = SPHERE.vertices.T
V, F = len(SPHERE.vertices), len(SPHERE.faces)
ONES, FIELD = np.ones((V, 1)), np.ones((1, F, 3))
match_error = partial(refusal, load)


@pytest.fixture(scope="module")
def result():
    return match(SPHERE, X, Y, Parameters.of(iterations=2, levels=1, refine=0), mask=np.ones(V))


@pytest.fixture
def saved(path, result):
    result.save(path)
    return path


def put(path, **arrays):
    hostile.rewrite(path, {f"{name}.npy": array for name, array in arrays.items()})


def test_changed_header_byte_is_detected(saved):
    """A changed byte in the header of an array is detected, although the zip is valid."""

    def same_shape(loaded):
        assert loaded.velocity.shape == (1, F, 3)

    content = members(saved)
    for name in ("velocity.npy", "stop_reason.npy"):
        for changed in hostile.one_byte_changed(content[name], range(128)):
            saved.write_bytes(zipped(content | {name: changed}))
            hostile.load_or_refuse(saved, load, same_shape)


UNKNOWN = '[{"label": "", "words": "", "parameters": {"sigmma": 1}}]'


def parameters(more):
    return np.array(f'{{"tau": 1, {more}}}')


@pytest.mark.parametrize(
    ("name", "value", "named"),
    [
        ("mask", -np.ones(V), ("mask", -1, 0)),
        ("weights", np.array([-0.5]), ("weights", "-0.5")),
        ("residual", np.array(-1.0), ("residual", -1)),
        ("verified_residual", np.array(-1.0), ("verified_residual", -1)),
        ("mask", np.zeros(V), ("mask",)),
        ("weights", np.zeros(1), ("weights",)),
        ("source", 1e200 * ONES, ("source", "1e+200", "-1e+154", "1e+154")),
        ("target", -1e308 * ONES, ("target", "-1e+308")),
        ("advected", 1e155 * ONES, ("advected", "1e+155")),
        ("velocity", 1e300 * FIELD, ("velocity", "1e+300", "1e+154")),
        ("velocity", npy_of("(6442450944,)", data=bytes(8)), ("velocity",)),
        ("velocity", npy_of("(1, 9999999999, 3)", data=bytes(8)), ("velocity",)),
        ("velocity", npy_of("(999999999999999999, 0, 3)", data=bytes(8)), ("velocity",)),
        ("folded", np.array(1.5), ("folded", "1.5", 0, 1)),
        ("folded", np.array(np.nan), ("folded",)),
        ("stages", np.full(3, -1), ("stages",)),
        ("file_vertex_count", np.array(10**8), (100000000, V)),
        ("file_vertex_count", np.array(4 * 10**18), (4000000000000000000,)),
        ("file_vertex_count", np.array(2**63, dtype=np.uint64), (64,)),
        ("format_version", np.zeros((100, 100)), ("format_version",)),
        ("format_version", np.array("x\n" * 5000), ("format_version",)),
        ("format_version", np.array([1]), ("format_version",)),
        ("velocity", np.array("x\n" * 5000), ("velocity",)),
        ("stop_reason", np.array("a\nb"), ()),
        ("stop_reason", np.array("\x1b[31m"), ()),
        ("stop_reason", np.array("a" * 10_001), (10000,)),
        ("parameters", np.array("[" * 9000), ("parameters", "JSON")),
        ("parameters", parameters('"method": "' + "x" * 5000 + '"'), ("method",)),
        ("parameters", parameters('"' + "x" * 5000 + '": 1'), ()),
        ("parameters", parameters('"alpha": ' + "1" * 5000), ()),
        ("parameters", parameters('"tau": true'), ("tau", "True")),
        ("parameters", parameters('"tau": NaN'), ("tau", "nan")),
        ("parameters", parameters('"tau": 1' + 400 * "0"), ("tau",)),
        ("parameters", parameters('"alpha": Infinity'), ("alpha",)),
        ("parameters", parameters('"alpha": [[[[]]]]'), ("alpha", "[[[[]]]]")),
        ("parameters", parameters('"method": []'), ("method", "[]")),
        ("remedies", np.array("[" * 9000), ("remedies", "[[[")),
        ("remedies", np.array('{"a": 1}'), ("remedies",)),
        ("remedies", np.array('[{"label": [], "words": ""}]'), ("label",)),
        ("remedies", np.array('[{"label": "", "words": "", "parameters": 3}]'), ("remedies",)),
        ("remedies", np.array("[{}]"), ("label", "words", "parameters", "starts_from_field")),
        ("remedies", np.array("{"), ("{", "remedies")),
        ("remedies", np.array("3"), (3, "remedies")),
        ("remedies", np.array(UNKNOWN), ("sigmma",)),
        ("verdict", np.array(["pink", "", "", ""]), ("pink",)),
        ("verdict", np.array(["nearly", "pink", "", ""]), ("cause", "pink")),
        ("verdict", np.full((4,), "\ud800").astype("<U1"), ()),
        ("verdict", npy_of("(4,)", "<U1", b"\xff" * 16), ("verdict",)),
        ("channels_given", npy_of("()", "|b1", b"\x02"), (0, 1)),
    ],
)
def test_invalid_values_are_named(saved, name, value, named):
    put(saved, **{name: value})
    check_message(match_error(saved), *named)


def test_unused_vertex_is_refused(saved):
    arrays = load_arrays(saved)
    kept = ~(arrays["faces"] == V - 1).any(axis=1)
    put(saved, faces=arrays["faces"][kept], velocity=arrays["velocity"][:, kept])
    for refused in (match_error, error_line):
        check_message(refused(saved), 1, V)


def test_unused_file_vertices_need_no_memory(saved):
    assert load(saved).mesh.messages == SPHERE.messages
    sparse = saved.with_name("sparse.npz")
    shutil.copy(saved, sparse)
    put(sparse, file_vertex_count=np.array(V + 9_999_999))
    code = (
        "import sys, abfm; from tests import peak_memory\n"
        "abfm.load(sys.argv[1]); before = peak_memory.megabytes()\n"
        "mesh = abfm.load(sys.argv[2]).mesh; print(mesh.file_vertex_count, *mesh.messages)\n"
        "print(peak_memory.megabytes() - before < 8)  # less than a byte for each vertex"
    )
    done = python(code, saved, sparse, check=True, cwd=ROOT)
    assert done.stdout == (
        f"{V + 9_999_999} 9999999 vertices that no face uses were dropped (for example vertex 5)\n"
        "True\n"
    )


def test_extreme_values_are_loaded(saved):
    put(saved, source=1e-160 * ONES, target=1e150 * ONES, velocity=1e140 * FIELD)
    assert load(saved).source.max() == 1e-160
    content = members(saved)
    zeros = npy_of("(100000000,)", "|u1", bytes(100_000_000))
    for unknown, method in ((b"no array", zipfile.ZIP_STORED), (zeros, zipfile.ZIP_DEFLATED)):
        saved.write_bytes(zipped(content | {"unknown.npy": unknown}, method))
        assert load(saved).residual >= 0


def test_decompressed_size_is_limited(saved, tmp_path):
    content = members(saved)
    data = npy_of("(2, 40000000)", "|u1", bytes(80_000_000))
    saved.write_bytes(zipped(content | {"source.npy": data}, zipfile.ZIP_DEFLATED))
    check_message(match_error(saved))
    saved.write_bytes(zipped(content | {"source.npy": bytes(1000)}, zipfile.ZIP_LZMA))
    check_message(match_error(saved))
    names = [f"{number}.npy" for number in range(30)]
    hostile.overlapping_zip(tmp_path / "overlap.npz", names, bytes(4_000_000))
    with (  # newer versions of Python refuse overlapping members earlier
        raises(ResultError, recorded=False),
        open_archive(tmp_path / "overlap.npz", "result", "") as archive,
    ):
        assert all(archive.read(name) for name in names)


def test_invalid_zip_headers_are_refused(saved):
    packed, named = hostile.bomb(64 << 20), bytearray(saved.read_bytes())
    archive = zipped(members(saved) | {"mask.npy": packed})
    named[7] |= 8  # the flag that the first name is UTF-8
    named[30] = 0xFF  # the first letter of the name
    saved.write_bytes(named)
    check_message(match_error(saved), 0, "UTF-8")
    for size in (1 << 40, 100, len(packed) - 1):
        for width in (4, 8):
            truth, lie = (n.to_bytes(width, "little") for n in (len(packed), size % 256**width))
            saved.write_bytes(archive.replace(truth, lie))
            match_error(saved)


def test_result_files_may_be_larger_than_others(path, monkeypatch):
    """Result files, such as sequences of thousands of frames, have a larger limit."""
    save_arrays(path, result_arrays())
    size = path.stat().st_size
    monkeypatch.setattr(regular_files, "FILE_BYTES_MAX", size // 100)
    monkeypatch.setattr(open_regular.__wrapped__, "__defaults__", (size - 1,))
    with raises(OSError, size):
        read_bytes(path, size - 1)
    assert_array_equal(load_arrays(path)["velocity"], result_arrays()["velocity"])
    packed = result_arrays() | {"energy_history": np.zeros((size, 3))}
    np.savez_compressed(path, format_version=FORMAT_VERSION, **packed)
    check_message(error_line(path))  # the limit of compressed data does not change


def test_devices_and_pipes_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    (tmp_path / "zero.npz").symlink_to("/dev/zero")
    (tmp_path / "random.npz").symlink_to("/dev/urandom")
    for name, kind in (("pipe", "pipe"), ("zero", "device"), ("random", "device")):
        check_message(match_error(tmp_path / f"{name}.npz"), kind)


MESH = icosphere(2)


@pytest.fixture(scope="module")
def matched():
    f, g = bump(MESH, [0, 0, 1], 0.2), bump(MESH, [0, 0.8, 0.6], 0.2)
    return match(MESH, f, g, Parameters.of(iterations=60, levels=2, segments=2, refine=0))


@pytest.fixture
def file(matched, path):
    matched.save(path)
    return path


def test_match_is_pickled_without_caches(matched):
    # fills the cache of the mesh, which has a coarser mesh and a lock
    prepare(matched.mesh, Parameters.of(levels=2))
    there = matched.advect([-0.5, 0.5, 1.0])
    sent = pickle.dumps(matched)
    assert len(sent) < 200_000  # with the working memory of flows, the pickle would be larger
    came = pickle.loads(sent)
    assert_array_equal(came.advect([-0.5, 0.5, 1.0]), there)
    assert not came.mesh.vertices.flags.writeable


def test_unknown_values_round_trip(path):
    control, f = Control(), bump(MESH, [0, 0, 1], 0.2)
    control.cancel(skip_checks=True)
    found = match(MESH, f, f[::-1].copy(), control=control)
    found.save(path)
    for one in (found, load(path)):
        assert np.isnan([one.verified_residual, one.folded]).all()
        assert one.stop_reason == "cancelled"


def test_remedies_round_trip(matched, file):
    closer = Remedy("Match closer", "smaller", {"sigma": 0.5, "order": 1})
    remedies = Remedy("Continue", "resume the match", {}, True), closer
    judged = replace(matched, verdict=replace(matched.verdict, remedies=remedies))
    judged.save(file)
    assert load(file).verdict == judged.verdict
    put(file, remedies=None)
    assert load(file).verdict == replace(matched.verdict, remedies=())
