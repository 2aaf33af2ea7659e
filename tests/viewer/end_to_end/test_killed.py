"""Recovery and continuation of the work of a killed app in the next launch."""

import signal
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np

from tests.mesh_writers import off_file
from tests.shapes import ellipsoid
from tests.viewer.end_to_end.test_closing import next_launch

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
    gui.window.dialogs.start_in(mesh.parent)
    gui.wait(lambda session: not session.obstacle)
    gui.session.editor.amend(parameters=ENDLESS)
    gui.key("ctrl+s")
    gui.type("file name", "work.abfm", enter=False)
    gui.click("Save")
    gui.wait(lambda session: session.saves.path and not session.saves.unsaved)
    gui.click("Match")
    gui.wait(lambda session: session.matching.snapshot is not None)
    gui.wait(lambda session: session.matching.snapshot.iteration.iteration > 3)
    (state / "matching").touch()  # later copies have a field that is not zero
    while True:
        gui.window.frame()
"""
_SEQUENCE = """
import sys
from pathlib import Path
import numpy as np
from abfm_viewer.automation import Driver
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.window.wave import turning_wave
mesh, state = map(Path, sys.argv[1:])
with Driver(mesh, size=(640, 480), state=state) as gui:
    places = gui.session.surface().mesh.vertices
    frames = turning_wave(places / np.linalg.norm(places, axis=1)[:, None], 0.005 * np.arange(240))
    np.save(mesh.with_name("wave.npy"), frames[0])
    gui.window.files.open(mesh.with_name("wave.npy"))
    gui.wait(lambda session: isinstance(session.document, SequenceDocument))
    gui.click("Match all frames")
    while True:
        gui.window.frame()
"""


def is_copied(state):
    """Return whether there is a copy of unsaved work that is newer than the marker file."""
    marker, copies = state / "matching", list(state.glob("autosave-*.abfm"))
    if not (marker.exists() and copies):
        return False
    return max(copy.stat().st_mtime_ns for copy in copies) > marker.stat().st_mtime_ns


def stored_fields(state):
    """Return the number of stored fields of a sequence next to an existing copy."""
    with suppress(ValueError, OSError):
        [_copy], [path] = state.glob("autosave-*.abfm"), state.glob("autosave-*.unfinished")
        with np.load(path) as arrays:
            return len(arrays["fields"])
    return 0


def run_and_kill(script, egg, state, is_enough):
    """Run a script of the app on a mesh, and kill it when its state folder meets a condition."""
    mesh = off_file(state.with_name("egg.off"), egg)
    command = [sys.executable, "-c", script, str(mesh), str(state)]
    app = subprocess.Popen(command, stderr=subprocess.PIPE)
    try:
        end = time.monotonic() + 240
        while not is_enough(state):
            assert app.poll() is None, "the app ended"
            assert time.monotonic() < end, "no copy was written"
            time.sleep(0.05)
    finally:
        app.send_signal(signal.SIGKILL)
        app.communicate(timeout=60)  # until all processes with its stderr have ended


def test_killed_match_is_recovered(tmp_path):
    egg, state = ellipsoid(2, 1, 0.7, 0.55), tmp_path / "state"
    run_and_kill(_WORK, egg, state, is_copied)
    with next_launch(state) as gui:
        gui.click("Recover")
        gui.wait(lambda s: s.result is not None)
        result = gui.session.result
        assert gui.session.saves.title == "* work.abfm"
        assert gui.session.saves.path == tmp_path / "work.abfm"
        assert len(gui.session.surface().mesh.vertices) == len(egg.vertices)
        assert gui.session.document.runs
        assert result.velocity.any()
        assert result.stop_reason == "cancelled"
        gui.wait(lambda s: not s.obstacle)  # the button is disabled until then
        gui.click("Continue")
        gui.wait(lambda s: s.matching.snapshot is not None)
        assert gui.session.matching.snapshot.iteration.residual <= 1.01 * result.residual


def test_killed_sequence_continues(tmp_path):
    state = tmp_path / "state"
    run_and_kill(_SEQUENCE, ellipsoid(2, 1, 0.7, 0.55), state, stored_fields)
    count = stored_fields(state)
    assert 0 < count < 239
    with next_launch(state) as gui:
        gui.click("Recover")
        gui.wait(lambda s: s.document.result is not None and not s.solver.running)
        sequence = gui.session.document.result
        assert gui.session.document.name == "wave.npy on egg.off"
        assert np.count_nonzero(sequence.solved) == count
        assert sequence.confirmed == count
        assert gui.session.saves.unsaved
        assert not gui.session.document.is_outdated
        gui.click("Match all frames")
        gui.wait(lambda s: s.sequence_match.found_count(s.document) > count)
        assert not gui.session.solver.overall.name.startswith("choosing")
        gui.click("Cancel")
        gui.wait(lambda s: not s.solver.running)
        assert np.count_nonzero(gui.session.document.result.solved) > count
    assert not any(state.glob("autosave-*"))
