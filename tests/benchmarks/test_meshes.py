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


def test_meshes_are_read_from_files_and_folders(tmp_path):
    small = BALL.normalized()
    write(tmp_path / "men/b.off", BALL, BALL.normalized())
    write(tmp_path / "men/a.ply", small)
    alone = write(tmp_path / "c.obj", BALL)
    (tmp_path / "men/bad.off").write_text("nothing")
    (tmp_path / "men/notes.txt").touch()
    messages = []
    found = given_meshes([tmp_path / "men", alone, tmp_path / "none.off"], messages.append)
    assert list(found) == ["men/a.ply", "men/b.off", "c.obj"]
    assert found["men/b.off"].length_scale == pytest.approx(BALL.length_scale)
    check_message(messages[0], 2)
    assert [line.partition(": ")[0] for line in messages[1:]] == ["skipped", "skipped"]
    assert "bad.off" in messages[1]
    check_message(messages[2], "none.off")
    with raises(ParameterError, "c.obj"):
        given_meshes([alone, alone], print)
