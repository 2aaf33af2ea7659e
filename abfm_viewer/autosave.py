"""A copy of unsaved work every few seconds, and what crashes left of earlier ones."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from abfm.mesh import FloatArray
from abfm_viewer.background import one_line
from abfm_viewer.document import Document
from abfm_viewer.state_folder import StateFolder

_PREFIX, _SUFFIX = "autosave-", ".abfm"
_ABANDONED = 120.0  # seconds without a heartbeat: the process is gone, whatever its number says


class Autosave:
    """Writes the document to the state folder when it has changed, in the background, at most every few seconds.

    Parameters
    ----------
    folder : StateFolder
    seconds : float
        Between two copies.
    clock : callable
        Seconds that pass.

    Attributes
    ----------
    path : Path
        The copy.
    error : str
        Why the last copy could not be written; empty if it could.
    """

    def __init__(self, folder: StateFolder, seconds: float = 20.0, clock: Callable[[], float] = time.monotonic) -> None:
        self.path = folder.path / f"{_PREFIX}{os.getpid()}{_SUFFIX}"
        self.error = ""
        self._seconds, self._clock = seconds, clock
        self._last = clock()
        self._document: Document | None = None
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="autosave")
        self._future: Future[None] | None = None

    def offer(self, document: Document, known: Callable[[], Mapping[str, FloatArray]], unsaved: bool) -> None:
        """Call every frame: writes a copy where it is time for one, and removes it where everything is saved.

        `known` gives the values of functions from other files (see `save_project`); it is called in the background.
        """
        if self._future is not None and self._future.done():
            problem = self._future.exception()
            self.error = one_line(problem) if problem else ""
            self._future = None
        now = self._clock()
        if self._future is not None or now - self._last < self._seconds:
            return
        self._last = now
        if not unsaved:
            self.discard()
        elif document is not self._document:
            self._document = document
            self._future = self._writer.submit(self._write, document, known)
        else:
            with suppress(OSError):
                os.utime(self.path)  # the heartbeat that `recoverable` looks for

    def take_over(self, recovery: Recovery) -> None:
        """Make what a crash left the copy of this process, until the next one is written."""
        with suppress(OSError):
            recovery.path.replace(self.path)

    def discard(self) -> None:
        """Remove the copy."""
        self._document = None
        with suppress(OSError):
            self.path.unlink()

    def close(self) -> None:
        """Finish writing."""
        self._writer.shutdown()

    def _write(self, document: Document, known: Callable[[], Mapping[str, FloatArray]]) -> None:
        from abfm_viewer.project import save_project

        self.path.parent.mkdir(parents=True, exist_ok=True)
        save_project(self.path, document, known())


@dataclass(frozen=True)
class Recovery:
    """A copy that a process left which ended without saving: its file, and when it was written (seconds)."""

    path: Path
    written: float

    def discard(self) -> None:
        """Remove it."""
        with suppress(OSError):
            self.path.unlink()


def recoverable(folder: StateFolder, now: float | None = None) -> list[Recovery]:
    """Copies of processes that are gone, the latest first."""
    found = []
    with suppress(OSError):
        for path in folder.path.glob(f"{_PREFIX}*{_SUFFIX}"):
            with suppress(OSError, ValueError):
                process = int(path.stem.removeprefix(_PREFIX))
                written = path.stat().st_mtime
                abandoned = (time.time() if now is None else now) - written > _ABANDONED
                if abandoned or not _is_alive(process):
                    found.append(Recovery(path, written))
    return sorted(found, key=lambda recovery: recovery.written, reverse=True)


def _is_alive(process: int) -> bool:
    """Whether a process runs; Windows, where asking by signal would end it, tells by the heartbeat alone."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
