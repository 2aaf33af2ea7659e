"""Opening of files in the background, where a newer request replaces an older one."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from abfm import AbfmError
from abfm.workers.progress import Step
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.session.notices import Notices, Remedies

OPENING = "opening"  # topic of cards about opening


@dataclass(frozen=True, eq=False)
class Load:
    """Request to read a file, or to compute a document, in the background."""

    what: str  # such as "opening camel.off"
    read: Callable[[], Callable[[], None]]  # called in a thread; its result shows the file
    other: str = ""  # label of the action that opens another file, offered if reading fails
    source: object = None  # equal sources are the same request; None for a unique request
    takes_long: bool = False  # whether another request replaces this one only after a question
    remedies: Remedies = field(default_factory=dict)  # actions offered if reading fails
    started: float = field(default_factory=time.perf_counter, init=False)

    @property
    def key(self) -> object:
        return self.source or self

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self.started


class Loading:
    """Executes the newest `Load` in a thread, and shows an error card if this fails.

    `now` is the request in progress. The reader of a cancelled request finishes in the thread, and
    its result is dropped, unless the same file is requested again meanwhile.
    """

    def __init__(self, jobs: Jobs, notices: Notices) -> None:
        self.now: Load | None = None
        self._jobs = jobs
        self._notices = notices
        self._readers: dict[object, Latest[Callable[[], None]]] = {}  # by the key of the load

    @property
    def _reader(self) -> Latest[Callable[[], None]] | None:
        return self._readers[self.now.key] if self.now else None

    @property
    def replacing(self) -> str:
        """Description of the request that will replace the document; empty without a request."""
        return self.now.what if self.now else ""

    @property
    def step(self) -> Step | None:
        return self._reader.overall.step if self._reader else None

    def begin(self, load: Load) -> None:
        cancelled = self.replacing if self.now is not load else ""
        instead = f", instead of {cancelled}" if cancelled else ""
        self._notices.show(f"{load.what}{instead} ...")
        self._drop()
        reader = self._readers.get(load.key)
        if reader is None or not reader.is_running:
            reader = self._readers[load.key] = self._jobs.latest()
            reader.request(load.key, load.read)
        self.now = load

    def cancel(self) -> None:
        if self.now is not None:
            self._notices.show(f"{self.now.what} was cancelled")
            self._drop()

    def update(self) -> None:
        load, reader = self.now, self._reader
        self._readers = {
            key: each for key, each in self._readers.items() if each is reader or each.is_running
        }
        if load is None or reader is None or reader.busy:
            return
        self._drop()
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

    def _drop(self) -> None:
        if self._reader is not None:
            self._reader.retire()
        self.now = None
