"""Writes pictures, movies and data beside the running app: pictures in a process of their own, which can be ended."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from abfm import AbfmError
from abfm.mesh import FloatArray
from abfm_viewer.background import one_line
from abfm_viewer.document import Document

if TYPE_CHECKING:
    from abfm import Match

Known = Callable[[], dict[str, FloatArray]]


@dataclass(frozen=True)
class PictureSettings:
    """A picture's size in pixels, and what it has besides the surfaces."""

    width: int = 1920
    height: int = 1080
    transparent: bool = False
    color_bar: bool = True

    def words(self) -> list[str]:
        """As options of `abfm render`."""
        flags = ["--transparent"] * self.transparent + ["--no-color-bar"] * (not self.color_bar)
        return ["--size", f"{self.width}x{self.height}", *flags]


@dataclass(frozen=True)
class MovieSettings:
    """A movie's times: how long it is, and which part of the flow it shows; and how far the surfaces turn."""

    seconds: float = 4.0
    fps: float = 30.0
    start: float = 0.0
    end: float = 1.0
    turntable: float = 0.0

    def words(self) -> list[str]:
        """As options of `abfm render`."""
        words = ["--seconds", self.seconds, "--fps", self.fps, "--from", self.start, "--to", self.end]
        return [str(word) for word in [*words, "--turntable", self.turntable]]


class Exporter:
    """One export at a time.

    Attributes
    ----------
    progress : float
        Share of the frames that are drawn, 0 to 1.
    message : str
        What was written, or why nothing was; empty while it runs and before the first.
    failed : bool
        Whether `message` is an error.
    """

    def __init__(self) -> None:
        self.progress = 0.0
        self.message = ""
        self.failed = False
        self.picture = PictureSettings()
        self.movie = MovieSettings()
        self._process: subprocess.Popen[str] | None = None
        self._thread: threading.Thread | None = None
        self._cancelled = False

    @property
    def running(self) -> bool:
        """Whether something is being written."""
        return self._thread is not None and self._thread.is_alive()

    def save_picture(self, path: Path, document: Document, known: Known) -> None:
        """Draw the document as the window shows it."""
        self._start(self._render, path, document, known, self.picture.words())

    def save_movie(self, path: Path, document: Document, known: Known) -> None:
        """Draw the document over time."""
        self._start(self._render, path, document, known, [*self.picture.words(), *self.movie.words()])

    def save_result(self, path: Path, match: Match) -> None:
        """Write a result in the format of the file's suffix."""
        self._start(self._write, path, match)

    def cancel(self) -> None:
        """End the export; nothing is written, and an older file stays."""
        self._cancelled = True
        if self._process is not None:
            self._process.terminate()

    def wait(self) -> None:
        """Return when nothing is being written any more."""
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """End what runs."""
        self.cancel()
        self.wait()

    def _start(self, job: Callable[..., str], *arguments: object) -> None:
        if self.running:
            return
        self.progress, self.message, self.failed, self._cancelled = 0.0, "", False, False

        def work() -> None:
            try:
                self.message = job(*arguments)
            except Exception as error:
                self.failed = not self._cancelled
                self.message = "export cancelled" if self._cancelled else one_line(error)

        self._thread = threading.Thread(target=work, name="export", daemon=True)
        self._thread.start()

    def _write(self, path: Path, match: Match) -> str:
        from abfm_viewer.cli import outputs

        outputs.check(path, list(outputs.WRITERS))
        outputs.write(path, match)
        return f"saved {path}"

    def _render(self, path: Path, document: Document, known: Known, words: list[str]) -> str:
        """Draw a copy of the document in a process of its own."""
        from abfm_viewer.project import save_project

        with tempfile.TemporaryDirectory() as folder:
            project = Path(folder) / "export.abfm"
            save_project(project, document, known())
            command = [sys.executable, "-m", "abfm_viewer.cli", "render", str(project), "--out", str(path), *words]
            with subprocess.Popen(
                [*command, "--progress"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            ) as self._process:
                if self._cancelled:
                    self._process.terminate()
                self._follow(self._process)
                _, errors = self._process.communicate()
                status = self._process.returncode
            self._process = None
        if status != 0:
            lines = errors.strip().splitlines() or [f"the process that draws ended with status {status}"]
            raise AbfmError(lines[-1].removeprefix("abfm: "))
        self.progress = 1.0
        return f"saved {path}"

    def _follow(self, process: subprocess.Popen[str]) -> None:
        """Take in the lines that tell of frames."""
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("{"):
                told = json.loads(line)
                self.progress = told["frame"] / told["count"]
