"""The solver's thread: takes an immutable problem, posts snapshots, and never touches the screen."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

import abfm
from abfm import AbfmError, Control, Iteration, Match, Parameters, TriangleMesh
from abfm.mesh import FloatArray

FRAMES = 61


@dataclass(frozen=True, eq=False)
class Result:
    """A match, and its advected source (T, V) at evenly spaced times (T,) from 0 to tau."""

    match: Match
    times: FloatArray
    frames: FloatArray

    def advected(self, time: float) -> FloatArray:
        """The source at a time from 0 to tau, between two frames interpolated."""
        position = np.interp(time, self.times, np.arange(len(self.times)))
        before = int(position)
        after = min(before + 1, len(self.times) - 1)
        blend = position - before
        interpolated: FloatArray = (1 - blend) * self.frames[before] + blend * self.frames[after]
        return interpolated


class Worker:
    """One match in a thread of its own; what it posts may be read at any time.

    Attributes
    ----------
    latest : Iteration or None
        The newest iterate.
    result : Result or None
        Set when the match ended well or was cancelled.
    error : str
        Why there is no result, in one line.
    """

    def __init__(self, mesh: TriangleMesh, source: FloatArray, target: FloatArray, parameters: Parameters) -> None:
        self.latest: Iteration | None = None
        self.result: Result | None = None
        self.error = ""
        self._control = Control()
        self._thread = threading.Thread(target=self._run, args=(mesh, source, target, parameters), daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the thread is still at work."""
        return self._thread.is_alive()

    def cancel(self) -> None:
        """Ask for the best result so far; returns at once."""
        self._control.cancel()

    def wait(self) -> None:
        """Return when the thread has ended."""
        self._thread.join()

    def _run(self, mesh: TriangleMesh, source: FloatArray, target: FloatArray, parameters: Parameters) -> None:
        try:
            match = abfm.match(mesh, source, target, parameters, on_iteration=self._post, control=self._control)
            times = np.linspace(0, parameters.tau, FRAMES)
            self.result = Result(match, times, match.advect(times))
        except (AbfmError, MemoryError) as error:
            self.error = " ".join(str(error).split()) or "out of memory"

    def _post(self, iteration: Iteration) -> None:
        self.latest = iteration
