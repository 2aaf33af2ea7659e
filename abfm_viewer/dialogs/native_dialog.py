"""The file dialog of the system, shown by the optional library crossfiledialog."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import polyscope.imgui as imgui

from abfm_viewer.widgets.containers import dialog
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import WIDGETS_VARIABLE

_SCRIPT = """
import os, signal, sys
if os.name == "posix":  # end also the program that shows the dialog
    os.setpgrp()
    signal.signal(signal.SIGTERM, lambda *_: os.killpg(0, signal.SIGKILL))
import crossfiledialog
sys.stdout.reconfigure(encoding="utf-8", errors="surrogateescape")
files = {"Supported files": sys.argv[3:]}
print(crossfiledialog.open_file(sys.argv[1], sys.argv[2], files) or "", end="")
"""
_REMOTE_VARIABLES = ("SSH_CONNECTION", "SSH_CLIENT", "SSH_TTY", WIDGETS_VARIABLE)
_PROGRAMS = ("zenity", "kdialog")
_WIDTH = 420


@cache
def missing() -> str:
    """Return what the dialog of the system needs on this machine; empty if it can be shown."""
    if any(map(os.environ.get, _REMOTE_VARIABLES)):
        return "The window must be on the screen of this machine, without SSH"
    if find_spec("crossfiledialog") is None:
        return "Its library is missing; install it by: pip install 'abfm[native]'"
    has_program = sys.platform in ("win32", "darwin") or any(map(shutil.which, _PROGRAMS))
    return "" if has_program else f"One of the programs {' and '.join(_PROGRAMS)} is needed"


@dataclass(eq=False)
class NativeDialog:
    """The dialog of the system for a file to open; the window waits for its answer."""

    title: str
    folder: Path
    suffixes: tuple[str, ...]
    failed: bool = field(default=False, init=False)  # whether it could not be shown

    def __post_init__(self) -> None:
        patterns = [f"*{form}" for each in self.suffixes for form in (each, each.upper())]
        command = [sys.executable, "-c", _SCRIPT, self.title, str(self.folder), *patterns]
        devnull, pipe = subprocess.DEVNULL, subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=devnull, stdout=pipe, stderr=devnull)

    def draw(self, ui: Ui) -> tuple[Path | None] | None:
        """Draw a note; return (file,) if the user chose one, (None,) if not, and None before."""
        with dialog(ui, self.title, _WIDTH):
            ui.note("Choose the file in the dialog of the system.", "ink")
            cancelled = ui.button("Cancel", "Esc", width=ui.px(110))
            if cancelled or imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False):
                return (None,)
        if (status := self._process.poll()) is None:
            return None
        self.failed = status != 0
        found = self._process.stdout.read() if self._process.stdout else b""
        return (Path(os.fsdecode(found)) if found and not self.failed else None,)

    def close(self) -> None:
        self._process.terminate()
        self._process.communicate()
