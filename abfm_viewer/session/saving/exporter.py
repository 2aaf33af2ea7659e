"""Pictures, movies and data written beside the running app, pictures in a process that can end."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import abfm
from abfm import AbfmError
from abfm.io import temporary_folder, write_atomically
from abfm.numerics.factoring_in_subprocess import factoring_in_subprocess
from abfm.reading import NO_LABEL
from abfm.types import FloatArray
from abfm.workers.control import Control, controlled
from abfm.workers.progress import Step, reporting_steps
from abfm_viewer.computing.background import THREADS, error_line
from abfm_viewer.document.document import Document
from abfm_viewer.document.label_map import LabelMap
from abfm_viewer.files import outputs
from abfm_viewer.files.contents import RESULT
from abfm_viewer.files.project import save_project

Known = Callable[[], dict[str, FloatArray]]
PICTURES = (".png",)
MOVIES = tuple(outputs.FPS_MAX)
TABLES = (".csv",)
LABELS = (".gii", ".annot", ".npy", ".csv", ".txt")
"""Suffixes."""


@dataclass(frozen=True)
class PictureSettings:
    width: int = 1920
    height: int = 1080
    transparent: bool = False
    color_bar: bool = True

    def words(self) -> list[str]:
        """As options of `abfm render`, but for the ground."""
        size = f"--size={self.width}x{self.height}"
        return [size] if self.color_bar else [size, "--no-color-bar"]


@dataclass(frozen=True)
class MovieSettings:
    """A movie's length, its part of the flow in units of tau, and the surfaces' turning."""

    seconds: float = 4.0
    fps: float = 30.0
    start: float = 0.0
    end: float = 1.0
    turntable: float = 0.0


class _Export(NamedTuple):
    path: Path
    suffixes: tuple[str, ...]  # of which it must have one
    write: Callable[[], object]  # returns what is missing in the file, and why


class Exporter:
    """One export at a time, the others after it; `progress` is the share of the frames that are
    drawn, 0 to 1.

    `message` says at its end what was written, or why nothing was, if it `failed` or was cancelled;
    `say` is told, too. The window's size is that of the part with the surfaces, in pixels.
    """

    def __init__(self, say: Callable[[str, bool], None]) -> None:
        self._say = say
        self.window_size = (1280, 720)
        self.progress = 0.0
        self.message = ""
        self.failed = False
        self.picture = PictureSettings()
        self.movie = MovieSettings()
        self._process: subprocess.Popen[str] | None = None
        self._work: Future[None] | None = None
        self._cancelled = False
        self._task, self._began = "", 0.0
        self._told: Step | None = None  # what writing is at, if it says so
        self._control = Control()
        self._lock = threading.Lock()
        self._waiting: list[_Export] = []
        self.running = False

    @property
    def step(self) -> Step:
        """What is written, and how far that is, or what it is at."""
        count = len(self._waiting)
        task = f"{self._task}, {count} more after it" if count else self._task
        if (told := self._told) is not None:
            return replace(told, task=f"{task}: {told.task}")
        return Step(task, done=self.progress or None, began=self._began)

    def save_picture(self, path: Path, document: Document, known: Known) -> None:
        words = [*self.picture.words(), *(["--transparent"] if self.picture.transparent else [])]
        self._start(path, PICTURES, partial(self._render, path, document, known, words))

    def save_movie(self, path: Path, document: Document, known: Known) -> None:
        movie, start, whole = self.movie, document.start, document.last_target_time - document.start
        # a film has nothing after its last frame
        begin, end = (
            min(start + share * whole, document.end) for share in (movie.start, movie.end)
        )
        times = [f"--from={begin}", f"--to={end}"]
        rate = [f"--seconds={movie.seconds}", f"--fps={movie.fps}"]
        words = [*self.picture.words(), *rate, *times, f"--turntable={movie.turntable}"]
        self._start(path, MOVIES, partial(self._render, path, document, known, words))

    def save_result(self, path: Path, found: Any, kept: Callable[[], object]) -> None:
        """Write a result by the suffix, and call ``kept`` if that is a result file."""
        task = abfm.loading.task_of(found)

        def write() -> str:
            outputs.check_result(path, task)
            note = outputs.write(path, found)
            if path.suffix == RESULT:
                kept()
            return note

        self._start(path, outputs.suffixes(task), write)

    def save_table(self, path: Path, found: Any, name: str) -> None:
        """Write a table of a result by its name, see `abfm.tasks.task.Task.tables`."""
        table = abfm.loading.task_of(found).tables[name]
        self._start(path, TABLES, partial(table.write, path, found))

    def save_labels(
        self, path: Path, labels: LabelMap, found: abfm.Correspondence | abfm.Match
    ) -> None:
        def write() -> None:
            way = found
            if isinstance(way, abfm.Match):
                way = abfm.Correspondence(way.point_map())
            carried = way.b.on_file(way.transfer_labels(labels.values, "area"), NO_LABEL)
            abfm.io.write_labels(path, labels.labels(carried), way.b.structure)

        self._start(path, LABELS, write)

    def cancel(self) -> None:
        """End the export; nothing is written, and an older file stays."""
        with self._lock:
            self._waiting.clear()
            self._cancelled = True
            self._control.cancel()
        if (process := self._process) is not None:
            process.kill()  # all that it has written is in the folder that is removed with it

    def wait(self) -> None:
        if self._work is not None:
            wait([self._work])

    def close(self) -> None:
        self.cancel()
        self.wait()

    def _start(self, path: Path, suffixes: tuple[str, ...], write: Callable[[], object]) -> None:
        """Write a file, or have it written after those that are under way."""
        with self._lock:
            export = _Export(path, suffixes, write)
            if self.running:
                self._waiting.append(export)
            else:
                self._begin(export)
                self.running = True
                self._work = THREADS.submit(self._write_all, export)

    def _begin(self, export: _Export) -> None:
        self.progress, self.message, self.failed, self._cancelled = 0.0, "", False, False
        self._task, self._began = f"writing {export.path.name}", time.monotonic()
        self._told, self._control = None, Control()

    @factoring_in_subprocess()
    def _write_all(self, export: _Export) -> None:
        while True:
            self._write(export)
            with self._lock:
                if not self._waiting:
                    self.running = False
                    return
                export = self._waiting.pop(0)
                self._begin(export)

    def _write(self, export: _Export) -> None:
        try:
            outputs.check(export.path, export.suffixes)
            with reporting_steps(self._tell), controlled(self._control):
                note = export.write()
            self.progress, self.message = 1.0, f"saved {export.path}{f'; {note}' if note else ''}"
        except Exception as error:
            self.failed = not self._cancelled
            self.message = "export cancelled" if self._cancelled else error_line(error)
        self._say(self.message, self.failed)

    def _tell(self, step: Step | None) -> None:
        self._told = step

    def _render(self, path: Path, document: Document, known: Known, words: list[str]) -> None:
        """Draw a copy of the document in a process of its own; put the file in place when whole."""
        if self.movie.fps > (fastest := outputs.FPS_MAX.get(path.suffix, math.inf)):
            raise AbfmError(
                f"fps is {self.movie.fps:g}; a {path.suffix} file takes at most {fastest:g}"
            )
        with temporary_folder() as folder:
            project, drawn = folder / "export.abfm", folder / f"drawn{path.suffix}"
            errors, view = folder / "errors.txt", replace(document.view, color_bar=True)
            save_project(project, replace(document, view=view), known())
            render = ["-m", "abfm_viewer.cli", "render", str(project), "--out", str(drawn)]
            environment = os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
            with errors.open("w") as file:
                self._process = subprocess.Popen(
                    [sys.executable, *render, *words, "--progress"],
                    stdout=subprocess.PIPE,
                    stderr=file,
                    text=True,
                    env=environment,
                    # Ctrl-C on a terminal is this process's business
                    process_group=0 if os.name == "posix" else None,
                )
            with self._process as process:
                if self._cancelled:
                    process.kill()
                for line in process.stdout or ():
                    if line.startswith("{"):
                        told = json.loads(line)
                        self.progress = told["frame"] / told["count"]
            self._process = None
            if process.returncode != 0 or self._cancelled:
                unsaid = f"the process that draws ended with status {process.returncode}"
                lines = errors.read_text().strip().splitlines() or [unsaid]
                raise AbfmError(lines[-1].removeprefix("abfm: "))
            with write_atomically(path) as temporary:
                shutil.copyfile(drawn, temporary)
