"""What a process has after a while and at its end: threads, children, memory."""

from __future__ import annotations

import os
import resource
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

# seconds, and what there may be at the end over what there was after them
_EARLY, _MOST_GROWTH = 300.0, 1.1


def children() -> set[str]:
    """Numbers of the processes that this one has started and that have not ended."""
    found: set[str] = set()
    for thread in Path(f"/proc/{os.getpid()}/task").iterdir():
        with suppress(OSError):  # it may have ended
            found.update((thread / "children").read_text().split())
    return found


def counts() -> dict[str, float]:
    """What the process has at present: threads, children, and megabytes that are resident."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    megabytes = round(pages * resource.getpagesize() / 2**20, 1)
    return {
        "threads": threading.active_count(),
        "children": len(children()),
        "megabytes": megabytes,
    }


@dataclass
class Endurance:
    """What the window keeps after its first five minutes, and what at the end.

    What is only in use at the moment differs from sequence to sequence. What stays of memory is in
    the least that some sequences leave; what stays of threads and processes is there after a rest,
    in which those end that wait for work.
    """

    begun: float
    rest: Callable[[], object]
    megabytes: deque[float] = field(default_factory=lambda: deque(maxlen=50))
    early: dict[str, float] | None = None

    def add(self) -> None:
        """Look at what there is after one more sequence."""
        self.megabytes.append(counts()["megabytes"])
        if self.early is None and time.monotonic() - self.begun > _EARLY:
            self.early = self._kept()

    def _kept(self) -> dict[str, float]:
        self.rest()
        return counts() | {"megabytes": min(self.megabytes)}

    def end(self) -> bool:
        """Tell of both, and whether what there is at the end is not more by over a tenth."""
        if self.early is None:
            return True
        late = self._kept()
        print(f"# after {_EARLY / 60:g} minutes: {self.early}; at the end: {late}", file=sys.stderr)
        return all(late[name] <= _MOST_GROWTH * self.early[name] for name in late)
