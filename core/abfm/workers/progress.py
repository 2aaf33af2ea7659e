"""Progress of long-running work: the current step and its expected duration.

The work runs inside ``with step("factoring", work=n**1.5)``, the caller inside ``with
reporting_steps(show)``. The duration of a step is extrapolated from earlier steps of the same name
in this process. These steps are mostly smaller, since a match factors its coarse meshes first. No
computed result depends on the durations.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from abfm.workers.control import checkpoint

Item = TypeVar("Item")

COMPILING = "compiling, once on this machine"
_compilation_seconds = 0.0  # of all finished compilations of this process

# rates measured at a smaller share of the largest measured work do not predict large works
_WORK_SHARE_MIN = 0.25
_SECONDS_MIN = 1e-3  # shorter steps are not measured, as the clock is too coarse
_SECONDS_SHOWN_MIN = 2.0  # the duration of shorter steps is not shown
_SHARE_MAX = 0.99  # share of a step that takes longer than expected
_EXCESS_SHARE = 0.2  # a step that exceeds its estimate still takes this share of the excess
_SHARE_PER_SECOND_MAX = 0.1  # growth of that share, because the first estimates may be too short
_FALL_MAX = 0.1  # largest amount by which the share of a task may fall
# delay with which the estimate of the end follows changes: in seconds, plus a share of elapsed time
_DELAY_SECONDS = 3.0
_DELAY_SHARE = 0.1
_MARGIN = 1.1  # a shown remaining time is at least this multiple of its estimate
_RISE_MIN = 1.25  # a longer remaining time is shown from this multiple of the one before
# remaining times that are shown, in seconds
_TIMES = (5, 10, 20, 30, 45, 60, 120, 180, 300, 420, 600, 900, 1200, 1800, 2700, 3600)


def work_time() -> float:
    """Return the time of a clock in seconds, which a finished compilation has not moved."""
    return time.monotonic() - _compilation_seconds


@dataclass(frozen=True)
class Step:
    """A step of long-running work."""

    task: str
    expected: float | None = None  # duration in seconds; None if unknown
    done: float | None = None  # completed share, 0 to 1; None if it is not counted
    began: float = field(default_factory=work_time)  # start, by `work_time`
    after: float | None = None
    """Seconds of the phases that follow in the same task, if this step is a phase; else None."""
    repeats: float = 0.0  # how often a phase as long as this one follows
    outer: Step | None = None  # the enclosing step

    def share(self, now: float | None = None) -> float | None:
        """Return the completed share, 0 to 1, at time ``now``; None if it is unknown.

        The share never decreases.
        """
        if self.done is not None or self.expected is None:
            return self.done
        return min(self._elapsed(now) / self.expected, _SHARE_MAX)

    def seconds_remaining(self, now: float | None = None) -> float | None:
        """Return the remaining seconds, at least 0; None if unknown."""
        elapsed = self._elapsed(now)
        if self.expected is None:
            return elapsed * (1 / self.done - 1) if self.done else None
        if self.done:  # the mean of both durations, weighted by the completed share
            return (1 - self.done) * (elapsed + (1 - self.done) * self.expected)
        return max(self.expected - elapsed, _EXCESS_SHARE * (elapsed - self.expected))

    def seconds_of_task(self, now: float | None = None) -> float | None:
        """Return the remaining seconds of the complete task; None if unknown."""
        inner: float | None = None
        for each in self.chain:
            found = each.seconds_remaining(now)
            if each.after is not None:
                found = inner if found is None else found
                if found is not None:
                    found += each.after + each.repeats * (each._elapsed(now) + found)
            inner = found
        return inner

    @property
    def chain(self) -> list[Step]:
        """The step and the steps around it, the outermost one last."""
        return [self, *(self.outer.chain if self.outer else ())]

    @property
    def phase(self) -> str:
        """The names of the phases to which this step belongs; empty without phases.

        Phases inside a phase that has its own estimate are left out.
        """
        names = list[str]()
        for each in reversed(self.chain):
            names += [each.task] if each.after is not None else []
            if each.seconds_remaining() is not None or each.done is not None:
                break
        return ", ".join(names)

    @property
    def is_in_phase(self) -> bool:
        return any(each.after is not None for each in self.chain)

    def inside(self, outer: Step | None) -> Step:
        """Return the step with another one around it and around its enclosing steps."""
        return replace(self, outer=self.outer.inside(outer) if self.outer else outer)

    def alone(self) -> Step:
        """Return the step without its estimates and without the steps around it."""
        return Step(self.task, began=self.began)

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes and the present time, because clocks of processes may differ."""
        return vars(self) | {"now": work_time()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        state["began"] += work_time() - state.pop("now")
        vars(self).update(state)

    def text(self, now: float | None = None) -> str:
        """Return the step as text; from two seconds on, with the remaining or elapsed time."""
        remaining, elapsed = self.seconds_of_task(now), self.chain[-1]._elapsed(now)
        if (remaining or 0.0) + elapsed < _SECONDS_SHOWN_MIN:
            return self.task
        about = f"{elapsed:.0f} s so far" if remaining is None else within(remaining)
        return f"{self.task}, {about}"

    def _elapsed(self, now: float | None) -> float:
        return max(_time(now) - self.began, 0.0)


class Overall:
    """The progress of a complete task, as a share and a text that do not jump.

    The share never falls by more than a tenth. The remaining time is rounded up, and does not
    follow small or short changes of its estimate. Both stand still while Numba compiles. If the
    task ``has_phases``, no step outside them predicts its end.
    """

    def __init__(self, now: float | None = None, has_phases: bool = False) -> None:
        self._has_phases = has_phases
        self.began = _time(now)
        self.step: Step | None = None  # the present step
        self._latest: Step | None = None  # the present step or, between two steps, the last one
        self._share = 0.0, 0.0  # the latest share, and the elapsed time
        self._most = 0.0  # the largest share so far
        self._shown = math.inf  # the remaining time that was shown last
        # the estimate of the end, which follows its changes slowly, and when it was updated
        self._end = self._updated = math.nan
        self._paused: float | None = None  # when the task was paused
        self._compiles = False

    def update(self, step: Step | None) -> None:
        """Take the present step of the task into account; None between two steps."""
        self.step, self._latest = step, step or self._latest
        compiles = step is not None and step.task == COMPILING
        if compiles is not self._compiles:
            self._compiles = compiles
            self.set_paused(compiles)

    def share(self, now: float | None = None) -> float | None:
        """Return the completed share, 0 to 1; None until it can be estimated."""
        if (remaining := self.seconds_remaining(now)) is not None:
            elapsed = self._now(now) - self.began
            before, then = self._share
            most = before + _SHARE_PER_SECOND_MAX * (elapsed - then)
            share = max(min(elapsed / (elapsed + remaining), most), self._most - _FALL_MAX)
            self._share, self._most = (share, elapsed), max(share, self._most)
            return share
        return self._most or None

    def seconds_remaining(self, now: float | None = None) -> float | None:
        """Return the estimated seconds to the end; None in the first seconds, or if unknown."""
        now = self._now(now)
        elapsed = now - self.began
        step = self._latest
        is_estimate = step is not None and (step.is_in_phase or not self._has_phases)
        seconds = step.seconds_of_task(now) if step and is_estimate else None
        if elapsed < _SECONDS_SHOWN_MIN:
            return None
        if math.isnan(self._end):
            if seconds is None:
                return None
            self._end = now + seconds
        elif seconds is not None:
            delay = _DELAY_SECONDS + _DELAY_SHARE * elapsed
            self._end += math.expm1((self._updated - now) / delay) * (self._end - now - seconds)
        self._updated = now
        return max(self._end - now, 0.0)

    @property
    def name(self) -> str:
        """The phase of the task, or its outermost step."""
        step = self._latest
        return "starting" if step is None else step.phase or step.chain[-1].task

    def detail(self, longer_than: float = 0.0) -> str:
        """Return the innermost step, unless it is the phase or lasts less than some seconds."""
        step = self.step
        is_shown = step is not None and step.after is None and step.outer is not None
        return step.task if step and is_shown and step._elapsed(None) >= longer_than else ""

    def text(self, now: float | None = None) -> str:
        """Return ``within about 20 s``; empty if the remaining time is unknown."""
        if self._compiles or (seconds := self.seconds_remaining(now)) is None:
            return ""
        wanted = next((most for most in _TIMES if _MARGIN * seconds <= most), seconds)
        if wanted < self._shown or seconds > _RISE_MIN * self._shown:
            self._shown = wanted
        return within(self._shown)

    def set_paused(self, paused: bool) -> None:
        """Stop or restart the clock of the task, whose pauses do not count."""
        if not paused and self._paused is not None:
            self.began += _time(None) - self._paused
        self._paused = _time(None) if paused else None

    def _now(self, now: float | None) -> float:
        return _time(now) if self._paused is None else self._paused


def within(seconds: float) -> str:
    """Return a remaining time in words, rounded up: ``within about 20 s``."""
    hours = 3600 * math.ceil(seconds / 3600)
    return f"within about {rounded_time(next((s for s in _TIMES if seconds <= s), hours))}"


def rounded_time(seconds: float) -> str:
    """Return a time with its unit: ``20 s``, ``3 min``, ``2 h``."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"


def _time(now: float | None) -> float:
    return work_time() if now is None else now


@contextmanager
def compiling() -> Iterator[None]:
    """Report a compilation as a step, which delays no estimate of other steps."""
    global _compilation_seconds
    outer = _running.get()
    if outer is not None and outer.step.task == COMPILING:  # which includes this compilation
        yield
        return
    began = work_time()
    with step(COMPILING):
        yield
        _compilation_seconds += work_time() - began


def progress_text(what: str, step: Step | None) -> str:
    return f"{what}: {step.text()}" if step else what


StepListener = Callable[[Step | None], None]
_step_listener: ContextVar[StepListener | None] = ContextVar("step listener", default=None)
_running: ContextVar[_Running | None] = ContextVar("running step", default=None)
# Seconds per unit of work of steps by their names, on a machine with two cores, before this process
# measures them.
INITIAL_RATES: dict[str, float] = {
    "making coarser meshes": 1.2e-5,  # seconds per vertex
    "factoring": 1.4e-8,  # seconds per unknowns^(3/2)
    "factoring for distances": 2.6e-7,  # seconds per vertices^(3/2)
    "checking by flow lines": 1.6e-5,  # seconds per vertex
    "searching for symmetries": 4.5e-5,  # seconds per vertex
    "reading": 1e-7,  # seconds per byte
    "comparing initial maps": 1.2e-3,  # seconds per vertex
    "choosing sigma": 1.2e-3,  # seconds per vertex
    "following the frames": 2e-5,  # seconds per vertex and interval, as for the next ones
    "smoothing in time": 1.1e-5,
    "correcting by flow lines": 1.1e-5,
}
# seconds per unit of work, and the amount of work for which this process measured it
_rates = {name: (seconds, 0.0) for name, seconds in INITIAL_RATES.items()}
_lock = threading.Lock()


@contextmanager
def reporting_steps(listener: StepListener) -> Iterator[None]:
    """Call a listener with each step that this thread begins, and with None if none remains."""
    before = _step_listener.set(listener)
    try:
        yield
    finally:
        _step_listener.reset(before)


def report_step(now: Step | None) -> None:
    """Report a step of another thread or process within that of this thread, or None at its end."""
    outer = _step_of(_running.get())
    _report(now.inside(outer) if now else outer)


def _report(now: Step | None) -> None:
    if listener := _step_listener.get():
        listener(now)


@contextmanager
def step(
    task: str,
    work: float | None = None,
    about: str = "",
    since: float | None = None,
    after: float | None = None,
) -> Iterator[Callable[[float], None]]:
    """Report a step while the context lasts; yield a function to report its completed share.

    ``work`` is the amount of work, in a unit that depends on the task; it predicts the duration.
    ``about`` is added to the name in reports, for example the size. ``since`` is the start by
    `work_time`, by default now. ``after`` makes the step a `phase`.
    """
    expected = usual_seconds(task, work) if work else None
    began = work_time() if since is None else since
    with _reported(Step(f"{task}{about}", expected, None, began, after)) as change:
        done = 0.0

        def report(share: float) -> None:
            nonlocal done
            if math.isfinite(share):
                done = min(max(share, done), 1.0)
                change(done=done)

        yield report
        if work:
            _store_rate(task, (work_time() - began) / work, work)


@contextmanager
def phase(
    task: str, after: float = 0.0, repeats: float = 0.0
) -> Iterator[Callable[[float, str], None]]:
    """Report a phase of a task; yield a function to report its remaining seconds and its name.

    Without a report, the remaining time of a phase is that of the steps in it. ``after`` are the
    estimated seconds of the phases that follow, and ``repeats`` is the number of following phases
    as long as this one.
    """
    began = work_time()
    with _reported(Step(task, None, None, began, after, repeats)) as change:
        yield lambda left, name: change(task=name, expected=work_time() - began + left)


def usual_seconds(task: str, work: float) -> float | None:
    """Return the expected duration of a step with an amount of work; None if unknown."""
    known = _rates.get(task)
    return known[0] * work if known else None


class _Running:
    """A step that this thread has begun, and the step around it."""

    def __init__(self, step: Step, outer: _Running | None) -> None:
        self._step, self.outer = step, outer

    @property
    def step(self) -> Step:
        return replace(self._step, outer=_step_of(self.outer))

    def change(self, **values: Any) -> None:
        self._step = replace(self._step, **values)
        _report(self.step)


def _step_of(running: _Running | None) -> Step | None:
    return None if running is None else running.step


@contextmanager
def _reported(step: Step) -> Iterator[Callable[..., None]]:
    """Report a step while the context lasts; yield a function to change it."""
    running = _Running(step, _running.get())
    inner = _running.set(running)
    running.change()
    try:
        yield running.change
    finally:
        with suppress(ValueError):  # an unfinished generator may be deleted in another context
            _running.reset(inner)
            _report(_step_of(running.outer))


@contextmanager
def stepped(
    task: str, items: Collection[Item], after: float | None = None
) -> Iterator[Iterator[Item]]:
    """Report work through items as one step, which ends with the context.

    The context yields an iterator over the items. It calls `checkpoint` before each item, and
    reports the completed share after each.
    """
    with step(task, after=after) as done:
        yield _counted(items, done)


def _counted(items: Collection[Item], done: Callable[[float], None]) -> Iterator[Item]:
    for count, item in enumerate(items, 1):
        checkpoint()
        yield item
        done(count / len(items))


def _store_rate(task: str, rate: float, work: float) -> None:
    """Store the seconds per unit of work of a task, to predict its next duration.

    Work of less than a quarter of the largest work is ignored. On a busy machine, its rate does not
    predict the rate of large work.
    """
    if rate * work < _SECONDS_MIN:
        return
    with _lock:
        before, most = _rates.get(task, (rate, 0.0))
        if work >= most:
            _rates[task] = rate, work
        elif work >= _WORK_SHARE_MIN * most:
            _rates[task] = (before + rate) / 2, most
