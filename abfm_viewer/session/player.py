"""Playback, which moves the shown time each time that the window is drawn."""

from typing import Literal, get_args

Repeat = Literal["once", "loop", "ping-pong"]
REPEATS: tuple[Repeat, ...] = get_args(Repeat)
SECONDS = 4.0  # seconds from time 0 to tau at speed 1
SECONDS_PER_CYCLE = 1.0  # period of moving streaks in seconds
_FRAME_SECONDS_MAX = 0.1  # so that the time does not jump after a long frame


class Player:
    """Moves the shown time while playing, and the phase of moving streaks."""

    def __init__(self) -> None:
        self.playing = False
        self.waiting = False  # whether the next picture is being computed; the time stands still
        self.beyond = False  # whether to play to the end of the time bar instead of tau
        self.repeat: Repeat = "loop"
        self.speed = 1.0  # at speed 1, time 0 to tau takes `SECONDS`
        self.phase = 0.0  # phase of moving streaks, 0 to 1
        self._direction = 1.0
        self._starting = self._to_tau = False

    def toggle(self) -> None:
        self.playing = self._starting = not self.playing
        self._direction, self._to_tau = 1.0, False

    def play_once(self) -> None:
        """Start to play from the shown time, and stop at tau regardless of the setting `repeat`."""
        self.playing, self._starting, self._to_tau = True, False, True

    def move_streaks(self, seconds: float) -> None:
        self.phase = (self.phase + min(seconds, _FRAME_SECONDS_MAX) / SECONDS_PER_CYCLE) % 1

    def advance(
        self, time: float, seconds: float, tau: float, end: float, tau_seconds: float = SECONDS
    ) -> float:
        """Return the time to show ``seconds`` after ``time`` was shown.

        The player plays to tau, which takes ``tau_seconds`` at speed 1, or to ``end`` if `beyond`.
        """
        if self.waiting:
            return time
        end = end if self.beyond and not self._to_tau else tau
        starting, self._starting = self._starting, False
        if starting and time >= end:
            return 0.0
        repeat = "once" if self._to_tau else self.repeat
        if repeat != "ping-pong":
            self._direction = 1.0
        elapsed = min(seconds, _FRAME_SECONDS_MAX)
        moved = time + self._direction * self.speed * tau * elapsed / tau_seconds
        if 0 <= moved <= end:
            return moved
        if repeat == "loop":
            return 0.0
        if repeat == "ping-pong":
            self._direction = -1.0 if moved > end else 1.0
        else:
            self.playing = False
        return end if moved > end else 0.0
