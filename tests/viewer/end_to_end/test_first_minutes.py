"""What newcomers do in their first minutes, by mouse and keyboard: ten stories, each from a fresh window."""

from __future__ import annotations

import shutil
from dataclasses import replace

import av
import numpy as np
import pytest
from PIL import Image

from abfm.assets import asset_path
from abfm_viewer.automation import Driver
from tests.viewer.sessions import SIZE

LEFT_HAND, LEFT_FOOT = 276, 526  # of the human


@pytest.fixture
def human(tmp_path):
    with Driver(asset_path("human_A.off"), size=SIZE) as gui:
        gui.window.dialogs.folder = tmp_path
        yield gui
        assert not gui.errors


def ready(session):
    return not session.obstacle


def finished(session):
    return session.solver.finished


def exported(gui, path):
    """Name the file that a dialog asks for, and wait until it is written."""
    gui.type("file name", path.name, enter=False)
    gui.click("Save")
    gui.wait(lambda _: path.exists() and not gui.window.exporter.running, 120)


def test_open_match_and_see_the_flow(human, tmp_path):
    gui = human
    shutil.copy(asset_path("human_A.off"), tmp_path / "somebody.off")
    gui.menu("File", "Open mesh...")
    gui.double_click("somebody.off")
    gui.wait(lambda s: s.document.name == "somebody.off" and ready(s))
    gui.click("Match")
    gui.wait(finished, 120)
    gui.wait(lambda s: s.player.playing, 10)
    assert gui.session.time < gui.session.parameters.tau
    gui.wait(lambda s: not s.player.playing, 20)
    assert gui.session.time == gui.session.parameters.tau
    view = gui.session.view
    assert view.streaks or view.arrows
    assert gui.session.result.verdict.kind in ("matched", "nearly")


def test_two_channels(gui):
    gui.click("Add")
    gui.choose("family", "eigenfunction", within="source")
    gui.choose("family", "eigenfunction", within="target")
    gui.wait(ready)
    gui.click("Match")
    gui.wait(finished, 120)
    assert gui.session.result.source.shape[1] == 2


def test_change_sigma_while_it_runs(gui):
    gui.click("Match")
    gui.wait(lambda s: s.solver.snapshot is not None)
    gui.drag("sigma", 0.1)
    gui.wait(finished, 120)
    assert gui.session.result.parameters.sigma == pytest.approx(0.1, rel=0.2)
    assert gui.session.document.runs[-1].restarts


def test_export_a_picture_and_a_movie(gui, tmp_path):
    exporter = gui.window.exporter
    exporter.picture = replace(exporter.picture, width=400, height=300)  # the rest takes no user's time, but the test's
    exporter.movie = replace(exporter.movie, seconds=0.5, fps=10)
    gui.click("Match")
    gui.wait(finished, 120)
    gui.click("Save picture...")
    exported(gui, tmp_path / "flow.png")
    gui.click("Save movie...")
    exported(gui, tmp_path / "flow.mp4")
    picture = np.asarray(Image.open(tmp_path / "flow.png").convert("RGB"), dtype=float)
    assert picture.std() > 5
    with av.open(tmp_path / "flow.mp4") as movie:
        first, *_, last = [frame.to_ndarray(format="rgb24").astype(int) for frame in movie.decode(video=0)]
    assert np.abs(first - last).mean() > 0.5


def test_compare_with_optimal_transport(gui):
    gui.click("Match")
    gui.wait(finished, 120)
    gui.check("optimal transport")
    gui.wait(lambda _: "optimal transport" in gui.window.scene.paints, 60)
    paints = gui.window.scene.paints
    assert not np.allclose(paints["optimal transport"].values, paints["source"].values)
