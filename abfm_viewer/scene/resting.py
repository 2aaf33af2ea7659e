"""Smooth edges while nothing moves: one frame of several samples a pixel, and single ones once something does."""

import time
from collections.abc import Callable

from abfm_viewer.scene.opengl import ps
from abfm_viewer.session.session import Session

STILL = 0.2
"""Seconds without motion after which the surfaces are drawn once more."""
_MOST_PIXELS = {3: 2.5e6, 2: 1e7}  # of the window, by the samples along a side of each
_LONGEST_DRAWING = {3: 0.1, 2: 0.8}  # seconds


class Resting:
    """Decides in every frame of a session's window with how many `samples` along a side of a pixel it is drawn.

    Only in a window on a screen (`is_real`); `now` reads a clock in seconds.
    """

    def __init__(self, session: Session, is_real: bool, now: Callable[[], float] = time.perf_counter) -> None:
        self.samples = 1
        self._session, self._is_real, self._now = session, is_real, now
        self._moved_at = now()

    def update(self, moves: bool, seconds: float) -> None:
        """Take in whether the frame that polyscope is about to draw differs from the last: call before it draws.

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
    """How many samples along a side of a pixel fit into memory, and are drawn within a moment."""
    for side, most in _MOST_PIXELS.items():
        if pixels <= most and seconds * side**2 <= _LONGEST_DRAWING[side]:
            return side
    return 1
