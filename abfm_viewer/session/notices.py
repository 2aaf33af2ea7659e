"""What the status line says besides the solver's state."""

import time
from dataclasses import dataclass

_SECONDS_OF_NOTICE, _SECONDS_OF_ERROR = 6.0, 12.0


@dataclass(frozen=True)
class Notice:
    """A line for the status bar."""

    text: str
    is_error: bool = False


class Notices:
    """At most one notice, the `latest`, for as long as it takes to read it; an empty one where there is none."""

    def __init__(self) -> None:
        self.latest = Notice("")
        self._said_at = 0.0
        self._moves = 0

    def say(self, text: str, is_error: bool, moves: int) -> None:
        """Replace the notice; `moves` counts what the user did so far."""
        self.latest = Notice(" ".join(text.split()), is_error)
        self._said_at, self._moves = time.perf_counter(), moves

    def clear(self) -> None:
        self.latest = Notice("")

    def forget(self, moves: int) -> None:
        """Take it away when it was there for long enough; an error also when the user did something since."""
        age = time.perf_counter() - self._said_at
        answered = self.latest.is_error and self._moves != moves
        if answered or age > (_SECONDS_OF_ERROR if self.latest.is_error else _SECONDS_OF_NOTICE):
            self.clear()
