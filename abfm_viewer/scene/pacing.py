"""Which frames draw the surfaces anew where that takes longer than a frame, as without a graphics card.

Surfaces that follow a solve or show moving streaks then wait, so that the window answers in the other frames.
"""

import time as clock

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
        """Whether the surfaces are drawn anew within a frame."""
        return self.redraw_seconds <= _SLOW_REDRAW

    @property
    def begins(self) -> bool:
        """Whether a run shows its first pictures where surfaces are drawn slowly: what shows its flow waits."""
        solver = self._session.solver
        is_early = solver.started != self._run or self._pictures_of_run <= _AT_ONCE
        return solver.running and is_early and not self.draws_quickly

    def waits(self, name: str, is_first: bool) -> bool:
        """Whether a surface keeps its colours for this frame; asked once a frame for each, the first one first."""
        session = self._session
        if self.draws_quickly:
            return False
        if session.view.animate and name == "advected":
            return clock.perf_counter() < self._textured_at + _SLOW_REDRAWS_APART * self.redraw_seconds
        solver = session.solver
        if not solver.running or solver.started != self._run or self._pictures_of_run < _AT_ONCE:
            return False
        if is_first:
            frames = max(_FRAMES_PER_SLOW_REDRAW, round(_FRAMES_PER_SECOND_OF_REDRAW * self.redraw_seconds))
            self._frames_behind = (self._frames_behind + 1) % frames
        return self._frames_behind != 0 and not session.dragging

    def count(self, is_new: bool, is_texture: bool) -> None:
        """Take in that the advected surface was drawn, with other colours than before or the same."""
        if is_new and is_texture:
            self._textured_at = clock.perf_counter()
        started = self._session.solver.started
        if started != self._run:
            self._run, self._pictures_of_run = started, 0
        self._pictures_of_run += is_new
