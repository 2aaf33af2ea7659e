"""Projects and what else the app keeps, as files that lie, wait or bite."""

import json
import os
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from abfm import Parameters, ResultError, match
from abfm_viewer.document.document import Document, Point, Run, Surface
from abfm_viewer.files.autosave import recoverable
from abfm_viewer.files.origin import load_origin
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.files.state_folder import StateFolder
from tests.core.reading.hostile import (
    load_or_refuse,
    members,
    npy_of,
    one_byte_changed,
    overlapping_zip,
    refusal,
    rewrite,
    zipped,
)
from tests.shapes import icosphere

SPHERE = icosphere(0)
X, Y, Z = SPHERE.vertices.T
V, F = len(SPHERE.vertices), len(SPHERE.faces)
DOCUMENT = Document((Surface(SPHERE, "sphere"),))


@pytest.fixture(scope="module")
def result():
    return match(SPHERE, X, Y, Parameters(iterations=2, levels=1), mask=np.ones(V))


@pytest.fixture
def saved(tmp_path, result):
    save_project(tmp_path / "p.abfm", replace(DOCUMENT, result=result), {})
    return tmp_path / "p.abfm"


error_line = partial(refusal, load_project)


def same_shape(opened):
    assert opened[0].result.velocity.shape == (1, F, 3)


def test_one_wrong_byte_of_a_header_is_noticed_though_the_zip_is_whole(saved):
    content = members(saved)
    for changed in one_byte_changed(content["result/velocity.npy"], 128):
        saved.write_bytes(zipped(content | {"result/velocity.npy": changed}))
        load_or_refuse(saved, load_project, same_shape)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"result/mask": -np.ones(V)}, "result/mask has the value -1; expected 0 to inf"),
        ({"result/velocity": np.full((1, F, 3), 1e300)}, "velocity has the value 1e+300"),
        ({"result/weights": np.array([-1.0])}, "result/weights has the value -1"),
        ({"result/velocity": npy_of("(1, 6442450944, 3)", data=bytes(8))}, "result/velocity"),
        ({"mesh/faces": SPHERE.faces[~(SPHERE.faces == 3).any(axis=1)]}, "in no face"),
    ],
)
def test_arrays_that_make_no_sense_are_named(saved, arrays, words):
    rewrite(saved, {f"{name}.npy": array for name, array in arrays.items()})
    assert words in error_line(saved)


@pytest.mark.parametrize(
    ("name", "array"),
    [("stages", np.array([-1])), ("vertices", np.array([-1])), ("reaches", [-0.5])],
)
def test_runs_that_make_no_sense_are_named(tmp_path, name, array):
    course, path = (np.array([V]), np.ones(1)), tmp_path / "p.abfm"
    run = Run(np.ones((1, 3)), np.zeros(1, dtype=np.int64), (), 0.5, "run", *course)
    save_project(path, replace(DOCUMENT, runs=(run,)), {})
    rewrite(path, {f"runs/0/{name}.npy": np.array(array)})
    assert f"runs/0/{name} has the value -" in error_line(path)


@pytest.mark.parametrize(
    ("part", "name", "value", "words"),
    [
        ("", "file_vertex_count", 10**8, f"had 100000000 vertices, and {V} are used"),
        ("", "file_vertex_count", 4 * 10**18, "the mesh file had 4000000000000000000 vertices"),
        ("", "file_vertex_count", 10**30, "vertices, and"),
        ("", "file_vertex_count", -1, "vertex_ids has an index outside"),
        ("", "format_version", [[0] * 100] * 100, "format_version is [[0, 0"),
        ("", "x\n" * 5000, 1, "project is"),
        ("", "known", ["\n" * 5000], "known/0"),
        ("document", "side", "x\n" * 5000, "project.document.side is 'x\\nx"),
        ("document", "time", 10**4000, "too large"),
        ("document", "bump", -(10**4000), "bump is -1000"),
        ("document", "channels", [{"source": "\x1b" * 9999, "target": "hks"}], "a family"),
        ("document", "channels", [{"source": "x" * 99_999, "target": "hks"}], "at most 10000"),
        ("document", "parameters", {"x\n" * 5000: 1}, "project.document.parameters is"),
        ("result", "mismatch", -1, "result/mismatch has the value -1"),
        ("result", "folded", 2, "result/folded has the value 2; expected 0 to 1"),
        ("result", "stop_reason", "a\nb", "some that cannot be shown"),
        ("result", "mismatch", [[1]] * 1000, "result/mismatch has shape (1000, 1)"),
        ("result", "mismatch", [[1], []], "damaged"),
        ("result", "mismatch", {"a": 1}, "result/mismatch has type object"),
    ],
)
def test_headers_that_make_no_sense_are_told_in_one_line(saved, part, name, value, words):
    header = json.loads(members(saved)["project.json"])
    (header[part] if part else header)[name] = value
    rewrite(saved, {"project.json": json.dumps(header).encode()})
    assert words in error_line(saved)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"a":' * 100_000,
        "1" * 100_000,
        "\xff",
        "NaN",
        "-Infinity",
        '"' + "x" * 100_000,
        '"\\ud800"',
    ],
)
def test_json_that_is_no_header_is_refused(saved, text):
    rewrite(saved, {"project.json": text.encode("latin-1")})
    assert "no project of abfm, or damaged" in error_line(saved)
    assert not re.search("codec|set_int_max", error_line(saved))


def test_what_is_not_an_array_is_small(saved):
    rewrite(saved, {"project.json": members(saved)["project.json"] + b" " * (2 << 20)})
    assert "project.json has" in error_line(saved)
    many = replace(DOCUMENT, points=(Point(0, (1.0, 0.0, 0.0)),) * 30_000)
    with pytest.raises(ResultError, match=r"not written: it has \d+ bytes besides its arrays"):
        save_project(saved, many, {})


def test_only_members_that_belong_to_a_project_are_read(saved):
    rewrite(saved, {"unknown.npy": b"no array", "runs/7/stages.npy": b"none"})
    assert load_project(saved)[0].name == "sphere"


def test_devices_pipes_and_overlapping_zips_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.abfm")
    (tmp_path / "zero.abfm").symlink_to("/dev/zero")
    assert "it is a pipe" in error_line(tmp_path / "pipe.abfm")
    assert "it is a device" in error_line(tmp_path / "zero.abfm")
    overlapping_zip(tmp_path / "a.abfm", ["project.json", "mesh/faces.npy"], b"{}")
    assert "damaged" in error_line(tmp_path / "a.abfm")
    for name in ("pipe.abfm", "zero.abfm", "a.abfm"):
        assert load_origin(tmp_path / name) is None


def test_a_state_folder_of_pipes_and_devices_is_empty(tmp_path):
    folder = StateFolder(tmp_path)
    os.mkfifo(tmp_path / "recent.json")
    (tmp_path / "preferences.json").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "autosave-1-left.abfm")
    assert folder.recent() == []
    assert folder.preferences() == {}
    [copy] = recoverable(folder)
    assert load_origin(copy.path) is None
    assert "it is a pipe" in error_line(copy.path)
    (tmp_path / "recent.json").unlink()
    (tmp_path / "recent.json").write_text("[" + '"a",' * 300_000 + '"a"]')
    assert folder.recent() == []
