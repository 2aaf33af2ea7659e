"""A copy of unsaved work every few seconds, and what crashes left of earlier ones."""

from __future__ import annotations

import os
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
# seconds without a heartbeat: the process is gone, whatever its number says
_HEARTBEAT_SECONDS_MAX = 120.0


class Autosave:
    """Writes a document to the state folder when it has changed, in the background, at most every
    few seconds; a process may have several, each with a `number` of its own.
    """

    def __init__(
        self,
        folder: StateFolder,
        number: int = 0,
        seconds: float = 20.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        owner = f"{os.getpid()}.{number}" if number else f"{os.getpid()}"
        self.path = folder.path / f"{_PREFIX}{owner}{_SUFFIX}"  # the copy
        self.error = ""  # why the last copy could not be written; empty if it could
        self._seconds, self._clock = seconds, clock
        self._last = clock()
        self._state: object = None
        self._has_copy = False
        self._sequence_run: object = None  # under way when a copy was last due
        # other than daemons it ends its work though nobody closes it
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="autosave")
        self._future: Future[None] | None = None
        with suppress(OSError):  # what an earlier process with this one's number left
            left = self.path.with_stem(f"{self.path.stem}-{self.path.stat().st_mtime_ns}")
            self.path.replace(left)
            abfm.sequences.move_checkpoints(self.path, left)

    def offer(
        self,
        state: object,
        content: Callable[[], Content],
        unsaved: bool,
        origin: Origin | None = None,
        sequence_run: object = None,
    ) -> None:
        """Call every frame: writes a copy where it is time for one, removes it where all is saved.

        What is written changes with the `state`, objects that are compared by identity. When a
        film's run begins, told apart by `sequence_run`, it is written at once: what the run keeps
        beside it is of no use without, until a copy has the fields of all intervals.
        """
        if self._future is not None:
            if not self._future.done():
                return
            problem, self._future = self._future.exception(), None
            self.error = error_line(problem) if problem else ""
            if problem:
                self._state = None  # to be tried again
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
                os.utime(self.path)  # the heartbeat that `recoverable` looks for

    @property
    def is_idle(self) -> bool:
        return not self._has_copy and self._future is None

    def take_over(self, recovery: Recovery) -> None:
        """Make what a crash left the copy of this process, until the next one is written."""
        with suppress(OSError):
            recovery.path.replace(self.path)
            self._has_copy = True
        abfm.sequences.move_checkpoints(recovery.path, self.path)

    @property
    def has_checkpoint(self) -> bool:
        """Whether there is beside the copy what a film's run found that did not come to its end."""
        return bool(abfm.sequences.checkpoints_of(self.path))

    def discard(self) -> None:
        """Remove the copy, also one that is being written, and what is beside it."""
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
    """A copy that a process left which ended without saving, and when it was written."""

    path: Path
    written: float

    def set_aside(self) -> Path:
        """Keep one that cannot be read where it is not found again; return its new place."""
        place = self.path.with_name(f"unreadable-{self.path.name}")
        with suppress(OSError):
            self.path.replace(place)
        return place

    def discard(self) -> None:
        with suppress(OSError):
            self.path.unlink()
        abfm.sequences.remove_checkpoints(self.path)


def recoverable(folder: StateFolder) -> list[Recovery]:
    """Copies of processes that are gone, the latest first; what such left of films beside no copy
    is removed.
    """
    found = []
    with suppress(OSError):
        for path in folder.path.glob(f"{_PREFIX}*"):
            with suppress(OSError, ValueError, OverflowError):
                name, _, beside = path.name.partition(_SUFFIX)
                number, _, left = name.removeprefix(_PREFIX).partition("-")
                process, written = int(number.partition(".")[0]), path.stat().st_mtime
                abandoned = time.time() - written > _HEARTBEAT_SECONDS_MAX
                if abandoned or left or not _is_alive(process):
                    recovery = Recovery(path.with_name(name + _SUFFIX), written)
                    if not beside:
                        found.append(recovery)
                    elif not recovery.path.exists():
                        recovery.discard()
    return sorted(found, key=lambda recovery: recovery.written, reverse=True)


def _is_alive(process: int) -> bool:
    """Return whether a process runs; on Windows the heartbeat alone tells."""
    if os.name == "posix":
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
        except PermissionError:  # it is another user's
            pass
    return True
