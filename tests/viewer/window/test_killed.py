"""The app is killed during a run on a saved project: its processes end, and the next launch has the run's field."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from types import SimpleNamespace

from abfm_viewer.automation import driver as automation
from abfm_viewer.automation.driver import Driver
from abfm_viewer.files.project import save_project
from tests.shapes import icosphere
from tests.viewer.sessions import ENDLESS, SIZE, SPHERE, opened

_SECONDS = 60
_RUN = """
import sys
from functools import partial
from pathlib import Path
from abfm_viewer.scene import opengl
from abfm_viewer.window import recovery
from abfm_viewer.window.open_window import open_window
recovery.Autosave = partial(recovery.Autosave, seconds=0.5)
window = open_window(sys.argv[1], opengl.OFFSCREEN, (320, 240), Path(sys.argv[2]))
window.session.solver.work_apart()
while True:
    window.frame()
    assert not window.session.unsaved
    window.session.match()
"""


def test_the_field_of_a_killed_run_is_recovered(tmp_path, monkeypatch):
    project, state = tmp_path / "work.abfm", tmp_path / "state"
    session = opened(ENDLESS)
    save_project(project, session.document, {})
    session.close()
    app = subprocess.Popen([sys.executable, "-c", _RUN, str(project), str(state)], stderr=subprocess.PIPE)
    try:
        end = time.monotonic() + _SECONDS
        while not list(state.glob("autosave-*.abfm")):
            assert app.poll() is None, "the app ended"
            assert time.monotonic() < end, "no copy was written"
            time.sleep(0.1)
    finally:
        app.send_signal(signal.SIGKILL)
        app.communicate(timeout=_SECONDS)  # until all that have its stderr have ended
    folder = SimpleNamespace(TemporaryDirectory=lambda: nullcontext(str(state)))
    monkeypatch.setattr(automation, "tempfile", folder)
    with Driver(icosphere(1), size=SIZE) as gui:
        gui.wait(lambda s: gui.window.dialogs.is_asking("Recover unsaved work?"))
        gui.click("Recover")
        gui.wait(lambda s: s.result is not None)
        result = gui.session.result
        assert len(gui.session.mesh.vertices) == len(SPHERE.vertices)
        assert result.velocity.any()
        assert gui.session.document.runs
        assert gui.session.unsaved
        assert gui.session.path == project
        gui.session.solver.warm = True
        gui.click("Match")
        gui.wait(lambda s: s.solver.snapshot is not None)  # the run goes on from there
        assert gui.errors == {}
