"""Export of pictures, movies, results and tables to files, in the background.

Pictures are drawn in a subprocess, which a cancellation can kill.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import replace
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
from abfm.workers.process import separate_group
from abfm.workers.progress import Step, reporting_steps, work_time
from abfm_viewer.computing.background import THREADS, error_line
from abfm_viewer.document.document import Document
from abfm_viewer.document.label_map import LabelMap
from abfm_viewer.files import outputs
from abfm_viewer.files.contents import RESULT
from abfm_viewer.files.project import save_project
from abfm_viewer.session.saving.export_settings import ExportSettings

Known = Callable[[], dict[str, FloatArray]]
PICTURES = (".png",)
MOVIES = tuple(outputs.FPS_MAX)
TABLES = (".csv",)
LABELS = (".gii", ".annot", ".npy", ".csv", ".txt")
"""Suffixes of the files to which pictures, movies, tables and labels can be exported."""


class _Export(NamedTuple):
    path: Path
    suffixes: tuple[str, ...]  # allowed suffixes
    write: Callable[[], object]  # returns a note if the file lacks something
    subject: object  # identity of the document


class Exporter:
    """Writes exported files in the background, one after another.

    ``report`` is called with the final message of each export, and whether the export failed.
    """

    def __init__(self, report: Callable[[str, bool], None]) -> None:
        self._report = report
        self.window_size = (1280, 720)  # pixels of the part that shows the surfaces
        self.progress = 0.0  # share of the frames that are drawn, 0 to 1
        self.message = ""  # outcome of the last export; `report` is also called with it
        self.subject: object = None  # identity of the document to export
        self.message_subject: object = None  # identity of the document of the message
        self.failed = False  # whether the last export failed
        self.settings = ExportSettings()
        self._process: subprocess.Popen[str] | None = None
        self._work: Future[None] | None = None
        self._cancelled = False
        self._task, self._began = "", 0.0
        self._reported: Step | None = None  # step that the writer reported
        self._control = Control()
        self._lock = threading.Lock()
        self._waiting: list[_Export] = []
        self.running = False

    @property
    def step(self) -> Step:
        count = len(self._waiting)
        task = f"{self._task}, {count} more after it" if count else self._task
        if (reported := self._reported) is not None:
            return replace(reported, task=f"{task}: {reported.task}")
        return Step(task, done=self.progress or None, began=self._began)

    def save_picture(self, path: Path, document: Document, known: Known) -> None:
        options = self.settings.picture_options()
        self._start(path, PICTURES, partial(self._render, path, document, known, options))

    def save_movie(self, path: Path, document: Document, known: Known) -> None:
        options = self.settings.movie_options(document)
        self._start(path, MOVIES, partial(self._render, path, document, known, options))

    def save_result(self, path: Path, found: Any, on_saved: Callable[[], object]) -> None:
        """Write a result in the format of ``path``; for a result file, call ``on_saved``."""
        task = abfm.loading.task_of(found)

        def write() -> str:
            outputs.check_result(path, task)
            note = outputs.write(path, found)
            if path.suffix == RESULT:
                on_saved()
            return note

        self._start(path, outputs.suffixes(task), write)

    def save_table(self, path: Path, found: Any, name: str) -> None:
        table = abfm.loading.task_of(found).tables[name]
        self._start(path, TABLES, partial(table.write, path, found))

    def save_labels(
        self, path: Path, labels: LabelMap, found: abfm.Correspondence | abfm.Match
    ) -> None:
        def write() -> None:
            correspondence = found
            if isinstance(correspondence, abfm.Match):
                correspondence = abfm.Correspondence(correspondence.point_map())
            b, keys = correspondence.b, correspondence.transfer_labels(labels.values, "area")
            abfm.io.write_labels(path, labels.labels(b.on_file(keys, NO_LABEL)), b.structure)

        self._start(path, LABELS, write)

    def cancel(self) -> None:
        """Cancel all exports that are not finished; their files are not written or changed."""
        with self._lock:
            self._waiting.clear()
            self._cancelled = True
            self._control.cancel()
        if (process := self._process) is not None:
            process.kill()  # its files are in a temporary folder, which is removed

    def wait(self) -> None:
        if self._work is not None:
            wait([self._work])

    def close(self) -> None:
        self.cancel()
        self.wait()

    def _start(self, path: Path, suffixes: tuple[str, ...], write: Callable[[], object]) -> None:
        with self._lock:
            export = _Export(path, suffixes, write, self.subject)
            if self.running:
                self._waiting.append(export)
            else:
                self._begin(export)
                self.running = True
                self._work = THREADS.submit(self._write_all, export)

    def _begin(self, export: _Export) -> None:
        self.progress, self.message, self.failed, self._cancelled = 0.0, "", False, False
        self._task, self._began = f"writing {export.path.name}", work_time()
        self.message_subject = export.subject
        self._reported, self._control = None, Control()

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
            with reporting_steps(partial(setattr, self, "_reported")), controlled(self._control):
                note = export.write()
            self.progress, self.message = 1.0, f"saved {export.path}{f'; {note}' if note else ''}"
        except Exception as error:
            self.failed = not self._cancelled
            self.message = "export cancelled" if self._cancelled else error_line(error)
        self._report(self.message, self.failed)

    def _render(self, path: Path, document: Document, known: Known, options: list[str]) -> None:
        """Draw a document by `abfm render` in a subprocess, and write the complete file."""
        fps, fastest = self.settings.fps, outputs.FPS_MAX.get(path.suffix, math.inf)
        if fps > fastest:
            raise AbfmError(
                f"fps is {fps:g}; expected at most {fastest:g} for a {path.suffix} file"
            )
        with temporary_folder() as folder:
            project, drawn = folder / "export.abfm", folder / f"drawn{path.suffix}"
            errors, view = folder / "errors.txt", replace(document.view, color_bar=True)
            save_project(project, replace(document, view=view), known())
            render = ["-m", "abfm_viewer.cli", "render", str(project), "--out", str(drawn)]
            render.append(f"--theme={view.theme}")
            environment = os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
            environment["PYTHONIOENCODING"] = "utf-8"
            with errors.open("wb") as file:
                self._process = subprocess.Popen(
                    [sys.executable, *render, *options, "--progress"],
                    stdout=subprocess.PIPE,
                    stderr=file,
                    encoding="utf-8",
                    env=environment,
                    **separate_group(),
                )
            with self._process as process:
                if self._cancelled:
                    process.kill()
                for line in process.stdout or ():
                    if line.startswith("{"):
                        drawn_frames = json.loads(line)
                        self.progress = drawn_frames["frame"] / drawn_frames["count"]
            self._process = None
            if process.returncode != 0 or self._cancelled:
                status = f"the drawing process ended with status {process.returncode}; try again"
                text = errors.read_text(encoding="utf-8", errors="replace").strip()
                lines = text.splitlines() or [status]
                raise AbfmError(lines[-1].removeprefix("abfm: "))
            with write_atomically(path) as temporary:
                shutil.copyfile(drawn, temporary)
