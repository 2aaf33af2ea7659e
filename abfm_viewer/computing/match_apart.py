"""`abfm.match` in a process of its own, so that a window and its solver do not wait for each other.

While a frame is drawn polyscope holds Python's interpreter, without a graphics card nearly all of
the time: a solver in a thread of the same process got a tenth of it. The other process gets a mesh
once, and keeps what was computed from it. `Matching` is its end, `MatchApart` that of the window.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import abfm
from abfm import Parameters, TriangleMesh
from abfm.numerics.factoring_apart import factoring_apart
from abfm.types import FloatArray
from abfm.workers.server import report
from abfm.workers.worker import Worker, WorkerEndedError
from abfm_viewer.computing.freed_memory import give_back
from abfm_viewer.computing.picture_pace import PicturePace

_ENDED = "the process that matches has ended; match again"
_KEPT = 4  # iterates whose fields may be asked for

Fields = tuple[FloatArray, FloatArray]
"""The fields (N, F, 3) of an iterate, and the source carried by them (V, C)."""


@dataclass(frozen=True)
class Picture:
    """What is sent of an iterate's look; its ``advected`` where it is pictured, else None."""

    advected: FloatArray | None
    warning: str | None


@dataclass(frozen=True)
class Known:
    """The look of an iterate whose workspace is gone."""

    velocity: FloatArray
    advected: FloatArray
    warning: str | None


class Matching:
    """What the process does, and its state: the last few pictured iterates of a run, and of the
    one before, which may be shown yet.
    """

    def __init__(self) -> None:
        self._recent: dict[int, tuple[abfm.Iteration, ...]] = {}

    def prepare(self, mesh: TriangleMesh, parameters: Parameters) -> None:
        """Make the coarser meshes on which a match begins."""
        with factoring_apart():
            abfm.matching.prepare(mesh, parameters)

    def match(self, run: int, problem: abfm.Problem) -> abfm.Match:
        """Match, and report every iterate, some with their pictures."""
        pace = PicturePace()
        before = max(self._recent, default=0)
        self._recent = {before: self._recent.get(before, ()), run: ()}

        def post(iteration: abfm.Iteration) -> None:
            picture = None
            if pace.takes(iteration):
                picture = iteration.advected
                self._recent[run] = (*self._recent[run], iteration)[-_KEPT:]
            look: Any = Picture(picture, iteration.warning)
            report(replace(iteration, look=look))

        try:
            with factoring_apart():
                return abfm.match(problem, on_iteration=post)
        finally:
            self._let_go(run)
            give_back()

    def fields(self, run: int, iteration: int) -> Fields:
        """Return the fields of an iterate and the source carried by them, or those of the last
        one that is still known.

        Raises
        ------
        AbfmError
            If nothing is known of that run any more.
        """
        if not (known := self._recent.get(run)):
            raise abfm.AbfmError("the field of that iterate is not known any more")
        found = next((each for each in known if each.iteration == iteration), known[-1])
        return found.velocity, found.advected

    def _let_go(self, run: int) -> None:
        """Keep of a run that has ended the last fields, and not the workspace behind them."""
        *_, last = (None, *self._recent[run])
        kept: tuple[abfm.Iteration, ...] = ()
        if last is not None:
            with suppress(MemoryError):
                kept = (replace(last, look=Known(last.velocity, last.advected, last.warning)),)
        self._recent[run] = kept


class RemoteLook:
    """What an iterate looks like: its picture came along if it has one, what else is asked for
    is fetched; then both are of one iterate, if it is not known any more of one close by.
    """

    def __init__(self, picture: Picture, fetch: Callable[[], Fields]) -> None:
        self.picture, self.warning, self._fetch = picture.advected, picture.warning, fetch

    @cached_property
    def velocity(self) -> FloatArray:
        """The fields (N, F, 3); waits for the other process, so not for the frame loop."""
        velocity, self.picture = self._fetch()
        return velocity

    @property
    def advected(self) -> FloatArray:
        """The source carried to tau, (V, C)."""
        if self.picture is None:
            _, self.picture = self._fetch()
        return self.picture


class MatchApart:
    """Runs one match after the other in its process, which starts with the first of them and
    again if it has ended.

    One that is idle when it is closed leaves its process to the next one, to which nothing of it
    is seen: where a script opens one window after the other, one process is enough.
    """

    _spare: ClassVar[list[Worker[Matching]]] = []
    _runs: ClassVar[Iterator[int]] = itertools.count(1)

    def __init__(self) -> None:
        self._is_matching = self._closed = False

    @cached_property
    def _worker(self) -> Worker[Matching]:
        if self._closed:
            raise WorkerEndedError(_ENDED)
        with suppress(IndexError):
            return self._spare.pop()
        return Worker(Matching, _ENDED)

    @property
    def pid(self) -> int | None:
        """The process's number; None before it starts."""
        return self._worker.pid

    def prepare(self, mesh: TriangleMesh, parameters: Parameters) -> None:
        """Let it make the coarser meshes; a match that comes meanwhile begins after that."""
        self._worker.call(Matching.prepare, mesh, parameters)

    def match(
        self, problem: abfm.Problem, on_iteration: Callable[[abfm.Iteration], None]
    ) -> abfm.Match:
        """As `abfm.match`, held and ended by the control of this thread.

        Raises
        ------
        WorkerEndedError
            If the process ends.
        """
        self._is_matching = True
        run = next(self._runs)
        call = self._worker.call(Matching.match, run, problem)

        def take(iteration: abfm.Iteration) -> None:
            assert isinstance(iteration.look, Picture)
            look = RemoteLook(
                iteration.look,
                lambda: call.beside(Matching.fields, run, iteration.iteration).result(),
            )
            on_iteration(replace(iteration, look=look))

        found = call.result(take)
        self._is_matching = False
        return found

    def close(self) -> None:
        """Take no more; a match that is under way is ended at once."""
        was_closed, self._closed = self._closed, True
        if was_closed or "_worker" not in vars(self):  # nothing has started
            return
        if self._is_matching or self._spare:
            self._worker.close()
        else:
            self._spare.append(self._worker)


def is_pictured(iteration: abfm.Iteration) -> bool:
    """Tell whether an iterate came with its picture."""
    return isinstance(iteration.look, RemoteLook) and iteration.look.picture is not None
