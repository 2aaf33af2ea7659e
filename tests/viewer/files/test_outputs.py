"""Files that cannot be written are refused before anything is computed for them."""

import tempfile
from pathlib import Path

import numpy as np
import pytest

import abfm
from abfm import (
    Correspondence,
    PointMap,
    Registration,
    ResultError,
    load_match,
    load_registration,
)
from abfm_viewer.files import outputs
from tests.messages import raises
from tests.shapes import icosphere, with_loose_vertex


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("result.txt", ".npz"),
        ("no folder/result.npz", "folder"),
        ("folder.npz", "folder"),
    ],
)
def test_paths_that_cannot_be_written_are_refused(tmp_path, name, named):
    (tmp_path / "folder.npz").mkdir()
    with raises(ResultError, named):
        outputs.check(tmp_path / name, [".npz"])
    outputs.check(tmp_path / "result.npz", [".npz"])
    assert [path.name for path in tmp_path.iterdir()] == ["folder.npz"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder in which nobody may write")
def test_a_folder_that_takes_no_files_is_refused():
    with raises(ResultError, "/proc/self/result.npz"):
        outputs.check(Path("/proc/self/result.npz"), [".npz"])


@pytest.fixture(scope="module")
def match():
    mesh = icosphere(1)
    x, y, _ = mesh.vertices.T
    return abfm.match(mesh, x, y, abfm.Parameters(iterations=1, levels=1, refine=0))


@pytest.mark.parametrize(
    "names", [["gone/m.npz"], ["gone/m.npz", "m.vtu"], ["m.csv", "gone/m.ply"]]
)
def test_a_result_whose_place_has_gone_is_written_elsewhere(names, match, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with raises(ResultError) as told:
        outputs.write_all([tmp_path / name for name in names], match)
    written = {name for name in names if "/" not in name}
    (kept,) = (path for path in tmp_path.iterdir() if path.name not in written)
    assert {path.name for path in tmp_path.iterdir()} == written | {kept.name}
    assert str(told.value).endswith(kept.name)
    assert load_match(kept).residual == match.residual


def test_a_registration_with_collapsed_faces_is_kept(match, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    numbers = np.arange(len(match.mesh.vertices))
    maps = (PointMap.of_vertices(match.mesh, match.mesh, numbers // by) for by in (1, 2))
    found = Registration(Correspondence(*maps), match)
    with raises(ResultError, "x.ply"):
        outputs.write_registrations([tmp_path / "x.ply", tmp_path / "r.npz"], found)
    kept = load_registration(tmp_path / "r.npz")
    np.testing.assert_array_equal(kept.back.faces, found.back.faces)


def test_a_result_that_one_file_holds_is_not_written_elsewhere(match, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with raises(ResultError, "gone"):
        outputs.write_all([tmp_path / "gone" / "m.vtu", tmp_path / "m.npz"], match)
    assert [path.name for path in tmp_path.iterdir()] == ["m.npz"]


def test_a_result_without_any_place_is_told(match, tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "none")
    monkeypatch.setattr(Path, "cwd", lambda: tmp_path / "none")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    with raises(ResultError, "gone"):
        outputs.write_all([tmp_path / "gone" / "m.npz"], match)


def test_a_surface_whose_rows_would_not_be_those_of_its_file_is_refused(tmp_path):
    loose = with_loose_vertex(icosphere(1))
    found = abfm.register(loose, loose, "coordinate:x", "coordinate:x")
    with raises(ResultError, 1):
        outputs.write_registration(tmp_path / "lh.sphere.reg", found)
    assert list(tmp_path.iterdir()) == []
