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
    how long it takes, 0 if that is not known; `remedies` are offered if it fails. Two of the same `source`, unless that
    is None, are the same.
    """

    what: str
    read: Read
    replaces: bool = True
    seconds: float = 0.0
    remedies: WaysOut = field(default_factory=dict)
    source: object = None
    started: float = field(default_factory=time.perf_counter, init=False)

    @property
    def elapsed(self) -> float:
        """Seconds since it began."""
        return time.perf_counter() - self.started


Reader = Latest[Callable[[], None]]


class Loading:
    """Reads what it was asked to last; `now` is that, until it is `taken`.

    Each has a reader of its own. One that was given up goes on in a thread that nothing waits for, and nobody sees what
    it finds, but for who asks for the same again meanwhile: no file is read twice at a time.
    """

    def __init__(self, jobs: Jobs) -> None:
        self._jobs = jobs
        self._reader: Reader | None = None
        self._given_up: list[tuple[Load, Reader]] = []
        self.now: Load | None = None

    @property
    def step(self) -> Step | None:
        """What is being done for it, if it tells."""
        return self._reader.step if self._reader else None

    def begin(self, load: Load) -> None:
        """Read something instead of what is being read."""
        self.cancel()
        for begun, reader in self._given_up:
            if reader.is_at_work and begun.source is not None and begun.source == load.source:
                self._reader = reader
                break
        else:
            self._reader = self._jobs.latest("open")
            self._reader.ask(load.source or load, load.read)
        self._given_up = [(begun, reader) for begun, reader in self._given_up if reader is not self._reader]
        self.now = load

    def cancel(self) -> None:
        """Give up what is being read."""
        if self.now is not None and self._reader is not None:
            self._reader.retire()
            self._given_up.append((self.now, self._reader))
        self.now = self._reader = None

    def taken(self) -> tuple[Load, Callable[[], None] | None, str] | None:
        """What was read, with what shows it or why that failed; None unless something was since the last call."""
        self._given_up = [(begun, reader) for begun, reader in self._given_up if reader.is_at_work]
        load, reader = self.now, self._reader
        if load is None or reader is None or reader.busy:
            return None
        self.now = self._reader = None
        reader.retire()
        return load, reader.value, reader.error
