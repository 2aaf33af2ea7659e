"""Projects of the version that had one camera for all surfaces look as they did.

The files in `older/` were written by that version, in a window of 900 by 600: `turned.abfm` after a drag of the mouse,
`near.abfm` with the camera three times as near to a point of the target.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from abfm_viewer.automation import Driver
from abfm_viewer.files.project import load_project, save_project

OLDER = Path(__file__).parent / "older"
POINT = (0.2, 0.1, 0.0)  # of the mesh, at which the near camera looked


def camera(name: str) -> dict[str, list[float]]:
    """The camera as the file has it."""
    with zipfile.ZipFile(OLDER / name) as archive:
        found = json.loads(archive.read("project.json"))["document"]["view"]["camera"]
    return {key: np.array(value) for key, value in found.items()}


@pytest.mark.parametrize("name", ["turned.abfm", "near.abfm"])
def test_the_surfaces_are_seen_from_the_same_side(name):
    document, _ = load_project(OLDER / name)
    then, look = camera(name), document.view.look
    backward = then["position"] - then["target"]
    np.testing.assert_allclose(look.front.direction, backward / np.linalg.norm(backward), atol=1e-6)
    np.testing.assert_allclose(look.front.up, then["up"], atol=1e-6)
    assert document.view.layout == "row"
    assert document.view.isolines


def test_a_camera_that_saw_all_surfaces_sees_them_all_now():
    look = load_project(OLDER / "turned.abfm")[0].view.look
    assert (look.zoom, look.target) == (1.0, None)


def test_a_near_camera_is_as_near_to_the_same_point():
    document, _ = load_project(OLDER / "near.abfm")
    np.testing.assert_allclose(document.view.look.target, POINT, atol=1e-5)  # of single precision
    then = camera("near.abfm")
    with Driver(OLDER / "near.abfm", size=(900, 600)) as gui:
        _, top, _, bottom = gui.window.parts.scene
        distance = np.linalg.norm(then["position"] - then["target"])
        pixels = (bottom - top) / (2 * distance * np.tan(np.radians(then["angle"] / 2)))
        now = gui.window.scene.view.scale / gui.session.mesh.length_scale
        assert now == pytest.approx(pixels, rel=0.3)
        middle = gui.window.scene.projected("target", np.array(POINT))[0, :2]
        np.testing.assert_allclose(middle, gui.window.scene.view.slots["target"].middle, atol=1e-3)


def test_saved_again_it_is_a_project_of_now(tmp_path):
    document, known = load_project(OLDER / "near.abfm")
    save_project(tmp_path / "again.abfm", document, known)
    assert load_project(tmp_path / "again.abfm")[0].view == document.view
