"""The process that `match_apart` speaks with: one thread matches, this one listens."""

import os
import threading
import traceback
from collections import OrderedDict
from contextlib import suppress
from dataclasses import replace
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

import abfm
from abfm import AbfmError, Control, Iteration, TriangleMesh
from abfm.numerics.own_process import Requests, factoring_apart
from abfm.progress import telling
from abfm_viewer.computing.freed_memory import give_back
from abfm_viewer.computing.match_apart import PREPARING, RemoteLook, numbers, parts
from abfm_viewer.computing.picture_pace import PicturePace

_KEPT = 4  # iterates whose fields may be asked for
_TOGETHER = 0.02  # seconds for which iterates wait for one another: each message costs the match the time of its own


class _Matching:
    """What goes on in the process."""

    def __init__(self, requests: Requests) -> None:
        self._requests = requests
        self._lock = threading.Lock()
        self._controls: dict[int, Control] = {}
        self._recent: OrderedDict[tuple[int, int], Iteration] = OrderedDict()
        self._work: SimpleQueue[tuple[Any, ...]] = SimpleQueue()
        self._unsent: SimpleQueue[tuple[str, int, object]] = SimpleQueue()
        self._urgent = threading.Event()
        for work in (self._match_all, self._send_all):
            threading.Thread(target=work, daemon=True).start()

    def listen(self) -> None:
        """Take messages until nobody sends any."""
        for kind, *content in self._requests:
            if kind == "control":
                self._control(*content)
            elif kind == "fetch":
                self._tell_look(*content)
            else:
                self._work.put((kind, *content))

    def _control(self, number: int, what: str, briefly: bool) -> None:
        control = self._control_of(number)
        control.cancel(briefly) if what == "cancel" else getattr(control, what)()

    def _control_of(self, number: int) -> Control:
        """Of one run, for both threads: what is told may come before the run, or while it begins."""
        with self._lock:
            return self._controls.setdefault(number, Control())

    def _tell_look(self, number: int, iteration: int) -> None:
        with self._lock:
            known = [key for key in self._recent if key[0] == number]
            key = (number, iteration) if (number, iteration) in known else known[-1] if known else None
            found = None if key is None else self._recent[key]
        self._answer("fetch", number, (iteration, None if found is None else (found.velocity, found.advected)))

    def _answer(self, kind: str, number: int, content: object) -> None:
        self._unsent.put((kind, number, content))
        if kind != "iteration":
            self._urgent.set()

    def _send_all(self) -> None:
        """Send what is there all at once: a window that draws takes in few messages a second, and none waits for it."""
        try:
            while True:
                self._requests.answer(self._next_answers())  # not kept: an error holds on to the match that failed
        finally:  # nobody is there any more, or there is no memory: by its end the window knows
            os._exit(1)

    def _next_answers(self) -> list[tuple[str, int, object]]:
        messages = [self._unsent.get()]
        if messages[0][0] == "iteration":
            self._urgent.wait(_TOGETHER)
        self._urgent.clear()
        with suppress(Empty):
            while True:
                messages.append(self._unsent.get_nowait())
        return messages

    @factoring_apart()
    def _match_all(self) -> None:
        mesh: TriangleMesh
        while True:
            match self._work.get():
                case ("mesh", mesh):
                    with self._lock:
                        self._recent.clear()
                case ("prepare", parameters):
                    try:
                        with telling(partial(self._answer, "step", PREPARING)):
                            abfm.matching.prepare(mesh, parameters)
                    except Exception:  # a match makes them itself, and says what is wrong
                        traceback.print_exc()
                case ("match", number, problem, given):
                    self._match(mesh, number, problem, given)
                    self._let_go(number)
                    give_back()

    def _match(self, mesh: TriangleMesh, number: int, problem: tuple[Any, ...], given: dict[str, Any]) -> None:
        pace, names = PicturePace(), numbers()
        control = self._control_of(number)
        with self._lock:
            for earlier in [each for each in self._controls if each < number]:
                del self._controls[earlier]
            # of the run before something may be shown yet
            last = max((each for each, _ in self._recent), default=0)
            for key in [key for key in self._recent if key[0] < last]:
                del self._recent[key]

        def post(iteration: Iteration) -> None:
            picture = None
            if pace.takes(iteration):
                picture = iteration.advected
                with self._lock:
                    self._recent[number, iteration.iteration] = iteration
                    while len(self._recent) > _KEPT:
                        self._recent.popitem(last=False)
            public = tuple(getattr(iteration, name) for name in names)
            self._answer("iteration", number, (public, picture, iteration.warning))

        try:
            with telling(partial(self._answer, "step", number)):
                found = abfm.match(mesh, *problem, **given, on_iteration=post, control=control)
        except (AbfmError, MemoryError) as error:
            self._answer("error", number, error)
        except Exception as error:  # a bug, which the window reports in one line
            traceback.print_exc()
            self._answer("error", number, RuntimeError(f"{type(error).__name__}: {error}"))
        else:
            self._answer("match", number, [getattr(found, name) for name in parts()])

    def _let_go(self, number: int) -> None:
        """Of a run that has ended keep the last fields that may be asked for, and not the workspace behind them."""
        with self._lock:
            mine = {key: each for key, each in self._recent.items() if key[0] == number}
        kept = {}
        with suppress(MemoryError):
            if mine:
                key, last = list(mine.items())[-1]
                found = last.velocity, last.advected
                kept[key] = replace(last, look=RemoteLook(last.advected, last.warning, lambda: found))
        with self._lock:
            for key in mine:
                del self._recent[key]
            self._recent.update(kept)


if __name__ == "__main__":
    _Matching(Requests()).listen()
