import numpy as np
import pytest

from abfm_viewer.document.document import Surface
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files.project import save_project
from abfm_viewer.window.previews import read_preview
from tests.mesh_writers import off_file
from tests.shapes import icosphere
from tests.viewer.sessions import PAIR, SPHERE, matched


@pytest.mark.parametrize("name", ["ball.off", "draft.abfm", "result.npz"])
def test_meshes_projects_and_results_have_pictures(tmp_path, session, name):
    path = tmp_path / name
    if path.suffix == ".off":
        off_file(path, icosphere(2))
    elif path.suffix == ".abfm":
        save_project(path, MatchDocument((Surface(SPHERE, "ball"),), (PAIR,)), {})
    else:
        matched(session).result.save(path)
    picture, lines = read_preview(path)
    pixels = np.asarray(picture)
    assert (pixels[..., 3] > 0).mean() > 0.2
    reds, blues = pixels[..., 0].astype(float), pixels[..., 2].astype(float)
    has_colors = bool(np.abs(reds - blues).max() > 30)
    assert has_colors is (path.suffix != ".off")
    assert any("vertices" in line for line in lines)


def test_a_damaged_file_has_the_reason_instead_of_a_picture(tmp_path):
    (tmp_path / "bad.off").write_text("OFF\n3 1")
    picture, [line] = read_preview(tmp_path / "bad.off")
    assert picture is None
    assert line
