"""What is being opened: read in the background, one thing at a time, the newest."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from abfm.progress import Step
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.session.notices import WaysOut

Read = Callable[[], Callable[[], None]]
"""Reads something, in a thread; what it returns shows it."""


@dataclass(frozen=True, eq=False)
class Load:
    """Something that is being read.

    `what` is such as "opening camel.off". What `replaces` the document keeps matches from starting. `seconds` is about
    how long it takes, 0 if that is not known; `remedies` are offered if it fails.
    """

    what: str
    read: Read
    replaces: bool = True
    seconds: float = 0.0
    remedies: WaysOut = field(default_factory=dict)
    started: float = field(default_factory=time.perf_counter, init=False)

    @property
    def elapsed(self) -> float:
        """Seconds since it began."""
        return time.perf_counter() - self.started


class Loading:
    """Reads what it was asked to last; `now` is that, until it is `taken`."""

    def __init__(self, jobs: Jobs) -> None:
        self._jobs = jobs
        self._latest: Latest[Callable[[], None]] = jobs.latest("open")
        self.now: Load | None = None

    @property
    def step(self) -> Step | None:
        """What is being done for it, if it tells."""
        return self._latest.step if self.now else None

    def begin(self, load: Load) -> None:
        """Read something instead of what is being read."""
        self.now = load
        self._latest.ask(load, load.read)

    def cancel(self) -> None:
        """Forget what is being read; it may go on for a while in a thread that nothing waits for."""
        if self.now is not None:
            self.now = None
            self._latest.retire()
            self._latest = self._jobs.latest("open")

    def taken(self) -> tuple[Load, Callable[[], None] | None, str] | None:
        """What was read, with what shows it or why that failed; None unless something was since the last call."""
        load = self.now
        if load is None or self._latest.key is not load:
            return None
        self.now = None
        return load, self._latest.value, self._latest.error
