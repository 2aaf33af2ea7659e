"""Meshes for measurements: files and folders of one's own."""

import pytest
import trimesh

from abfm import ParameterError
from benchmarks.meshes import given_meshes
from tests.messages import check_message, raises
from tests.shapes import icosphere

BALL = icosphere(1)


def write(path, *meshes):
    path.parent.mkdir(exist_ok=True)
    parts = [trimesh.Trimesh(each.vertices, each.faces, process=False) for each in meshes]
    trimesh.util.concatenate(parts).export(path)
    return path


def test_files_and_folders_are_read_and_what_cannot_be_is_named(tmp_path):
    small = BALL.normalized()
    write(tmp_path / "men/b.off", BALL, BALL.normalized())
    write(tmp_path / "men/a.ply", small)
    alone = write(tmp_path / "c.obj", BALL)
    (tmp_path / "men/bad.off").write_text("nothing")
    (tmp_path / "men/notes.txt").touch()
    told = []
    found = given_meshes([tmp_path / "men", alone, tmp_path / "none.off"], told.append)
    assert list(found) == ["men/a.ply", "men/b.off", "c.obj"]
    assert found["men/b.off"].length_scale == pytest.approx(BALL.length_scale)
    check_message(told[0], 2)
    assert [line.partition(": ")[0] for line in told[1:]] == ["left out", "left out"]
    assert "bad.off" in told[1]
    check_message(told[2], "none.off")
    with raises(ParameterError, "c.obj"):
        given_meshes([alone, alone], print)
