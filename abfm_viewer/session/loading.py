"""What is being opened: read in the background, one thing at a time, the newest."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from abfm import AbfmError
from abfm.workers.progress import Step
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.session.notices import Notices, Remedies

OPENING = "opening"
"""What cards about it are about."""


@dataclass(frozen=True, eq=False)
class Load:
    """Something to be read in a thread; what `read` returns shows it.

    `what` is such as "opening camel.off". If it fails, `remedies` are offered, and what is called
    `other` in the window. Two of the same `source`, unless that is None, are the same.
    """

    what: str
    read: Callable[[], Callable[[], None]]
    other: str = ""
    source: object = None
    takes_long: bool = False  # so that nothing takes its place unasked
    remedies: Remedies = field(default_factory=dict)
    started: float = field(default_factory=time.perf_counter, init=False)

    @property
    def key(self) -> object:
        return self.source or self

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self.started


class Loading:
    """Reads what it was asked to last, which is `now`; errors become cards.

    Each has a reader of its own. One that was given up goes on in a thread that nothing waits for,
    and nobody sees what it finds, but for who asks for the same again meanwhile: no file is read
    twice at a time.
    """

    def __init__(self, jobs: Jobs, notices: Notices) -> None:
        self.now: Load | None = None
        self._jobs = jobs
        self._notices = notices
        self._readers: dict[object, Latest[Callable[[], None]]] = {}  # by what they read

    @property
    def _reader(self) -> Latest[Callable[[], None]] | None:
        return self._readers[self.now.key] if self.now else None

    @property
    def replacing(self) -> str:
        """Say what is about to take the document's place, so that a match would be lost."""
        return self.now.what if self.now else ""

    @property
    def step(self) -> Step | None:
        return self._reader.step if self._reader else None

    def begin(self, load: Load) -> None:
        given_up = self.replacing if self.now is not load else ""
        instead = f", instead of {given_up}" if given_up else ""
        self._notices.show(f"{load.what}{instead} ...")
        self._give_up()
        reader = self._readers.get(load.key)
        if reader is None or not reader.is_running:
            reader = self._readers[load.key] = self._jobs.latest()
            reader.ask(load.key, load.read)
        self.now = load

    def cancel(self) -> None:
        if self.now is not None:
            self._notices.show(f"{self.now.what} was cancelled")
            self._give_up()

    def update(self) -> None:
        """Show what was read: call once per frame."""
        load, reader = self.now, self._reader
        self._readers = {
            key: each for key, each in self._readers.items() if each is reader or each.is_running
        }
        if load is None or reader is None or reader.busy:
            return
        self._give_up()
        problem = reader.error
        if reader.value is not None:
            self._notices.clear()
            self._notices.resolve(OPENING)
            try:
                reader.value()
            except AbfmError as error:
                problem = str(error)
        if problem:
            self._notices.show(problem, True, OPENING, load.remedies)

    def _give_up(self) -> None:
        if self._reader is not None:
            self._reader.retire()
        self.now = None
