"""Which frames draw the surfaces anew, and how smoothly.

Where drawing takes longer than a frame, what follows a run or moves waits, so that the window
answers in the others. While nothing moves, one frame has several samples a pixel.
"""

import time as clock

from abfm_viewer.scene.opengl import ps
from abfm_viewer.session.session import Session

_SLOW_REDRAW = 0.025
_FRAMES_PER_SLOW_REDRAW = 30
_FRAMES_PER_SECOND_OF_REDRAW = 120  # at 30 a second: a fifth of the time for drawing
_FIRST_COUNT = 3  # pictures of a run that do not wait: the start, and that something moves
_SLOW_REDRAWS_APART = 2.0  # new textures, of moving streaks
STILL_SECONDS = 0.2
"""Seconds without motion after which the surfaces are drawn once more."""
# samples along a side of a pixel, pixels of the window at most, and seconds to draw it
_SAMPLING_LIMITS = ((3, 2.5e6, 0.1), (2, 1e7, 0.8))


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
        return self.redraw_seconds <= _SLOW_REDRAW

    @property
    def begins(self) -> bool:
        """Return whether a run shows its first pictures, slowly: what shows its flow waits."""
        session = self._session
        is_early = session.solver.started != self._run or self._pictures_of_run <= _FIRST_COUNT
        return session.matching.running and is_early and not self.draws_quickly

    def waits(self, name: str, is_first: bool) -> bool:
        """Return whether a surface keeps its colours for this frame; ask once a frame, in order."""
        session, solver, seconds = self._session, self._session.solver, self.redraw_seconds
        if self.draws_quickly:
            return False
        if session.view.animate and name == "advected":
            return clock.perf_counter() < self._textured_at + _SLOW_REDRAWS_APART * seconds
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
        """Take in that the advected surface was drawn, with other colours than before or not."""
        if is_new and is_texture:
            self._textured_at = clock.perf_counter()
        started = self._session.solver.started
        if started != self._run:
            self._run, self._pictures_of_run = started, 0
        self._pictures_of_run += is_new


class Resting:
    """Decides how many `samples` along a side of a pixel a window's frame has."""

    def __init__(self, session: Session, is_real: bool) -> None:
        self.samples = 1
        self._session, self._is_real = session, is_real
        self._moved_at = clock.perf_counter()

    def update(self, moves: bool, seconds: float) -> None:
        """Take in whether the coming frame differs, and the seconds of a single sample."""
        if not self._is_real:
            return
        now, samples = clock.perf_counter(), self.samples
        if moves or self._session.solver.running or self._session.player.playing:
            self._moved_at, samples = now, 1
        elif samples == 1 and now >= self._moved_at + STILL_SECONDS:
            width, height = ps.get_window_size()
            fitting = [
                side
                for side, most, longest in _SAMPLING_LIMITS
                if width * height <= most and seconds * side**2 <= longest
            ]
            samples = max(fitting, default=1)
        if samples != self.samples:
            ps.set_SSAA_factor(samples)  # polyscope takes it in when it draws
            self.samples = samples
