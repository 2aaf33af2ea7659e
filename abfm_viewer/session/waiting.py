"""What begins when a run has ended."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True, eq=False)
class Waiting:
    """Something that is to be done when a run has ended; `what` is such as "opening camel.off"."""

    what: str
    do: Callable[[], None]
    started: float = field(default_factory=time.perf_counter, init=False)

    @property
    def elapsed(self) -> float:
        """Seconds since it waits."""
        return time.perf_counter() - self.started
