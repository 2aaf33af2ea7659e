"""Choice of the frames of the window that redraw the surfaces, and of the samples per pixel."""

import time as clock

from abfm_viewer.scene.opengl import ps
from abfm_viewer.session.session import Session

_SLOW_REDRAW = 0.025
_FRAMES_PER_SLOW_REDRAW = 30
_FRAMES_PER_SECOND_OF_REDRAW = 120  # at 30 frames per second, drawing takes a fifth of the time
_FIRST_COUNT = 3  # number of a run's first pictures, which are drawn at once
_TEXTURE_WAIT_RATIO = 2.0  # wait between textures of moving streaks, in redraw times
STILL_SECONDS = 0.2  # seconds without motion after which the surfaces are drawn with more samples
# samples along a side of a pixel; maximum pixels of the window; maximum seconds to draw it
_SAMPLING_LIMITS = ((3, 2.5e6, 0.1), (2, 1e7, 0.8))


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
    """Choice of `samples`, the number of antialiasing samples along each side of a pixel."""

    def __init__(self, session: Session, is_real: bool) -> None:
        self.samples = 1
        self._session, self._is_real = session, is_real
        self._moved_at = clock.perf_counter()

    def update(self, moves: bool, seconds: float) -> None:
        """Choose `samples`; drawing the window with one sample per pixel takes ``seconds``."""
        if not self._is_real:
            return
        now, samples = clock.perf_counter(), self.samples
        if moves or self._session.solver.running or self._session.player.playing:
            self._moved_at, samples = now, 1
        elif samples == 1 and now >= self._moved_at + STILL_SECONDS:
            width, height = ps.get_window_size()
            fitting = [
                side
                for side, pixels_max, seconds_max in _SAMPLING_LIMITS
                if width * height <= pixels_max and seconds * side**2 <= seconds_max
            ]
            samples = max(fitting, default=1)
        if samples != self.samples:
            ps.set_SSAA_factor(samples)  # used by polyscope in its next drawing
            self.samples = samples
