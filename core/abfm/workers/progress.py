"""How far long work is, told while it goes on: what is being done, and for how long it is expected
to go on.

Work says ``with step("factoring", work=n**1.5)``; whoever waits for it says ``with telling(show)``.
How long a step takes is extrapolated from steps of the same name that this process has made before,
smaller ones mostly: a match factors its coarse meshes first. Nothing that is computed depends on
any of this.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import TypeVar

from abfm.workers.control import checkpoint

Item = TypeVar("Item")

# smaller works than this share of the largest one measured tell nothing about large ones
_WORK_SHARE_MIN = 0.25
_SECONDS_MIN = 1e-3  # seconds; shorter ones measure the clock
_SECONDS_SHOWN_MIN = 2.0  # seconds; how long less takes nobody asks
_SHARE_MAX = 0.99  # share of a step that takes longer than expected


@dataclass(frozen=True)
class Step:
    """Work that began by `time.monotonic`: its seconds, and the share done; None is unknown."""

    task: str
    expected: float | None = None
    done: float | None = None
    began: float = field(default_factory=time.monotonic)

    def share(self, now: float | None = None) -> float | None:
        """Share that is done at a time, 0 to 1, which never falls; None if unknown."""
        if self.done is not None or self.expected is None:
            return self.done
        return min(self._elapsed(now) / self.expected, _SHARE_MAX)

    def seconds_remaining(self, now: float | None = None) -> float | None:
        """Seconds left, at least 0; None if unknown, as when it takes longer than expected."""
        elapsed = self._elapsed(now)
        if self.done is not None:
            return elapsed * (1 / self.done - 1) if self.done > 0 else None
        if self.expected is None or elapsed > self.expected:
            return None
        return self.expected - elapsed

    def started_now(self) -> Step:
        """The same as it is told by another process, whose clock may be another one."""
        return replace(self, began=time.monotonic())

    def text(self, now: float | None = None) -> str:
        """Return what is being done, and how long it goes on if known and a while."""
        left, elapsed = self.seconds_remaining(now), self._elapsed(now)
        if left is not None and left + elapsed >= _SECONDS_SHOWN_MIN:
            return f"{self.task}, about {rounded_time(left)} left"
        return (
            f"{self.task}, {rounded_time(elapsed)} so far"
            if elapsed >= _SECONDS_SHOWN_MIN
            else self.task
        )

    def _elapsed(self, now: float | None) -> float:
        return max((time.monotonic() if now is None else now) - self.began, 0.0)


def rounded_time(seconds: float) -> str:
    """A time as one says it: ``8 s``, ``20 s``, ``3 min``."""
    if seconds >= 55:
        return f"{max(round(seconds / 60), 1)} min"
    return f"{max(round(seconds), 1) if seconds < 10 else 5 * round(seconds / 5)} s"


def progress_text(what: str, step: Step | None) -> str:
    """Return what goes on, with the step that it is at if that is known."""
    return f"{what}: {step.text()}" if step else what


StepListener = Callable[[Step | None], None]
_step_listener: ContextVar[StepListener | None] = ContextVar("who is told", default=None)
_outer: ContextVar[Step | None] = ContextVar("the step around the present one", default=None)
# seconds for a unit of work, and of how much it was measured here
_rates: dict[str, tuple[float, float]] = {
    # for a vertex, on a machine with two cores, as all of these
    "making coarser meshes": (1.2e-5, 0),
    "factoring": (1.4e-8, 0),  # for an unknown to 3/2
    "factoring for distances": (2.6e-7, 0),  # for a vertex to 3/2
    "checking by flow lines": (1.6e-5, 0),  # for a vertex
    "looking for symmetries": (4.5e-5, 0),  # for a vertex
    "reading": (1e-7, 0),  # for a byte
}
_lock = threading.Lock()


@contextmanager
def reporting_steps(report_step: StepListener) -> Iterator[None]:
    """Tell of every step that this thread begins meanwhile, and None when there is none."""
    before = _step_listener.set(report_step)
    try:
        yield
    finally:
        _step_listener.reset(before)


def report_step(now: Step | None) -> None:
    """Tell of a step that goes on elsewhere, and None at its end."""
    if listener := _step_listener.get():
        listener(now)


@contextmanager
def step(
    task: str, work: float | None = None, about: str = "", since: float | None = None
) -> Iterator[Callable[[float], None]]:
    """Tell of a step while it goes on; what it gives is called with the share that is done, where
    that is counted.

    To the task, `about`, such as its size, is added when it is told; `work` is how much that is, in
    a unit of the task's own, and `since` when it began, by `time.monotonic`, if not now.
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
        _outer.reset(inner)
        report_step(outer)


@contextmanager
def stepped(task: str, items: Collection[Item]) -> Iterator[Iterator[Item]]:
    """Give an iterator over items, which are the work of a step: before each there is a checkpoint,
    after each the share that is done is reported. The step ends with the context.
    """
    with step(task) as done:
        yield _counted(items, done)


def _counted(items: Collection[Item], done: Callable[[float], None]) -> Iterator[Item]:
    for count, item in enumerate(items, 1):
        checkpoint()
        yield item
        done(count / len(items))


def _store_rate(task: str, rate: float, work: float) -> None:
    """Keep the rate of large works, which small ones do not tell: a busy machine is slow."""
    if rate * work < _SECONDS_MIN:
        return
    with _lock:
        before, most = _rates.get(task, (rate, 0.0))
        if work >= most:
            _rates[task] = rate, work
        elif work >= _WORK_SHARE_MIN * most:
            _rates[task] = (before + rate) / 2, most
