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
from typing import TypeVar

from abfm.workers.control import checkpoint

Item = TypeVar("Item")

# rates measured at a smaller share of the largest measured work do not predict large works
_WORK_SHARE_MIN = 0.25
_SECONDS_MIN = 1e-3  # shorter steps are not measured, as the clock is too coarse
_SECONDS_SHOWN_MIN = 2.0  # the duration of shorter steps is not shown
_SHARE_MAX = 0.99  # share of a step that takes longer than expected


@dataclass(frozen=True)
class Step:
    """A step of long-running work."""

    task: str
    expected: float | None = None  # duration in seconds; None if unknown
    done: float | None = None  # completed share, 0 to 1; None if it is not counted
    began: float = field(default_factory=time.monotonic)  # start, by `time.monotonic`

    def share(self, now: float | None = None) -> float | None:
        """Return the completed share, 0 to 1, at time ``now``; None if it is unknown.

        The share never decreases.
        """
        if self.done is not None or self.expected is None:
            return self.done
        return min(self._elapsed(now) / self.expected, _SHARE_MAX)

    def seconds_remaining(self, now: float | None = None) -> float | None:
        """Return the remaining seconds, at least 0; None if unknown or already exceeded."""
        elapsed = self._elapsed(now)
        if self.done is not None:
            return elapsed * (1 / self.done - 1) if self.done > 0 else None
        if self.expected is None or elapsed > self.expected:
            return None
        return self.expected - elapsed

    def started_now(self) -> Step:
        """Return a copy that starts now, because clocks of processes may differ."""
        return replace(self, began=time.monotonic())

    def text(self, now: float | None = None) -> str:
        """Return the step as text; from two seconds on, with its remaining or elapsed time."""
        remaining, elapsed = self.seconds_remaining(now), self._elapsed(now)
        if remaining is not None and remaining + elapsed >= _SECONDS_SHOWN_MIN:
            return f"{self.task}, about {rounded_time(remaining)} left"
        return (
            f"{self.task}, {rounded_time(elapsed)} so far"
            if elapsed >= _SECONDS_SHOWN_MIN
            else self.task
        )

    def _elapsed(self, now: float | None) -> float:
        return max((time.monotonic() if now is None else now) - self.began, 0.0)


def rounded_time(seconds: float) -> str:
    """Return a rounded time with its unit: ``8 s``, ``20 s``, ``3 min``."""
    if seconds >= 55:
        return f"{max(round(seconds / 60), 1)} min"
    return f"{max(round(seconds), 1) if seconds < 10 else 5 * round(seconds / 5)} s"


def progress_text(what: str, step: Step | None) -> str:
    return f"{what}: {step.text()}" if step else what


StepListener = Callable[[Step | None], None]
_step_listener: ContextVar[StepListener | None] = ContextVar("step listener", default=None)
_outer: ContextVar[Step | None] = ContextVar("enclosing step", default=None)
# Seconds per unit of work of steps by their names, on a machine with two cores, before this process
# measures them.
INITIAL_RATES: dict[str, float] = {
    "making coarser meshes": 1.2e-5,  # seconds per vertex
    "factoring": 1.4e-8,  # seconds per unknowns^(3/2)
    "factoring for distances": 2.6e-7,  # seconds per vertices^(3/2)
    "checking by flow lines": 1.6e-5,  # seconds per vertex
    "searching for symmetries": 4.5e-5,  # seconds per vertex
    "reading": 1e-7,  # seconds per byte
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
    """Report a step of another thread or process, or None at its end."""
    if listener := _step_listener.get():
        listener(now)


@contextmanager
def step(
    task: str, work: float | None = None, about: str = "", since: float | None = None
) -> Iterator[Callable[[float], None]]:
    """Report a step while the context lasts; yield a function to report its completed share.

    ``work`` is the amount of work, in a unit that depends on the task; it predicts the duration.
    ``about`` is added to the name in reports, for example the size. ``since`` is the start by
    `time.monotonic`, by default now.
    """
    known = _rates.get(task)
    expected = known[0] * work if known and work else None
    outer = _outer.get()
    now = Step(f"{task}{about}", expected, None, time.monotonic() if since is None else since)

    def done(share: float) -> None:
        nonlocal now
        if math.isfinite(share):
            now = replace(now, done=min(max(share, now.done or 0.0), 1.0))
            report_step(now)

    inner = _outer.set(now)
    report_step(now)
    try:
        yield done
        if work:
            _store_rate(task, (time.monotonic() - now.began) / work, work)
    finally:
        with suppress(ValueError):  # an unfinished generator may be deleted in another context
            _outer.reset(inner)
            report_step(outer)


@contextmanager
def stepped(task: str, items: Collection[Item]) -> Iterator[Iterator[Item]]:
    """Report work through items as one step, which ends with the context.

    The context yields an iterator over the items. It calls `checkpoint` before each item, and
    reports the completed share after each.
    """
    with step(task) as done:
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
