"""The installed app in a real window on a screen of its own (Xvfb), used with xdotool's mouse
and keyboard.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.processes import run

SIZE = (1280, 800)
_PAUSE = 0.15  # seconds that the app may need for an event


class RealWindow:
    """The app's window, with widgets found in the file that the app writes for this purpose.

    Parameters
    ----------
    app : Popen
    widgets : Path
        Where the app says where its widgets are.
    environment : dict
        With the screen.
    """

    def __init__(
        self, app: subprocess.Popen[bytes], widgets: Path, environment: dict[str, str]
    ) -> None:
        self.app = app
        self._widgets = widgets
        self._environment = environment

    def xdotool(self, *words: object) -> str:
        """Send an event, and leave the app time for it."""
        done = run("xdotool", *map(str, words), env=self._environment, check=True)
        time.sleep(_PAUSE)
        return done.stdout.strip()

    def widgets(self) -> list[dict[str, Any]]:
        """The widgets as they are now: in a file that was written after this call."""
        before = time.time_ns()
        self.until(
            lambda: self._widgets.exists() and self._widgets.stat().st_mtime_ns > before,
            "draws no frames",
        )
        widgets: list[dict[str, Any]] = json.loads(self._widgets.read_text())
        return widgets

    def find(
        self, label: str, kind: str = "", within: str = "", seconds: float = 20
    ) -> dict[str, Any]:
        """A widget that can be used, scrolled into view; waits until there is one."""
        end = time.monotonic() + seconds
        while True:
            known = self.widgets()
            fitting = [
                w for w in known if label in (w["label"], w["name"]) and kind in ("", w["kind"])
            ]
            fitting = [w for w in fitting if w["enabled"]]
            fitting = [w for w in fitting if not within or within in w["section"].split("/")]
            if fitting and self._in_view(fitting[0]):
                return fitting[0]
            labels = ", ".join(w["label"] for w in known if w["enabled"])
            assert time.monotonic() < end, f"no {label!r} in view; there are {labels}"

    def click(self, label: str, kind: str = "", within: str = "") -> None:
        """Click on a widget."""
        left, top, right, bottom = self.find(label, kind, within)["rect"]
        self.xdotool("mousemove", int(left + 0.3 * (right - left)), int((top + bottom) / 2))
        self.xdotool("mousedown", 1)
        self.xdotool("mouseup", 1)

    def menu(self, *labels: str) -> None:
        """Open a menu and choose an entry."""
        for label in labels:
            self.click(label)

    def type(self, label: str, text: str, within: str = "", enter: bool = True) -> None:
        """Replace a box's text."""
        self.click(label, "box", within)
        self.key("ctrl+a")
        self.xdotool("type", "--delay", 40, text)
        if enter:
            self.key("Return")

    def key(self, chord: str) -> None:
        """Press a key, by X's name."""
        *modifiers, key = chord.split("+")
        for modifier in modifiers:
            self.xdotool("keydown", modifier)
        self.xdotool("key", key)
        for modifier in modifiers:
            self.xdotool("keyup", modifier)

    def until(self, condition: Callable[[], object], otherwise: str, seconds: float = 60) -> None:
        """Wait."""
        end = time.monotonic() + seconds
        while not condition():
            assert self.app.poll() is None, f"the app ended with {self.app.returncode}"
            assert time.monotonic() < end, f"the app {otherwise}"
            time.sleep(0.05)

    def _in_view(self, widget: dict[str, Any]) -> bool:
        """Whether a widget can be seen; if not, its panel is scrolled a bit."""
        (left, top, _, bottom), (_, above, _, below) = widget["area"], widget["rect"]
        if top <= above and below <= bottom:
            return True
        self.xdotool("mousemove", int(left + 4), int((top + bottom) / 2))
        self.xdotool("click", 5 if below > bottom else 4)
        return False


@contextmanager
def screen() -> Iterator[dict[str, str]]:
    """A screen without a monitor; the environment of programs that use it."""
    read, write = os.pipe()
    command = [
        "Xvfb",
        "-displayfd",
        str(write),
        "-screen",
        "0",
        f"{SIZE[0]}x{SIZE[1]}x24",
        "-nolisten",
        "tcp",
    ]
    server = subprocess.Popen(
        command, pass_fds=(write,), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    os.close(write)
    try:
        with os.fdopen(read) as answer:
            display = answer.readline().strip()
        assert display, "Xvfb did not start"
        yield {name: value for name, value in os.environ.items() if name != "WAYLAND_DISPLAY"} | {
            "DISPLAY": f":{display}",
            "LIBGL_ALWAYS_SOFTWARE": "1",
        }
    finally:
        server.terminate()
        server.wait(20)


@contextmanager
def opened(mesh: Path, folder: Path) -> Iterator[RealWindow]:
    """`abfm-viewer MESH` in a window, with a folder for its state and its messages."""
    with screen() as environment:
        widgets = folder / "widgets.json"
        environment |= {
            "ABFM_STATE_FOLDER": str(folder / "state"),
            "ABFM_WIDGETS": str(widgets),
            "HOME": str(folder),
        }
        command = [str(Path(sys.executable).parent / "abfm-viewer"), str(mesh)]
        with (folder / "log.txt").open("wb") as log:
            app = subprocess.Popen(command, env=environment, cwd=folder, stdout=log, stderr=log)
        try:
            window = RealWindow(app, widgets, environment)
            window.until(lambda: widgets.exists(), "shows no window")
            name = window.xdotool(
                "search", "--sync", "--onlyvisible", "--name", "abfm"
            ).splitlines()[0]
            window.xdotool("windowmove", name, 0, 0)  # there is no window manager
            window.xdotool("windowfocus", name)
            yield window
        finally:
            if app.poll() is None:
                app.terminate()
            app.wait(30)
