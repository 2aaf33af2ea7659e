"""Autosaved copies of unsaved documents, which are offered for recovery after a crash."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import abfm
from abfm.types import FloatArray
from abfm_viewer.computing.background import error_line, same
from abfm_viewer.document.document import Document
from abfm_viewer.files.project import Origin, save_project
from abfm_viewer.files.state_folder import StateFolder

Content = tuple[Document, Mapping[str, FloatArray]]
"""A document, and the values of its functions from other files (see `save_project`)."""
_PREFIX = "autosave-"
_SUFFIX = ".abfm"
# without a heartbeat for so long, a process has ended, even if its number is in use again
_HEARTBEAT_SECONDS_MAX = 120.0


class Autosave:
    """Writes copies of a changed document to the state folder, in the background.

    Copies are written at most every `seconds`. Several objects in one process have different values
    of `number`. The modification time of a copy is that of its content. The access time is a
    heartbeat: a recent one means that the process that wrote it is still running.
    """

    def __init__(
        self,
        folder: StateFolder,
        number: int = 0,
        seconds: float = 20.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        owner = f"{os.getpid()}.{number}" if number else f"{os.getpid()}"
        self.path = folder.path / f"{_PREFIX}{owner}{_SUFFIX}"
        self.error = ""  # why the last copy could not be written
        self._seconds, self._clock = seconds, clock
        self._last = clock()
        self._state: object = None
        self._has_copy = False
        self._sequence_run: object = None  # the sequence's run at the last copy
        # unlike a daemon thread, it finishes writing at the end of the program
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="autosave")
        self._future: Future[None] | None = None
        with suppress(OSError):  # the copy of an earlier process with the same number
            earlier = self.path.with_stem(f"{self.path.stem}-{self.path.stat().st_mtime_ns}")
            self.path.replace(earlier)
            abfm.sequences.move_checkpoints(self.path, earlier)

    def offer(
        self,
        state: object,
        content: Callable[[], Content],
        unsaved: bool,
        origin: Origin | None = None,
        sequence_run: object = None,
    ) -> None:
        """Write a copy of the document if one is due; remove it if everything is saved.

        Called before each drawing. ``content`` returns the document to write, and ``origin`` is its
        project file. The copy is written again only if ``state`` is another object. When a run of a
        sequence begins, a copy is written immediately, because the run's checkpoint is useless
        without it.
        """
        if self._future is not None:
            if not self._future.done():
                return
            problem, self._future = self._future.exception(), None
            self.error = error_line(problem) if problem else ""
            if problem:
                self._state = None  # try again
        if not unsaved and self._has_copy:
            self.discard()
        is_new = not same(state, self._state)
        is_time = self._clock() - self._last >= self._seconds
        begins = sequence_run is not None and sequence_run is not self._sequence_run
        if not (unsaved and (is_time or begins)):
            return
        self._last, self._sequence_run = self._clock(), sequence_run
        if is_new:
            self._state, self._has_copy = state, True
            self._future = self._writer.submit(
                self._write, state, content, origin, sequence_run is not None
            )
        else:
            with suppress(OSError):
                times = time.time_ns(), self.path.stat().st_mtime_ns
                os.utime(self.path, ns=times)  # the heartbeat that `recoverable` looks for

    @property
    def is_idle(self) -> bool:
        return not self._has_copy and self._future is None

    def take_over(self, recovery: Recovery) -> None:
        """Rename a recovered copy to be that of this process until the next copy is written."""
        with suppress(OSError):
            recovery.path.replace(self.path)
            self._has_copy = True
        abfm.sequences.move_checkpoints(recovery.path, self.path)

    @property
    def has_checkpoint(self) -> bool:
        """Whether an unfinished run of a sequence has stored a checkpoint for the copy."""
        return bool(abfm.sequences.checkpoints_of(self.path))

    def discard(self) -> None:
        """Remove the copy and its checkpoints; a copy that is being written is also removed."""
        self._state, self._has_copy = None, False
        Recovery(self.path, 0.0).discard()

    def close(self) -> None:
        self._writer.shutdown()

    def _write(
        self,
        state: object,
        content: Callable[[], Content],
        origin: Origin | None,
        is_sequence_running: bool,
    ) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        document, known = content()
        save_project(self.path, document, known, origin)
        if not same(self._state, state):  # discarded meanwhile
            self.path.unlink(missing_ok=True)
        elif document.is_complete and not is_sequence_running:
            abfm.sequences.remove_checkpoints(self.path)


@dataclass(frozen=True)
class Recovery:
    """An autosaved copy of a process that ended without saving."""

    path: Path
    changed: float  # time of the last change of its content, in seconds since the epoch

    def set_aside(self) -> Path:
        """Rename a copy that cannot be read, so that it is not offered again; return its path."""
        place = self.path.with_name(f"unreadable-{self.path.name}")
        with suppress(OSError):
            self.path.replace(place)
        return place

    def discard(self) -> None:
        with suppress(OSError):
            self.path.unlink()
        abfm.sequences.remove_checkpoints(self.path)


def recoverable(folder: StateFolder) -> list[Recovery]:
    """Return the autosaved copies of processes that have ended, the latest first.

    Checkpoints without a copy are removed.
    """
    found = []
    with suppress(OSError):
        for path in folder.path.glob(f"{_PREFIX}*"):
            with suppress(OSError, ValueError, OverflowError):
                name, _, checkpoint = path.name.partition(_SUFFIX)
                number, _, earlier = name.removeprefix(_PREFIX).partition("-")
                process, times = int(number.partition(".")[0]), path.stat()
                heartbeat = max(times.st_atime, times.st_mtime)
                abandoned = time.time() - heartbeat > _HEARTBEAT_SECONDS_MAX
                if abandoned or earlier or not _is_alive(process):
                    recovery = Recovery(path.with_name(name + _SUFFIX), times.st_mtime)
                    if not checkpoint:
                        found.append(recovery)
                    elif not recovery.path.exists():
                        recovery.discard()
    return sorted(found, key=lambda recovery: recovery.changed, reverse=True)


def _is_alive(process: int) -> bool:
    """Return whether a process is running; always True on Windows, where only heartbeats count."""
    if sys.platform != "win32":
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
        except PermissionError:  # the process of another user
            pass
    return True
