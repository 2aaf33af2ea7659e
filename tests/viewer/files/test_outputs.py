import dataclasses
import math
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import abfm
from abfm import Correspondence, PointMap, Registration, ResultError, load
from abfm.matching.task import MatchTask
from abfm.tasks import Export
from abfm_viewer.files import outputs
from tests.messages import raises
from tests.shapes import icosphere, with_loose_vertex


@pytest.mark.parametrize(
    ("name", "named"),
    [("result.txt", ".npz"), ("no folder/result.npz", "folder"), ("folder.npz", "folder")],
)
def test_paths_that_cannot_be_written_are_refused(tmp_path, name, named):
    (tmp_path / "folder.npz").mkdir()
    with raises(ResultError, named):
        outputs.check(tmp_path / name, [".npz"])
    outputs.check(tmp_path / "result.npz", [".npz"])
    assert [path.name for path in tmp_path.iterdir()] == ["folder.npz"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder in which nobody may write")
def test_read_only_folder_is_refused():
    with raises(ResultError, "/proc/self/result.npz"):
        outputs.check(Path("/proc/self/result.npz"), [".npz"])


@pytest.fixture(scope="module")
def match():
    mesh = icosphere(1)
    x, y, _ = mesh.vertices.T
    return abfm.match(mesh, x, y, abfm.Parameters.of(iterations=1, levels=1, refine=0))


@pytest.mark.parametrize(
    "names", [["gone/m.npz"], ["gone/m.npz", "m.vtu"], ["m.csv", "gone/m.ply"]]
)
def test_result_is_saved_elsewhere_if_its_folder_is_gone(names, match, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with raises(ResultError, "gone") as error:
        outputs.write_all([tmp_path / name for name in names], match)
    written = {name for name in names if "/" not in name}
    (saved,) = (path for path in tmp_path.iterdir() if path.name not in written)
    assert {path.name for path in tmp_path.iterdir()} == written | {saved.name}
    assert str(error.value).endswith(saved.name)
    assert load(saved).residual == match.residual


def refuse(*_):
    raise TypeError("a part cannot be made")


PARTS = ["result.path_arrays", "problem.Problem.spec_arrays"]


@pytest.mark.parametrize("part", PARTS)
def test_result_is_saved_without_a_part_that_fails(part, match, tmp_path, monkeypatch):
    monkeypatch.setattr(f"abfm.matching.{part}", refuse)
    [note] = outputs.write_all([tmp_path / "m.npz", tmp_path / "m.csv"], match)
    assert "a part cannot be made" in note
    assert "m.npz" in note
    assert "\n" not in note
    loaded = load(tmp_path / "m.npz")
    np.testing.assert_array_equal(loaded.fine_velocity, match.fine_velocity)
    assert (loaded.residual, loaded.verdict.kind) == (match.residual, match.verdict.kind)
    assert loaded.parameters == match.parameters
    assert (tmp_path / "m.csv").exists()


WRONG = {
    "advected": lambda match: np.full_like(match.advected, np.nan),
    "energy_history": lambda match: np.full_like(match.energy_history, np.inf),
    "stages": lambda match: match.stages[:-1],
    "residual": lambda _: math.inf,
    "verified_residual": lambda _: -1.0,
    "folded": lambda _: 2.0,
    "stop_reason": lambda _: 7,
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_numbers_do_not_lose_a_result(name, match, tmp_path):
    """Numbers that disagree with the field are computed again when the file is loaded."""
    wrong = dataclasses.replace(match, **{name: WRONG[name](match)})
    [note] = outputs.write_all([tmp_path / "m.npz"], wrong)
    assert "m.npz" in note
    loaded = load(tmp_path / "m.npz")
    np.testing.assert_array_equal(loaded.fine_velocity, match.fine_velocity)
    np.testing.assert_allclose(loaded.advected, match.advected, atol=1e-9)
    assert loaded.residual == pytest.approx(match.residual, rel=1e-6)


def test_registration_is_saved_without_its_path(match, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules["abfm.matching.result"], "path_arrays", refuse)
    same = PointMap.of_vertices(match.mesh, match.mesh, np.arange(len(match.mesh.vertices)))
    found = Registration(Correspondence(same, same), match)
    [note] = outputs.write_all([tmp_path / "r.npz"], found)
    assert "a part cannot be made" in note
    loaded = load(tmp_path / "r.npz")
    np.testing.assert_array_equal(loaded.match.velocity, match.velocity)


def test_sequence_is_saved_without_its_numbers(match, tmp_path):
    found = abfm.sequence(match.mesh, np.stack([match.source[:, 0], match.target[:, 0]]))
    wrong = dataclasses.replace(found, residual=-found.residual, verdicts=())
    [note] = outputs.write_all([tmp_path / "s.npz"], wrong)
    assert "residual" in note
    assert "verdicts" in note
    loaded = abfm.load(tmp_path / "s.npz")
    np.testing.assert_array_equal(loaded.velocity, found.velocity)
    assert np.isnan(loaded.residual).all()
    assert not loaded.verdicts[0].kind.is_good


def test_failing_writer_loses_no_result(match, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(MatchTask.exports, ".ply", Export(refuse))
    with pytest.raises(ResultError, match="a part cannot be made") as error:
        outputs.write_all([tmp_path / "m.ply"], match)
    saved = Path(str(error.value).rpartition("the result is in ")[2])
    assert load(saved).residual == match.residual


def test_registration_with_collapsed_faces_is_saved(match, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    numbers = np.arange(len(match.mesh.vertices))
    maps = (PointMap.of_vertices(match.mesh, match.mesh, numbers // by) for by in (1, 2))
    found = Registration(Correspondence(*maps), match)
    with raises(ResultError, "x.ply", recorded=False):  # abbreviated if the path is long
        outputs.write_all([tmp_path / "x.ply", tmp_path / "r.npz"], found)
    saved = load(tmp_path / "r.npz")
    np.testing.assert_array_equal(saved.back.faces, found.back.faces)


def test_saved_result_is_not_written_elsewhere(match, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with raises(ResultError, "gone"):
        outputs.write_all([tmp_path / "gone" / "m.vtu", tmp_path / "m.npz"], match)
    assert [path.name for path in tmp_path.iterdir()] == ["m.npz"]


def test_result_that_cannot_be_saved_is_reported(match, tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "none")
    monkeypatch.setattr(Path, "cwd", lambda: tmp_path / "none")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    with raises(ResultError, "gone"):
        outputs.write_all([tmp_path / "gone" / "m.npz"], match)


def test_surface_with_other_rows_than_its_file_is_refused(tmp_path):
    loose = with_loose_vertex(icosphere(1))
    found = abfm.register(loose, loose, "coordinate:x", "coordinate:x")
    with raises(ResultError, 1):
        outputs.write(tmp_path / "lh.sphere.reg", found)
    assert list(tmp_path.iterdir()) == []
