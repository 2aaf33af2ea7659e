"""Work in a subprocess, so that the main process stays responsive.

Some libraries hold Python's interpreter lock while they factor a matrix, and a window holds the
lock while it draws. A subprocess has its own interpreter, and can be killed.
"""

from __future__ import annotations

import itertools
import os
import threading
import traceback
import warnings
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from contextvars import ContextVar
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

from abfm.errors import AbfmError, AbfmWarning
from abfm.workers.control import CancelledError, Control, controlled, current_control
from abfm.workers.messages import Answer, ControlUpdate, MessageKind, Request, pack
from abfm.workers.process import ChildProcess, ProcessEndedError, Requests
from abfm.workers.progress import report_step, reporting_steps

State = TypeVar("State")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

WORKER_MODULE = "abfm.workers"
# seconds for which reports are collected into one message, as each message takes time
_REPORT_SECONDS = 0.02
_answer: ContextVar[Callable[[MessageKind, object], None]] = ContextVar(
    "answers to the current call"
)


class WorkerEndedError(AbfmError):
    """The process of a `Worker` has ended, by `Worker.close` or from outside."""


class Call(Generic[Result]):
    """A call of a function in the process of a `Worker`; `result` waits for the return value."""

    def __init__(self, connection: _Connection, number: int, is_immediate: bool) -> None:
        self._connection, self.number, self.is_immediate = connection, number, is_immediate
        self.named: dict[str, Any] = {}  # values that were sent with it by name
        self.answers: deque[Answer] = deque()

    def result(self, on_report: Callable[[Any], object] = lambda report: None) -> Result:
        """Wait for the return value, or raise the error of the function.

        Meanwhile steps and warnings of the library are reported as if they were of this thread.
        While this call waits for an earlier one, the steps of that call have no estimates. The
        control of this thread pauses and cancels the call. ``on_report`` is called with each report
        of the function (see `report`). The call is cancelled if waiting for it is interrupted.
        """
        control, is_over = current_control(), False

        def send(control: Control) -> None:
            update = ControlUpdate(
                self.number, control.paused, control.cancelled, control.skip_checks
            )
            self._connection.send_update(update)

        try:
            with control.observed_by(send) if control else nullcontext():
                while True:
                    number, kind, parcel = self._connection.answer(self)
                    is_over = kind in ("value", "error")
                    content, _ = parcel.unpack(self.named)
                    match kind:
                        case "step":
                            is_own = number == self.number
                            report_step(content if is_own else content and content.alone())
                        case "report":
                            on_report(content)
                        case "warning":
                            warnings.warn(content, AbfmWarning, stacklevel=2)
                        case "value":
                            value: Result = content
                            return value
                        case "error":
                            raise content
        finally:
            if not is_over:
                self._connection.send_update(ControlUpdate(self.number, False, True, True))


def no_state() -> None:
    """Return None, the state of a worker whose functions need no state."""


class Worker(Generic[State]):
    """Calls functions one after the other in a subprocess, with a state as the first argument.

    The process starts with the first call, and again with the next call if it has ended. It ends
    when the worker is closed or garbage-collected. ``make_state`` makes the state in the process.
    Like all called functions, it must be importable there. ``ended_message`` is the message of the
    `WorkerEndedError` if the process has ended. ``environment`` has environment variables that are
    changed for the process.
    """

    def __init__(
        self,
        make_state: Callable[[], State],
        ended_message: str,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._make_state, self._environment = make_state, environment
        self._ended_message = ended_message
        self._lock = threading.Lock()
        self._connection: _Connection | None = None
        self._closed = False

    def call(
        self,
        function: Callable[Concatenate[State, Arguments], Result],
        /,
        *given: Arguments.args,
        **_: Arguments.kwargs,
    ) -> Call[Result]:
        """Call a function after all earlier calls, without waiting for its result."""
        with self._lock:
            if self._closed:
                raise WorkerEndedError(self._ended_message)
            if self._connection is None or self._connection.process.has_ended:
                try:
                    self._connection = _Connection(
                        self._make_state, self._ended_message, self._environment
                    )
                except OSError as error:
                    raise WorkerEndedError(self._ended_message) from error
            connection = self._connection
        return connection.call(function, given, False)

    def call_now(
        self,
        function: Callable[Concatenate[State, Arguments], Result],
        /,
        *given: Arguments.args,
        **_: Arguments.kwargs,
    ) -> Call[Result]:
        """Call a short function at once, even during another call.

        Raise a WorkerEndedError if the process has not started.
        """
        if self._connection is None:
            raise WorkerEndedError(self._ended_message)
        return self._connection.call(function, given, True)

    @property
    def is_idle(self) -> bool:
        return self._connection is None or not self._connection.is_awaited

    @property
    def pid(self) -> int | None:
        connection = self._connection
        return connection.process.pid if connection else None

    def close(self) -> None:
        """End the process and refuse further calls; waiting calls raise WorkerEndedError."""
        with self._lock:
            self._closed = True
            if self._connection is not None:
                self._connection.process.close()


class _Connection:
    """The connection to one process; a thread that waits for an answer distributes all answers."""

    def __init__(
        self,
        make_state: Callable[[], object],
        ended_message: str,
        environment: Mapping[str, str] | None,
    ) -> None:
        self.process = ChildProcess(WORKER_MODULE, environment)
        self._numbers = itertools.count()
        self._has_ended = False
        self._ended_message = ended_message
        self._calls: weakref.WeakValueDictionary[int, Call[Any]] = weakref.WeakValueDictionary()
        self._sent: tuple[str, ...] = ()  # names of the values that the process holds
        self._step: Answer | None = None  # the current step of the process
        self._arrived = threading.Condition()
        self._is_reading = False
        self._sending = threading.Lock()
        self._updates: deque[ControlUpdate] = deque()
        self._send(make_state)

    def call(
        self, function: Callable[..., Result], given: tuple[Any, ...], is_immediate: bool
    ) -> Call[Result]:
        call = Call[Result](self, next(self._numbers), is_immediate)
        with self._arrived:
            self._calls[call.number] = call
            if self._step is not None and not is_immediate:
                call.answers.append(self._step)
        with self._sending:
            parcel, call.named = pack((function, given), self._sent)
            self._sent = parcel.names or self._sent
            self._send(Request(call.number, parcel, is_immediate))
        self._send_updates()
        return call

    @property
    def is_awaited(self) -> bool:
        return bool(self._calls)

    def send_update(self, update: ControlUpdate) -> None:
        """Send an update without waiting.

        If another thread is sending a request, that thread sends the update afterwards.
        """
        self._updates.append(update)
        self._send_updates()

    def answer(self, call: Call[Any]) -> Answer:
        while True:
            with self._arrived:
                while self._is_reading and not call.answers:
                    self._arrived.wait()
                if call.answers:
                    return call.answers.popleft()
                if self._has_ended:
                    raise WorkerEndedError(self._ended_message)
                self._is_reading = True
            answers: list[Answer] | None = None
            try:
                with suppress(ProcessEndedError):
                    answers = self.process.receive()
            finally:
                if answers is None:
                    self.process.close()  # otherwise it remains as a zombie
                with self._arrived:
                    self._is_reading, self._has_ended = False, answers is None
                    self._distribute(answers or [])
                    self._arrived.notify_all()

    def _send(self, message: object) -> None:
        with suppress(ProcessEndedError):  # the error is raised again when the answer is missing
            self.process.send(message)

    def _send_updates(self) -> None:
        while self._updates and self._sending.acquire(blocking=False):
            try:
                with suppress(IndexError):
                    self._send(self._updates.popleft())
            finally:
                self._sending.release()

    def _distribute(self, answers: list[Answer]) -> None:
        """Pass each answer to its call, and steps also to all later calls, which wait for it."""
        for answer in answers:
            is_step = answer.kind == "step"
            if is_step:
                self._step = answer
            for number, call in list(self._calls.items()):
                waits = is_step and number > answer.number and not call.is_immediate
                if waits or number == answer.number:
                    call.answers.append(answer)


def report(content: object) -> None:
    """Send a report to the thread that waits for the current call."""
    _answer.get()("report", content)


class Server:
    """The main loop of the process: it reads requests, one thread computes, and one answers.

    The process ends if the parent ends or if there is no memory. The first message is a function
    that makes the state, the first argument of all called functions.
    """

    def __init__(self) -> None:
        self._requests = Requests()
        self._state: Any = None
        self._named: dict[str, Any] = {}  # named values of the latest request that had any
        self._controls: dict[int, Control] = {}
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._unsent: SimpleQueue[Answer] = SimpleQueue()
        self._urgent = threading.Event()

    def run(self) -> None:
        """Read messages until the parent ends; then end the process, even during a computation."""
        warnings.simplefilter("always", AbfmWarning)
        warnings.showwarning = partial(_show_warning, warnings.showwarning)
        for work in (self._compute, self._send):
            threading.Thread(target=_run_and_exit, args=(work,), daemon=True).start()
        _run_and_exit(self._listen)

    def _listen(self) -> None:
        self._state = next(iter(self._requests), tuple)()
        for message in self._requests:
            match message:
                case ControlUpdate(number, paused, cancelled, skip_checks):
                    # the call may have ended already
                    control = self._controls.get(number, Control())
                    control.cancel(skip_checks) if cancelled else control.set_paused(paused)
                case Request(number, parcel, is_immediate):
                    given, named = parcel.unpack(self._named)
                    self._named = named or self._named
                    self._controls[number] = Control()
                    call = partial(self._call, number, named, *given)
                    call() if is_immediate else self._calls.put(call)

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
        def answer(kind: MessageKind, value: object) -> None:
            self._unsent.put(Answer(number, kind, pack(value, known)[0]))
            if kind != "report":
                self._urgent.set()

        answering = _answer.set(answer)
        try:
            with reporting_steps(partial(answer, "step")), controlled(self._controls[number]):
                value = function(self._state, *given)
            answer("value", value)
        except BaseException as error:  # after SystemExit too, the caller needs an answer
            answer("error", _sendable(error))
        finally:
            _answer.reset(answering)
            del self._controls[number]

    def _send(self) -> None:
        """Send pending answers together, as a drawing window receives few messages per second."""
        while True:
            answers = [self._unsent.get()]
            if answers[0].kind == "report":
                self._urgent.wait(_REPORT_SECONDS)
            self._urgent.clear()
            with suppress(Empty):
                while True:
                    answers.append(self._unsent.get_nowait())
            self._requests.answer(answers)


def _show_warning(
    before: Callable[..., None], message: Warning | str, category: type[Warning], *place: Any
) -> None:
    """Send a library warning to the thread that waits for the call; ``before`` prints others."""
    answer = _answer.get(None)
    if answer is not None and issubclass(category, AbfmWarning):
        answer("warning", str(message))
    else:
        before(message, category, *place)


def _run_and_exit(work: Callable[[], None]) -> None:
    try:
        with suppress(BrokenPipeError):
            work()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(0)


def _sendable(error: BaseException) -> BaseException:
    """Return an error without its traceback; an unexpected error becomes a RuntimeError."""
    if isinstance(error, AbfmError | MemoryError | CancelledError):
        return error.with_traceback(None)
    traceback.print_exception(error)
    return RuntimeError(f"{type(error).__name__}: {error}")
