"""`abfm.match` in a process of its own, so that a window and its solver do not wait for each other.

While a frame is drawn polyscope holds Python's interpreter, without a graphics card nearly all of the time: a solver in
a thread of the same process got a tenth of it. The other process gets a mesh once, and keeps what was computed from it.
"""

from __future__ import annotations

import itertools
import threading
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import fields
from functools import cached_property
from queue import SimpleQueue
from typing import Any

import abfm
from abfm import Control, Parameters, TriangleMesh
from abfm.numerics.own_process import OwnProcess, ProcessEndedError
from abfm.progress import Step, Tell
from abfm.types import FloatArray

MODULE = "abfm_viewer.computing.match_process"
PREPARING = 0
"""The number of no run: what is told while coarser meshes are made is for the one that waits for them."""
_ENDED = "the process that matches has ended; match again"


def numbers() -> list[str]:
    """Names of what an iterate is made of besides its look."""
    return [each.name for each in fields(abfm.Iteration) if each.name != "look"]


def parts() -> list[str]:
    """Names of what of a match is sent: the mesh is known at both ends."""
    return [each.name for each in fields(abfm.Match) if each.name != "mesh"]


Fetched = tuple[FloatArray, FloatArray]
"""The fields (N, F, 3) of an iterate, and the source carried by them (V, C)."""


class Relayed(Control):
    """A control whose solve is in the other process; what it is told goes there."""

    def __init__(self, number: int, tell: Callable[[int, str, bool], None]) -> None:
        super().__init__()
        self.number, self._tell = number, tell

    def pause(self) -> None:
        super().pause()
        self._tell(self.number, "pause", False)

    def resume(self) -> None:
        super().resume()
        self._tell(self.number, "resume", False)

    def cancel(self, briefly: bool = False) -> None:
        super().cancel(briefly)
        self._tell(self.number, "cancel", briefly)


class RemoteLook:
    """What an iterate looks like: its picture came along if it has one, what else is asked for is fetched."""

    def __init__(self, picture: FloatArray | None, warning: str | None, fetch: Callable[[], Fetched]) -> None:
        self.picture, self.warning, self._fetch = picture, warning, fetch

    @cached_property
    def _fetched(self) -> Fetched:
        return self._fetch()

    @property
    def velocity(self) -> FloatArray:
        """The fields (N, F, 3); waits for the other process, so not for the frame loop."""
        return self._fetched[0]

    @property
    def advected(self) -> FloatArray:
        return self._fetched[1] if self.picture is None else self.picture


class MatchApart:
    """Runs one match after the other in its process, which starts with the first message and again if it has ended."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._lock = threading.RLock()
        self._connection: _Connection | None = None
        self._mesh: weakref.ref[TriangleMesh] | None = None
        self._closed = False

    def control(self) -> Relayed:
        """For the next `match`; safe to use from any thread, as it waits for nothing."""
        return Relayed(next(self._numbers), lambda *told: self._connected().send(("control", *told)))

    def prepare(self, mesh: TriangleMesh, parameters: Parameters) -> None:
        """Let it make the coarser meshes; a match that comes meanwhile begins after that."""
        with self._lock:
            self._connected(mesh).send(("prepare", parameters))

    def match(
        self,
        mesh: TriangleMesh,
        f: FloatArray,
        g: FloatArray,
        parameters: Parameters,
        *,
        mask: FloatArray | None,
        weights: Sequence[float],
        start: FloatArray | None,
        on_iteration: Callable[[abfm.Iteration], None],
        control: Relayed,
        tell: Tell,
    ) -> abfm.Match:
        """As `abfm.match`; MemoryError if the process ends. `tell` gets the steps of `abfm.progress`."""
        number, given = control.number, {"mask": mask, "weights": weights, "start": start}
        with self._lock:  # else another thread could send another mesh before the match is sent
            connection = self._connected(mesh)
            answers = connection.begin(number)
            connection.send(("match", number, (f, g, parameters), given))
        if control.cancelled:  # also told to a process that has ended since
            control.cancel(control.brief)
        while True:
            kind, content = answers.get()
            if kind == "iteration":
                on_iteration(self._iteration(connection, number, *content))
            elif kind == "step":
                tell(content)
            elif kind == "match":
                return abfm.Match(mesh=mesh, **dict(zip(parts(), content, strict=True)))
            else:
                raise content

    @staticmethod
    def pictured(iteration: abfm.Iteration) -> bool:
        """Whether an iterate came with its picture."""
        return not isinstance(iteration.look, RemoteLook) or iteration.look.picture is not None

    def close(self) -> None:
        """End the process at once."""
        with self._lock:
            self._closed = True
            if self._connection is not None:
                self._connection.close()

    def _iteration(
        self,
        connection: _Connection,
        number: int,
        public: tuple[Any, ...],
        picture: FloatArray | None,
        warning: str | None,
    ) -> abfm.Iteration:
        known = dict(zip(numbers(), public, strict=True))
        look = RemoteLook(picture, warning, lambda: connection.fetch(number, known["iteration"]))
        return abfm.Iteration(**known, look=look)

    def _connected(self, mesh: TriangleMesh | None = None) -> _Connection:
        """The process, which knows a mesh then."""
        with self._lock:
            if self._connection is None or (self._connection.ended and not self._closed):
                self._connection, self._mesh = _Connection(), None
                if self._closed:
                    self._connection.close()
            if mesh is not None and (self._mesh is None or self._mesh() is not mesh):
                self._mesh = weakref.ref(mesh)
                self._connection.send(("mesh", mesh))
            return self._connection


class _Connection:
    """To one process: nothing that is sent is waited for, and each answer goes to who waits for it."""

    def __init__(self) -> None:
        self.ended = False
        self._process = OwnProcess(MODULE)
        self._unsent: SimpleQueue[object] = SimpleQueue()
        self._run: tuple[int, SimpleQueue[tuple[str, Any]]] = (PREPARING, SimpleQueue())
        self._preparing: Step | None = None
        self._fetched: dict[tuple[int, int], Future[Fetched]] = {}
        self._lock = threading.Lock()
        for work in (self._write, self._read):
            threading.Thread(target=work, name="match process", daemon=True).start()

    def send(self, message: object) -> None:
        self._unsent.put(message)

    def begin(self, number: int) -> SimpleQueue[tuple[str, Any]]:
        """Where the answers about a run of this number come."""
        with self._lock:
            self._run = number, SimpleQueue()
            if self._preparing:
                self._run[1].put(("step", self._preparing))
            if self.ended:
                self._run[1].put(("error", MemoryError(_ENDED)))
            return self._run[1]

    def fetch(self, number: int, iteration: int) -> Fetched:
        """The fields of an iterate and the source carried by them, or those of one close by that is still known.

        Raises
        ------
        AbfmError
            If nothing is known of that run any more.
        """
        with self._lock:
            if self.ended:
                raise abfm.AbfmError(_ENDED)
            is_new = (number, iteration) not in self._fetched
            future = self._fetched.setdefault((number, iteration), Future())
        if is_new:
            self.send(("fetch", number, iteration))
        return future.result()

    def close(self) -> None:
        self._process.close()
        self.send(None)

    def _write(self) -> None:
        try:
            with suppress(ProcessEndedError):  # the reader tells
                while (message := self._unsent.get()) is not None:
                    self._process.send(message)
        finally:  # also where there is no memory for a message
            self._process.close()

    def _read(self) -> None:
        try:
            with suppress(ProcessEndedError):
                while True:
                    self._take(self._process.receive())
        finally:
            with self._lock:
                self.ended = True
                self._run[1].put(("error", MemoryError(_ENDED)))
                for future in self._fetched.values():
                    future.set_exception(abfm.AbfmError(_ENDED))
                self._fetched.clear()
            self.send(None)  # so that the writer ends

    def _take(self, messages: list[tuple[str, int, Any]]) -> None:
        """Give each to who waits for it."""
        with self._lock:
            for kind, number, content in messages:
                if kind == "fetch":
                    self._answer(self._fetched.pop((number, content[0])), content[1])
                    continue
                told = content.begun_now() if isinstance(content, Step) else content
                if number == PREPARING:
                    self._preparing = told
                if number in (PREPARING, self._run[0]):
                    self._run[1].put((kind, told))

    @staticmethod
    def _answer(future: Future[Fetched], found: Fetched | None) -> None:
        if found is None:
            future.set_exception(abfm.AbfmError("the field of that iterate is not known any more"))
        else:
            future.set_result(found)
