"""What newcomers do in their first minutes, by mouse and keyboard: ten stories, each from a
fresh window.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import av
import numpy as np
import pytest
from PIL import Image

from abfm.assets import asset_path
from abfm_viewer.automation import Driver
from tests.mesh_writers import off_file, off_text
from tests.shapes import ellipsoid, icosphere
from tests.viewer.sessions import SIZE

TOP, BOTTOM = "gaussian:x=0,y=0,z=1,width=0.15", "gaussian:x=0.5,y=0,z=-0.87,width=0.15"
_WORK = """
import sys
from functools import partial
from pathlib import Path
from abfm_viewer.automation import Driver
from abfm_viewer.window import recovery
from tests.viewer.sessions import ENDLESS
mesh, state = map(Path, sys.argv[1:])
recovery.Autosave = partial(recovery.Autosave, seconds=0.5)
with Driver(mesh, size=(640, 480), state=state) as gui:
    gui.window.dialogs.folder = mesh.parent
    gui.wait(lambda session: not session.obstacle)
    gui.session.editor.amend(parameters=ENDLESS)
    gui.key("ctrl+s")
    gui.type("file name", "work.abfm", enter=False)
    gui.click("Save")
    gui.wait(lambda session: session.saves.path and not session.saves.unsaved)
    gui.click("Match")
    gui.wait(lambda session: session.solver.snapshot is not None)
    (state / "matching").touch()  # copies from now on hold the run
    while True:
        gui.window.frame()
"""


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


def test_far_pair_verdict_and_remedy(gui):
    gui.type("spec", TOP, within="source")
    gui.type("spec", BOTTOM, within="target")
    gui.type("reach", "0")
    gui.type("iterations", "8")
    gui.wait(ready)
    gui.click("Match")
    gui.wait(finished, 60)
    assert gui.session.result.verdict.kind == "not reached"
    gui.click(gui.session.result.verdict.remedies[0].label, within="verdict")
    gui.wait(finished, 120)
    assert gui.session.result.verdict.kind == "matched"


def test_wrong_mesh_card_and_remedy(gui, tmp_path):
    small, large = icosphere(1), icosphere(2)
    vertices = np.concatenate([small.vertices, 2 * large.vertices + 9])
    both = off_text(vertices, np.concatenate([small.faces, large.faces + len(small.vertices)]))
    (tmp_path / "two.off").write_text(both)
    (tmp_path / "cut.off").write_text(both[: len(both) // 2])
    (tmp_path / "letter.obj").write_text("Dear reader")
    gui.window.dialogs.folder = tmp_path
    was = gui.session.surface().mesh
    for name, told in (
        ("letter.obj", "the mesh has no vertices"),
        ("cut.off", "the file is cut off"),
    ):
        gui.menu("File", "Open mesh...")
        gui.double_click(name)
        gui.wait(lambda s: s.notices.cards and not s.loading.replacing)
        assert told in gui.session.notices.cards[0].text
        assert gui.session.surface().mesh is was
    gui.click("Open another mesh...", within="message 1")
    gui.double_click("two.off")
    gui.wait(lambda s: s.notices.cards and "two.off" in s.notices.cards[0].text)
    gui.click("Open the largest component")
    gui.wait(lambda s: s.document.name == "two.off" and ready(s))
    assert len(gui.session.surface().mesh.vertices) == len(large.vertices)
    assert gui.session.notices.cards == ()


def test_nonsense_is_refused_stays_and_is_mended(gui):
    reasons = gui.window.ui.refusals.reasons
    before = gui.session.document
    gui.type("spec", "gausian:vertex=12", within="source")
    assert ["did you mean 'gaussian'" in reason for reason in reasons.values()] == [True]
    assert gui.text_of("spec", "source", "box") == "gausian:vertex=12"
    gui.type("width", "fat", within="target")
    assert len(reasons) == 2
    assert gui.text_of("width", "target", "box") == "fat"
    assert gui.session.document is before
    gui.type("width", "0.2", within="target")
    gui.type("spec", "gaussian:vertex=12", within="source")
    gui.wait(ready)
    assert not reasons
    assert gui.session.active.source == "gaussian:vertex=12"
    assert "width=0.2" in gui.session.active.target


def test_two_channels(gui):
    gui.click("Add")
    gui.choose("family", "eigenfunction", within="source")
    gui.choose("family", "eigenfunction", within="target")
    gui.wait(ready)
    gui.click("Match")
    gui.wait(finished, 120)
    assert gui.session.result.source.shape[1] == 2


def test_a_figure_from_samples(gui):
    gui.menu("Samples", "Figure 11")
    gui.wait(lambda s: gui.window.files.sample == "Figure 11" and ready(s), 60)
    gui.click("Match")
    gui.wait(
        lambda s: s.solver.snapshot is not None and s.solver.snapshot.iteration.iteration > 5, 60
    )
    gui.click("Cancel")
    gui.wait(finished)
    assert not gui.session.outdated
    assert gui.session.result.mismatch < 1


def test_change_sigma_while_it_runs(running):
    gui = running
    gui.drag("sigma", 0.1)
    gui.wait(lambda s: s.solver.snapshot.problem.parameters.sigma > 0.05)
    gui.click("Cancel")
    gui.wait(finished, 120)
    assert gui.session.result.parameters.sigma == pytest.approx(0.1, rel=0.2)
    assert gui.session.document.runs[-1].restarts


def test_export_a_picture_and_a_movie(gui, tmp_path):
    exporter = gui.window.exporter
    # the rest takes no user's time, but the test's
    exporter.picture = replace(exporter.picture, width=400, height=300)
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
        first, *_, last = [
            frame.to_ndarray(format="rgb24").astype(int) for frame in movie.decode(video=0)
        ]
    assert np.abs(first - last).mean() > 0.5


def test_compare_with_optimal_transport(gui):
    gui.click("Match")
    gui.wait(finished, 120)
    gui.check("optimal transport")
    gui.wait(lambda _: "optimal transport" in gui.window.scene.paints, 60)
    paints = gui.window.scene.paints
    assert not np.allclose(paints["optimal transport"].values, paints["source"].values)


def test_save_kill_and_recover(tmp_path):
    egg, state = ellipsoid(2, 1, 0.7, 0.55), tmp_path / "state"
    mesh = off_file(tmp_path / "egg.off", egg)
    command = [sys.executable, "-c", _WORK, str(mesh), str(state)]
    app = subprocess.Popen(command, stderr=subprocess.PIPE)
    try:
        end = time.monotonic() + 60
        while not ((state / "matching").exists() and list(state.glob("autosave-*.abfm"))):
            assert app.poll() is None, "the app ended"
            assert time.monotonic() < end, "no copy was written"
            time.sleep(0.05)
    finally:
        app.send_signal(signal.SIGKILL)
        app.communicate(timeout=60)  # until all that have its stderr have ended
    with Driver(icosphere(1), size=SIZE, state=state) as gui:
        gui.click("Recover")
        gui.wait(lambda s: s.result is not None)
        result = gui.session.result
        assert gui.session.saves.title == "* work.abfm"
        assert gui.session.saves.path == tmp_path / "work.abfm"
        assert len(gui.session.surface().mesh.vertices) == len(egg.vertices)
        assert gui.session.document.runs
        assert result.velocity.any()
        assert result.stop_reason == "cancelled"
        gui.click("Continue", within="verdict")
        gui.wait(lambda s: s.solver.snapshot is not None)
        assert gui.session.solver.snapshot.iteration.mismatch <= 1.01 * result.mismatch
        assert not gui.errors
