"""Which frames draw the surfaces anew, and how smoothly.

Where drawing takes longer than a frame, as without a graphics card, surfaces that follow a solve or
show moving streaks wait, so that the window answers in the other frames. While nothing moves, one
frame has several samples a pixel for smooth edges, and single ones once something does.
"""

import time as clock
from collections.abc import Callable

from abfm_viewer.scene.opengl import ps
from abfm_viewer.session.session import Session

_SLOW_REDRAW, _FRAMES_PER_SLOW_REDRAW = 0.025, 30
_FRAMES_PER_SECOND_OF_REDRAW = 120  # at 30 a second: a fifth of the time for drawing
_AT_ONCE = 3  # pictures of a run that do not wait: the start, and that something moves
_SLOW_REDRAWS_APART = 2.0  # new textures, of moving streaks


class Pacing:
    """Counts frames, and the pictures of a run."""

    def __init__(self, session: Session) -> None:
        self.redraw_seconds = 0.0  # how long it took to draw the surfaces lately
        self._session = session
        self._frames_behind = 0
        self._run = 0
        self._pictures_of_run = 0
        self._textured_at = 0.0

    @property
    def draws_quickly(self) -> bool:
        """Return whether the surfaces are drawn anew within a frame."""
        return self.redraw_seconds <= _SLOW_REDRAW

    @property
    def begins(self) -> bool:
        """Return whether a run shows its first pictures, slowly: what shows its flow waits."""
        solver = self._session.solver
        is_early = solver.started != self._run or self._pictures_of_run <= _AT_ONCE
        return solver.running and is_early and not self.draws_quickly

    def waits(self, name: str, is_first: bool) -> bool:
        """Return whether a surface keeps its colours for this frame; ask once a frame, in order."""
        session = self._session
        if self.draws_quickly:
            return False
        if session.view.animate and name == "advected":
            return (
                clock.perf_counter() < self._textured_at + _SLOW_REDRAWS_APART * self.redraw_seconds
            )
        solver = session.solver
        if not solver.running or solver.started != self._run or self._pictures_of_run < _AT_ONCE:
            return False
        if is_first:
            frames = max(
                _FRAMES_PER_SLOW_REDRAW, round(_FRAMES_PER_SECOND_OF_REDRAW * self.redraw_seconds)
            )
            self._frames_behind = (self._frames_behind + 1) % frames
        return self._frames_behind != 0 and not session.dragging

    def count(self, is_new: bool, is_texture: bool) -> None:
        """Take in that the advected surface was drawn, with other colours than before or not."""
        if is_new and is_texture:
            self._textured_at = clock.perf_counter()
        started = self._session.solver.started
        if started != self._run:
            self._run, self._pictures_of_run = started, 0
        self._pictures_of_run += is_new


STILL = 0.2
"""Seconds without motion after which the surfaces are drawn once more."""
_MOST_PIXELS = {3: 2.5e6, 2: 1e7}  # of the window, by the samples along a side of each
_LONGEST_DRAWING = {3: 0.1, 2: 0.8}  # seconds


class Resting:
    """Decides in every frame of a session's window with how many `samples` along a side of a pixel
    it is drawn.

    Only in a window on a screen (`is_real`); `now` reads a clock in seconds.
    """

    def __init__(
        self, session: Session, is_real: bool, now: Callable[[], float] = clock.perf_counter
    ) -> None:
        self.samples = 1
        self._session, self._is_real, self._now = session, is_real, now
        self._moved_at = now()

    def update(self, moves: bool, seconds: float) -> None:
        """Take in whether the frame that polyscope is about to draw differs from the last: call
        before it draws.

        `seconds` is how long it takes to draw one with a single sample.
        """
        if not self._is_real:
            return
        now = self._now()
        if moves or self._session.solver.running or self._session.player.playing:
            self._moved_at = now
            self._use(1)
        elif self.samples == 1 and now >= self._moved_at + STILL:
            width, height = ps.get_window_size()
            self._use(_affordable(width * height, seconds))

    def _use(self, samples: int) -> None:
        if samples != self.samples:
            ps.set_SSAA_factor(samples)  # polyscope takes it in when it draws
            self.samples = samples


def _affordable(pixels: float, seconds: float) -> int:
    """Return how many samples along a side of a pixel are drawn within a moment."""
    for side, most in _MOST_PIXELS.items():
        if pixels <= most and seconds * side**2 <= _LONGEST_DRAWING[side]:
            return side
    return 1
