"""What is being opened: read in the background, one thing at a time, the newest."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from abfm import AbfmError
from abfm.workers.progress import Step
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.session.notices import Notices, WaysOut

OPENING = "opening"
"""What cards about it are about."""


@dataclass(frozen=True, eq=False)
class Load:
    """Something to be read in a thread; what `read` returns shows it.

    `what` is such as "opening camel.off". What `replaces` the document keeps matches from starting;
    `remedies` are offered if it fails. Two of the same `source`, unless that is None, are the same.
    """

    what: str
    read: Callable[[], Callable[[], None]]
    replaces: bool = True
    remedies: WaysOut = field(default_factory=dict)
    source: object = None
    started: float = field(default_factory=time.perf_counter, init=False)

    @property
    def elapsed(self) -> float:
        """Seconds since it began."""
        return time.perf_counter() - self.started


Reader = Latest[Callable[[], None]]


class Loading:
    """Reads what it was asked to last, which is `now`; errors become cards.

    Each has a reader of its own. One that was given up goes on in a thread that nothing waits for,
    and nobody sees what it finds, but for who asks for the same again meanwhile: no file is read
    twice at a time.
    """

    def __init__(self, jobs: Jobs, notices: Notices) -> None:
        self._jobs = jobs
        self._notices = notices
        self._reader: Reader | None = None
        self._given_up: list[tuple[Load, Reader]] = []
        self.now: Load | None = None

    @property
    def replacing(self) -> str:
        """Say what is about to take the document's place, so that a match would be lost."""
        return self.now.what if self.now and self.now.replaces else ""

    @property
    def step(self) -> Step | None:
        """Return what is being done for it, if it tells."""
        return self._reader.step if self._reader else None

    def begin(self, load: Load) -> None:
        """Read something instead of what is being read."""
        self._notices.say(f"{load.what} ...")
        self._give_up()
        for begun, reader in self._given_up:
            if reader.is_at_work and begun.source is not None and begun.source == load.source:
                self._reader = reader
                break
        else:
            self._reader = self._jobs.latest()
            self._reader.ask(load.source or load, load.read)
        self._given_up = [one for one in self._given_up if one[1] is not self._reader]
        self.now = load

    def cancel(self) -> None:
        """Go on without what is being read."""
        if self.now is not None:
            self._notices.say(f"{self.now.what} was cancelled")
            self._give_up()

    def update(self) -> None:
        """Show what was read: call once per frame."""
        self._given_up = [one for one in self._given_up if one[1].is_at_work]
        load, reader = self.now, self._reader
        if load is None or reader is None or reader.busy:
            return
        self.now = self._reader = None
        reader.retire()
        problem = reader.error
        if reader.value is not None:
            self._notices.clear()
            self._notices.mend(OPENING)
            try:
                reader.value()
            except AbfmError as error:
                problem = str(error)
        if problem:
            self._notices.say(problem, True, OPENING, load.remedies)

    def _give_up(self) -> None:
        if self.now is not None and self._reader is not None:
            self._reader.retire()
            self._given_up.append((self.now, self._reader))
        self.now = self._reader = None
