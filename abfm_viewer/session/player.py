"""Playing the time bar: how the shown time moves from frame to frame."""

from typing import Literal, get_args

Repeat = Literal["once", "loop", "ping-pong"]
REPEATS: tuple[Repeat, ...] = get_args(Repeat)
SECONDS = 4.0
"""How long the flow from 0 to tau takes at speed 1."""
SECONDS_PER_CYCLE = 1.0
"""How long moving streaks take until they look the same again."""
_LONGEST_FRAME = 0.1  # seconds: after a hang the time does not leap


class Player:
    """Moves a time between 0 and tau or, if it plays `beyond`, the end of the time bar.

    A `speed` of 1 goes from 0 to tau in `SECONDS`; `phase` is that of moving streaks, 0 to 1. While
    it is `held`, the time stands, as what is to be shown is still being computed.
    """

    def __init__(self) -> None:
        self.playing = self.waiting = self.beyond = False
        self.repeat: Repeat = "loop"
        self.speed = 1.0
        self.phase = 0.0
        self._direction = 1.0
        self._starting = self._to_tau = False

    def toggle(self) -> None:
        self.playing = self._starting = not self.playing
        self._direction, self._to_tau = 1.0, False

    def play_once(self) -> None:
        """Play from the time that is shown to tau, and stop there, whatever `repeat` says."""
        self.playing, self._starting, self._to_tau = True, False, True

    def move_streaks(self, seconds: float) -> None:
        self.phase = (self.phase + min(seconds, _LONGEST_FRAME) / SECONDS_PER_CYCLE) % 1

    def advance(
        self, time: float, seconds: float, tau: float, end: float, each: float = SECONDS
    ) -> float:
        """The time to show some seconds after another one was shown, where tau takes so many."""
        if self.waiting:
            return time
        end = end if self.beyond and not self._to_tau else tau
        starting, self._starting = self._starting, False
        if starting and time >= end:
            return 0.0
        repeat = "once" if self._to_tau else self.repeat
        if repeat != "ping-pong":
            self._direction = 1.0
        moved = time + self._direction * self.speed * tau * min(seconds, _LONGEST_FRAME) / each
        if 0 <= moved <= end:
            return moved
        if repeat == "loop":
            return 0.0
        if repeat == "ping-pong":
            self._direction = -1.0 if moved > end else 1.0
        else:
            self.playing = False
        return end if moved > end else 0.0
