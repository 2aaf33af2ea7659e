"""From launch to a saved movie in a real window on a virtual screen (Xvfb), with xdotool."""

import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import av
import pytest

from abfm.assets import asset_path
from tests.processes import run

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Xvfb is Linux's")
_PAUSE_SECONDS = 0.1  # time for the app to process an event, in seconds


class RealWindow:
    """The window of the app; its widgets are read from a file that the app writes."""

    def __init__(self, app, widgets, environment):
        self.app, self._widgets, self._environment = app, widgets, environment

    def xdotool(self, *words):
        """Send an event, and wait until the app has processed it."""
        done = run("xdotool", *map(str, words), env=self._environment, check=True)
        time.sleep(_PAUSE_SECONDS)
        return done.stdout.strip()

    def widgets(self):
        """Return the present widgets, from a file written after this call."""
        now, file = time.time_ns(), self._widgets
        self.until(lambda: file.exists() and file.stat().st_mtime_ns > now, "draws no frames")
        return json.loads(file.read_text())

    def find(self, label, kind="", within="", seconds=20):
        """Return an enabled widget, scrolled into view; wait until there is one."""
        end = time.monotonic() + seconds
        while True:
            known = [w for w in self.widgets() if w["enabled"]]
            for w in known:
                if (
                    label in (w["label"], w["name"])
                    and kind in ("", w["kind"])
                    and within in ("", *w["section"].split("/"))
                ):
                    if self._in_view(w):
                        return w
                    break
            labels = ", ".join(w["label"] for w in known)
            assert time.monotonic() < end, f"no {label!r} in view; there are {labels}"

    def _in_view(self, widget):
        """Return whether a widget is in view; if not, scroll its panel a bit."""
        (left, top, _, bottom), (_, above, _, below) = widget["area"], widget["rect"]
        if top <= above and below <= bottom:
            return True
        self.xdotool("mousemove", int(left + 4), int((top + bottom) / 2))
        self.xdotool("click", 5 if below > bottom else 4)
        return False

    def click(self, label, kind="", within=""):
        left, top, right, bottom = self.find(label, kind, within)["rect"]
        self.xdotool("mousemove", int(left + 0.3 * (right - left)), int((top + bottom) / 2))
        self.xdotool("mousedown", 1)
        self.xdotool("mouseup", 1)

    def type(self, label, text, within=""):
        """Type a short text, as a frame takes only one letter."""
        self.click(label, "box", within)
        self.key("ctrl", "a")
        self.xdotool("type", "--delay", 40, text)
        self.key("", "Return")

    def key(self, modifier, key):
        if modifier:
            self.xdotool("keydown", modifier)
        self.xdotool("key", key)
        if modifier:
            self.xdotool("keyup", modifier)

    def until(self, condition, otherwise, seconds=60):
        end = time.monotonic() + seconds
        while not condition():
            assert self.app.poll() is None, f"the app ended with {self.app.returncode}"
            assert time.monotonic() < end, f"the app {otherwise}"
            time.sleep(0.05)


@contextmanager
def screen():
    """Start a virtual screen, and yield the environment of programs that use it."""
    read, write = os.pipe()
    words = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24", "-nolisten", "tcp"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    server = subprocess.Popen(words, pass_fds=(write,), **quiet)
    os.close(write)
    try:
        with os.fdopen(read) as answer:
            display = answer.readline().strip()
        assert display, "Xvfb did not start"
        known = {name: value for name, value in os.environ.items() if name != "WAYLAND_DISPLAY"}
        yield known | {"DISPLAY": f":{display}", "LIBGL_ALWAYS_SOFTWARE": "1"}
    finally:
        server.terminate()
        server.wait(20)


@contextmanager
def opened(mesh, folder):
    """Open `abfm-viewer MESH` in a window, with a folder for its state and its messages."""
    widgets = folder / "widgets.json"
    own = {"ABFM_STATE_FOLDER": str(folder / "state"), "ABFM_WIDGETS": str(widgets)}
    command = [str(Path(sys.executable).parent / "abfm-viewer"), str(mesh)]
    with screen() as environment, (folder / "log.txt").open("wb") as log:
        environment |= own | {"HOME": str(folder)}
        app = subprocess.Popen(command, env=environment, cwd=folder, stdout=log, stderr=log)
        try:
            window = RealWindow(app, widgets, environment)
            window.until(widgets.exists, "shows no window")
            names = window.xdotool("search", "--sync", "--onlyvisible", "--name", "abfm")
            name = names.splitlines()[0]
            window.xdotool("windowmove", name, 0, 0)  # there is no window manager
            window.xdotool(
                "windowsize", name, 640, 480
            )  # the time of drawing depends on the number of pixels
            window.xdotool("windowfocus", name)
            yield window
        finally:
            if app.poll() is None:
                app.terminate()
            app.wait(30)


def test_real_window_saves_a_movie(tmp_path):
    for program in ("Xvfb", "xdotool"):
        advice = "./run test installs it, or apt-get install xvfb xdotool"
        assert shutil.which(program), f"{program} is missing; {advice}"
    movie_path, log = tmp_path / "eight-match.mp4", tmp_path / "log.txt"  # the name it suggests
    mesh = shutil.copy(asset_path("eight.off"), tmp_path)  # files are saved in its folder
    with opened(mesh, tmp_path) as window:
        window.click("Skip tour")  # which begins at the first launch
        window.click("Match", "button")  # the button, not the tab
        window.click("Export", "tab")
        window.find("Match data...", seconds=120)  # enabled when there is a result
        window.click("Movie...")
        numbers = {"pixels across": 480, "pixels down": 320, "seconds": 0.1}
        for label, number in numbers.items():
            window.type(label, str(number), within="Export to a file")
        window.click("Save as...")
        window.click("Save")
        window.until(movie_path.exists, "saves no movie", 120)
        window.click("Close")
        window.key("ctrl", "q")
        window.click("Don't save")
        window.app.wait(30)
    assert window.app.returncode == 0, log.read_text()
    assert log.read_text() == ""
    with av.open(movie_path) as movie:
        frames = [frame.to_ndarray(format="rgb24") for frame in movie.decode(video=0)]
    assert len(frames) == 3
    assert frames[0].shape == (320, 480, 3)
    assert abs(frames[0].astype(int) - frames[-1]).mean() > 0.5  # the function has moved
