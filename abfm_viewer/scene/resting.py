"""Smooth edges while nothing moves: one frame with several samples a pixel, and single ones as soon as something does."""

import time
from collections.abc import Callable

from abfm_viewer.scene.opengl import ps

STILL = 0.2
"""Seconds without motion after which the surfaces are drawn once more."""
_MOST_PIXELS = {3: 2.5e6, 2: 1e7}  # of the window, by the samples along a side of each
_LONGEST_DRAWING = {3: 0.1, 2: 0.5}  # seconds


class Resting:
    """Decides in every frame with how many samples polyscope draws it.

    Parameters
    ----------
    set_samples, now : callable
        How to set the number of samples along a side of a pixel, and to read a clock in seconds.
    """

    def __init__(
        self,
        set_samples: Callable[[int], None] = ps.set_SSAA_factor,
        now: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.samples = 1
        self._set_samples, self._now = set_samples, now
        self._moved_at = now()

    def update(self, moves: bool, may_rest: bool, pixels: float, seconds: float) -> None:
        """Take in whether the frame that polyscope is about to draw differs from the last: call before it draws.

        Off the screen, during a run and where drawing takes long (`seconds` with a single sample) nothing `may_rest`.
        """
        now = self._now()
        if moves or not may_rest:
            self._moved_at = now
            self._use(1)
        elif self.samples == 1 and now >= self._moved_at + STILL:
            self._use(_affordable(pixels, seconds))

    def _use(self, samples: int) -> None:
        if samples != self.samples:
            self._set_samples(samples)
            self.samples = samples


def _affordable(pixels: float, seconds: float) -> int:
    """How many samples along a side of a pixel fit into memory, and are drawn within a moment."""
    for side, most in _MOST_PIXELS.items():
        if pixels <= most and seconds * side**2 <= _LONGEST_DRAWING[side]:
            return side
    return 1
