import os
import pickle
import shutil

import numpy as np
import pytest

import abfm
from abfm.assets import asset_path
from abfm.batch import Row, kind_of, problem_row
from abfm.errors import ParameterError
from tests.core.batch.rows import BRIEF, pair
from tests.messages import raises

EIGHT = abfm.load_mesh(asset_path("eight.off"))
COUNT = len(EIGHT.vertices)


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "one"
    place.mkdir()
    shutil.copy(asset_path("eight.off"), place / "m.off")
    for seed, name in enumerate(("f.npy", "g, h.npy", "mask.npy")):
        np.save(place / name, np.random.default_rng(seed).random(COUNT))
    np.savetxt(place / "map.txt", np.arange(COUNT)[::-1], fmt="%d")
    return place


OPTIONS = {
    "mesh": "m.off",
    "source": 'file:f.npy + permuted:map.txt(file:path="g, h.npy")',
    "target": "gaussian:vertex=9,width=0.2",
    "mask": "mask.npy",
    "channel": "'file:\"g, h.npy\"' curvature:mean 0.5",
    "alpha": 0.02,
}


MATCH = {"mesh": "m.off", "source": "curvature:mean", "target": "curvature:mean"}


def test_digest_of_a_match_is_that_of_its_problem(folder, monkeypatch):
    row = Row("one", OPTIONS, folder)
    monkeypatch.chdir(folder)
    channel = 'file:"g, h.npy"', "curvature:mean"
    problem = abfm.Problem(
        EIGHT,
        [OPTIONS["source"], channel[0]],
        [OPTIONS["target"], channel[1]],
        abfm.Parameters(alpha=0.02),
        mask=np.load("mask.npy"),
        weights=[1, 0.5],
    )
    monkeypatch.chdir("/")
    assert row.digest == problem.digest
    assert Row("one", OPTIONS, folder).task().digest == problem.digest
    alone = pair(alpha=0.1)
    f, g = (f"gaussian:vertex={i},width=0.3" for i in (0, 9))
    brief = {name.replace("-", "_"): value for name, value in BRIEF.items()}
    assert alone.digest == abfm.Problem(EIGHT, f, g, abfm.Parameters.of(alpha=0.1, **brief)).digest


def test_digest_depends_on_max_distortion():
    assert len({pair().digest, *(pair(**{"max-distortion": n}).digest for n in (1, 2))}) == 3


def test_key_depends_on_contents_and_values_only(folder, tmp_path):
    row = Row("one", OPTIONS, folder)
    other = tmp_path / "other"
    shutil.copytree(folder, other)
    os.utime(other / "f.npy", (1, 1))
    assert Row("two", OPTIONS, other).key == row.key
    assert Row("one", OPTIONS | {"alpha": "2e-2"}, folder).key == row.key
    assert Row("one", OPTIONS | {"alpha": 0.03}, folder).key != row.key
    for name in ("m.off", "f.npy", "g, h.npy", "mask.npy", "map.txt"):
        before = (other / name).read_bytes()
        (other / name).write_bytes(before[:-1] + bytes([before[-1] ^ 1]))
        assert Row("one", OPTIONS, other).key != row.key
        (other / name).unlink()
        assert Row("one", OPTIONS, other).key != row.key
        (other / name).write_bytes(before)
    assert Row("one", OPTIONS, other).key == row.key


def test_relocated_row_has_the_same_digest(folder, tmp_path):
    row = Row("one", OPTIONS, folder)
    names = {"m.off", "f.npy", "g, h.npy", "mask.npy", "map.txt"}
    assert {*row.files()} == {str(folder / name) for name in names}
    digest, places = row.digest, {}
    for number, path in enumerate(row.files()):
        place = tmp_path / f"moved {number}"
        place.mkdir()
        places[path] = shutil.move(path, place)
    moved = row.relocated(places)
    assert (moved.digest, moved.key) == (digest, row.key)
    with raises(abfm.AbfmError):
        row.task()


def test_companion_files_change_the_key(tmp_path):
    """Buffers of a glTF file and the .vts file of a symmetry belong to the files of a row."""
    (tmp_path / "m.gltf").write_text('{"buffers": [{"uri": "far%20away.bin"}, {"uri": "data:xx"}]}')
    (tmp_path / "far away.bin").write_bytes(b"1")
    (tmp_path / "t.vts").write_text("1\n")
    (tmp_path / "t.sym.vts").write_text("1\n")
    target = "permuted:t.sym.vts(curvature:mean)"
    row = Row("r", {"mesh": "m.gltf", "source": "curvature:mean", "target": target}, tmp_path)
    names = ("m.gltf", "far away.bin", "t.sym.vts", "t.vts")
    assert row.files() == [str(tmp_path / name) for name in names]
    before = row.key
    (tmp_path / "far away.bin").write_bytes(b"2")
    assert Row("r", row.options, tmp_path).key != before


def test_kind_follows_from_columns():
    assert kind_of({"mesh": "m.off", "a": "a.off"}).kind == "match"
    assert kind_of({"a": "a.off"}).kind == "registration"
    assert kind_of({"problem": "p.npz"}).kind == "problem"


def test_files_of_initial_maps_are_listed(tmp_path):
    words = {
        "sphere:mirror,l.gii,r.gii": ["l.gii", "r.gii"],
        "file:map.vts": ["map.vts"],
        "closest:rigid": [],
        "sphere": [],
    }
    options = {"a": "a.off", "b": "b.off", "landmarks": "l.csv"}
    for word, names in words.items():
        row = Row("r", options | {"initial": word}, tmp_path)
        assert row.kind == "registration"
        found = [os.path.basename(path) for path in row.files()]
        assert found == ["a.off", "b.off", "l.csv", *names]
        assert row.values()["initial"].startswith(word.partition("l.gii")[0].partition("map")[0])


def test_pickled_row_is_small_and_equal(folder):
    row = Row("one", OPTIONS, folder)
    content = pickle.dumps(row)
    assert len(content) < 2000
    other = pickle.loads(content)
    assert other == row
    assert other.key == row.key


def test_problem_from_python_is_written_once(tmp_path):
    x, y, z = EIGHT.vertices.T
    problem = abfm.Problem(EIGHT, np.stack([x, y], 1), np.stack([y, z], 1), mask=np.abs(z))
    row = problem_row(problem, tmp_path, "xyz")
    assert row.digest == problem.digest
    path = tmp_path / "problems" / f"{problem.digest}.npz"
    written = path.stat().st_mtime_ns
    assert problem_row(problem, tmp_path).key == row.key
    assert path.stat().st_mtime_ns == written
    assert problem_row(problem, tmp_path, max_distortion=1.5).digest != problem.digest


def test_problem_row_works_in_a_relative_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    problem = abfm.Problem(EIGHT, "coordinate:x", "coordinate:y")
    for folder in ("results", "~/results"):
        monkeypatch.setenv("HOME", str(tmp_path / "home"))
        assert problem_row(problem, folder).digest == problem.digest
    assert {path.name for path in tmp_path.iterdir()} == {"results", "home"}


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({}, ("frames", "mesh")),
        ({"mesh": "m.off"}, ("source", "target")),
        ({"mesh": "m.off", "source": "curvature:mean"}, ("source", "target")),
        ({"a": "a.off", "source": "curvature:mean"}, ("b",)),
        ({"a": "a.off", "b": "b.off"}, ()),
        ({"mesh": "m.off", "landmarks": "l.csv"}, ("landmarks",)),
        ({"mesh": "m.off", "iterations": "1.5"}, ("iterations",)),
        ({"mesh": "m.off", "alpha": [1]}, ("[1]",)),
        ({"mesh": "m.off", "sigma": "auto", "alpha": "auto"}, ("auto", "alpha")),
        ({"mesh": "m.off", "method": "fast"}, ("method", "nonlinear", "linearised")),
        ({"mesh": "m.off", "source": "gausian:vertex=1"}, ("gaussian",)),
        ({"mesh": "m.off", "channel": "curvature:mean 1"}, ("channel",)),
        ({"mesh": "m.off", "channel": "curvature:mean curvature:mean x"}, ("channel",)),
        ({"mesh": "m.off", "channel": "curvature:mean nothing:1 1"}, ("channel", "nothing")),
        ({"mesh": "m.off", "largest-component": "maybe"}, ("largest-component",)),
        ({"mesh": "m.off", "merge": "near"}, ("merge", "near")),
        ({"mesh": "m.off", "merge": "-1"}, ("merge", "-1.0")),
        ({"frames": "f.npy", "mesh": "m.off", "hemisphere": "X"}, ("hemisphere", "L", "R")),
        ({"mesh": "m.off", "max-distortion": "0"}, ("max-distortion",)),
        ({"a": "a.off", "b": "b.off", "initial": "closset"}, ("initial",)),
        ([("mesh", "m.off"), ("mesh", "n.off")], ("mesh",)),
        (MATCH | {"stage-iterations": 50, "cooling-stages": 9, "iterations": 100}, (50,)),
        ({"frames": "f.npy", "mesh": "m.off", "dt": 0}, ("dt", 0)),
        ({"frames": "f.npy", "mesh": "m.off", "gamma": -1}, ("gamma", 0)),
        ({"frames": "f.npy", "mesh": "m.off", "channel": "1 -1"}, ("channel", 0)),
        ({"frames": "f.npy", "mesh": "m.off", "segments": 2}, ("segments",)),
        ({"frames": "f.npy"}, ("mesh",)),
    ],
)
def test_invalid_options_are_refused_with_column(options, named):
    with raises(ParameterError, *named):
        Row("r", options)
