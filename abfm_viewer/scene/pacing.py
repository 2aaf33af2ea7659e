"""Choice of the frames of the window that redraw the surfaces, and of the samples per pixel."""

import time as clock
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf

from abfm_viewer.scene.opengl import ps
from abfm_viewer.session.session import Session

_SLOW_REDRAW = 0.025
_FRAMES_PER_SLOW_REDRAW = 30
_FRAMES_PER_SECOND_OF_REDRAW = 120  # at 30 frames per second, drawing takes a fifth of the time
_FIRST_COUNT = 3  # number of a run's first pictures, which are drawn at once
_TEXTURE_WAIT_RATIO = 2.0  # wait between textures of moving streaks, in redraw times
STILL_SECONDS = 0.2  # seconds without motion after which the surfaces are drawn with more samples
_STILL_SECONDS_MAX = 2.0  # the same on slow machines
_UNNOTICED_SECONDS = 0.05  # of a frame that delays neither input nor a run
_MOVING_SECONDS_MAX = 1 / 60  # of a redraw with two samples along a side, while surfaces change
_RATIO_DECAY = 0.995  # per redraw
# at rest: samples along a side of a pixel; maximum pixels of the window, because of the memory;
# maximum seconds to draw it
_STILL_LIMITS = ((3, 2.5e6, 3.0), (2, 1e7, inf), (1, inf, inf))
SCREENSHOT_SAMPLES_MAX = 3


class Pacing:
    """Choice of the surfaces that a frame of the window redraws if redrawing them is slow.

    Only some frames redraw pictures of a run or moving streaks, so that the window responds.
    """

    def __init__(self, session: Session) -> None:
        self.redraw_seconds = 0.0  # duration of a recent redraw of the surfaces
        self._session = session
        self._frames_behind = 0
        self._run = 0
        self._pictures_of_run = 0
        self._textured_at = 0.0

    @property
    def draws_quickly(self) -> bool:
        return self.redraw_seconds <= _SLOW_REDRAW

    @property
    def is_beginning(self) -> bool:
        """Whether redrawing is slow and a run shows its first pictures, without arrows or lines."""
        session = self._session
        is_early = session.solver.started != self._run or self._pictures_of_run <= _FIRST_COUNT
        return session.matching.running and is_early and not self.draws_quickly

    def waits(self, name: str, is_first: bool) -> bool:
        """Return whether a surface keeps its picture; call this once per surface and frame."""
        session, solver, seconds = self._session, self._session.solver, self.redraw_seconds
        if self.draws_quickly:
            return False
        if session.view.animate and name == "advected":
            return clock.perf_counter() < self._textured_at + _TEXTURE_WAIT_RATIO * seconds
        if (
            not session.matching.running
            or solver.started != self._run
            or self._pictures_of_run < _FIRST_COUNT
        ):
            return False
        if is_first:
            frames = max(_FRAMES_PER_SLOW_REDRAW, round(_FRAMES_PER_SECOND_OF_REDRAW * seconds))
            self._frames_behind = (self._frames_behind + 1) % frames
        return self._frames_behind != 0 and not session.dragging

    def count(self, is_new: bool, is_texture: bool) -> None:
        """Record that the surface with the advected source was drawn.

        ``is_new``: with new colours; ``is_texture``: with streaks along flow lines.
        """
        if is_new and is_texture:
            self._textured_at = clock.perf_counter()
        started = self._session.solver.started
        if started != self._run:
            self._run, self._pictures_of_run = started, 0
        self._pictures_of_run += is_new


class Supersampling:
    """Choice of `samples`, the number of antialiasing samples along each side of a pixel.

    At rest, the surfaces are drawn once with many samples, after a wait as long as this drawing may
    take. While they change, there are as many samples as the machine draws in time.
    """

    def __init__(self, is_real: bool) -> None:
        self.samples = 1
        self._is_real = is_real
        self._moved_at = clock.perf_counter()
        self._seconds = 0.0  # of a redraw with one sample per pixel; 0 if unknown
        self._ratio = 4.0  # of the time of a redraw with two samples along a side to `_seconds`
        self._moving = 1  # samples while the surfaces change

    def update(self, redraws: bool, is_busy: bool) -> None:
        """Choose the samples of this frame.

        ``redraws``: the surfaces have changed; ``is_busy``: a long frame would delay input or work.
        """
        if not self._is_real or not (redraws or self._seconds):
            return
        now, still = clock.perf_counter(), self._still
        expected = self._seconds * still**2
        if redraws or (is_busy and expected > _UNNOTICED_SECONDS):
            self._moved_at = now
        if redraws:
            self._draw_with(min(self._moving, still))
        elif now >= self._moved_at + min(max(expected, STILL_SECONDS), _STILL_SECONDS_MAX):
            self._draw_with(still)

    def record(self, seconds: float) -> None:
        """Record the time of a redraw of surfaces that had changed."""
        if self.samples == 1:
            # a ratio above 4, which may be outdated, is forgotten
            self._seconds, self._ratio = seconds, max(4.0, _RATIO_DECAY * self._ratio)
        elif self._seconds:
            self._ratio = seconds / self._seconds
        is_quick = 0 < self._seconds * self._ratio <= _MOVING_SECONDS_MAX
        self._moving = 2 if is_quick else 1

    @contextmanager
    def still_picture(self) -> Iterator[None]:
        """Draw with the samples of a window at rest in the block."""
        before = self.samples
        try:
            self._draw_with(min(self._still, SCREENSHOT_SAMPLES_MAX))
            yield
        finally:
            self._draw_with(before)

    @property
    def _still(self) -> int:
        """Samples at rest, whose memory and drawing time are acceptable."""
        width, height = ps.get_window_size()
        return next(
            side
            for side, pixels_max, seconds_max in _STILL_LIMITS
            if width * height <= pixels_max and self._seconds * side**2 <= seconds_max
        )

    def _draw_with(self, samples: int) -> None:
        if samples == self.samples:
            return
        ps.set_SSAA_factor(samples)  # used by polyscope in its next drawing
        self.samples = samples
        if not self._is_real:  # off-screen, polyscope applies it to new buffers only
            ps.screenshot_to_buffer()
            ps.set_window_size(*ps.get_window_size())
