"""The process of a `worker.Worker`: one thread computes, one answers, this one listens.

When nobody is there any more, or there is no memory, the process ends: by that the other end knows.
"""

from __future__ import annotations

import os
import threading
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from contextvars import ContextVar
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

from abfm.errors import AbfmError
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.messages import Answer, Kind, Order, Request, pack
from abfm.workers.process import Requests
from abfm.workers.progress import telling

# seconds for which reports wait for one another: each message costs the work the time of its own
_TOGETHER = 0.02
_report: ContextVar[Callable[[object], None]] = ContextVar("who is told of work on its way")


def report(content: object) -> None:
    """Tell who waits for the present call something on its way."""
    _report.get()(content)


class Server:
    """Answers requests until nobody sends any; the first message makes the state that all are
    about.
    """

    def __init__(self, requests: Requests) -> None:
        self._requests = requests
        self._state: Any = None
        self._named: dict[str, Any] = {}  # of the latest request that had any
        self._controls: dict[int, Control] = {}
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._unsent: SimpleQueue[Answer] = SimpleQueue()
        self._urgent = threading.Event()

    def run(self) -> None:
        """Take messages until nobody sends any, then end the process, whatever it computes."""
        for work in (self._compute, self._send):
            threading.Thread(target=_to_the_end, args=(work,), daemon=True).start()
        _to_the_end(self._listen)

    def _listen(self) -> None:
        self._state = next(iter(self._requests), tuple)()
        for message in self._requests:
            match message:
                case Order(number, paused, cancelled, brief):
                    # of one that is over nothing is known
                    control = self._controls.get(number, Control())
                    control.cancel(brief) if cancelled else control.hold(paused)
                case Request(number, parcel, aside):
                    given, named = parcel.unpack(self._named)
                    self._named = named or self._named
                    self._controls[number] = Control()
                    call = partial(self._call, number, named, *given)
                    call() if aside else self._calls.put(call)

    def _compute(self) -> None:
        while True:
            self._calls.get()()

    def _call(
        self,
        number: int,
        known: Mapping[str, Any],
        function: Callable[..., Any],
        given: tuple[Any, ...],
    ) -> None:
        answer = partial(self._answer, number, known)
        reporting = _report.set(partial(answer, "report"))
        try:
            with telling(partial(answer, "step")), controlled(self._controls[number]):
                value = function(self._state, *given)
            answer("value", value)
        except BaseException as error:  # also what is no Exception: else nobody would be answered
            answer("error", _as_sent(error))
        finally:
            _report.reset(reporting)
            del self._controls[number]

    def _answer(self, number: int, known: Mapping[str, Any], kind: Kind, value: object) -> None:
        self._unsent.put(Answer(number, kind, pack(value, known)[0]))
        if kind != "report":
            self._urgent.set()

    def _send(self) -> None:
        """Send what is there all at once: a window that draws takes in few messages a second,
        and none waits for it.
        """
        while True:
            answers = [self._unsent.get()]
            if answers[0].kind == "report":
                self._urgent.wait(_TOGETHER)
            self._urgent.clear()
            with suppress(Empty):
                while True:
                    answers.append(self._unsent.get_nowait())
            self._requests.answer(answers)


def _to_the_end(work: Callable[[], None]) -> None:
    """Work, and then end the process."""
    try:
        with suppress(BrokenPipeError):
            work()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(0)


def _as_sent(error: BaseException) -> BaseException:
    """Return an error without what it holds on to; a bug as what can surely be sent."""
    if isinstance(error, AbfmError | MemoryError | CancelledError):
        return error.with_traceback(None)
    traceback.print_exception(error)
    return RuntimeError(f"{type(error).__name__}: {error}")
