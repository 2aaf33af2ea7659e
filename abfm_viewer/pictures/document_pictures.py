"""Off-screen pictures of a document as its window shows it, in any size and at any time.

All values are computed in the caller's thread. A process can draw either windows or these pictures.
"""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from PIL import Image, ImageFont

from abfm import AbfmError, FunctionError, ParameterError
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.document.document import Document
from abfm_viewer.pictures.canvas import Pixels, canvas, draw_parts, rendered
from abfm_viewer.scene.annotations import TICK, Pen, annotation_parts, bars_height, name_height
from abfm_viewer.scene.scene import Scene
from abfm_viewer.session.saving.export_settings import Background
from abfm_viewer.session.session import Session
from abfm_viewer.shown.shown import Shown
from abfm_viewer.widgets.widget_record import Rect

SIDE_MAX = 8192  # pixels along a side
_TEXT_SHARE = 1 / 42  # of the shorter side
_TEXT_PIXELS_MIN = 11.0
_WINDOW_TEXT_PIXELS = 16.0  # at a scale of 1


@dataclass(frozen=True)
class PictureOptions:
    background: Background = "theme"
    color_bar: bool = True  # unless the view of the document hides it
    labels: bool = True  # names of the surfaces
    # surfaces are small enough to turn in their slots; only the direction of the view is used
    turns: bool = False


_DEFAULT_OPTIONS = PictureOptions()


class DocumentRenderer:
    """Off-screen drawing of a document in a size in pixels; a context manager.

    ``known`` has the values (V,) of functions from files, by the spec of the function. Raises
    `AbfmError` if the size is out of range, a function cannot be evaluated, or the machine cannot
    draw.
    """

    def __init__(
        self,
        document: Document,
        known: dict[str, FloatArray],
        size: tuple[int, int],
        options: PictureOptions = _DEFAULT_OPTIONS,
    ) -> None:
        if not all(16 <= length <= SIDE_MAX for length in size):
            raise ParameterError(
                f"size is {size[0]}x{size[1]}; expected 16 to {SIDE_MAX} pixels along each side"
            )
        if options.background == "white":
            document = replace(document, view=replace(document.view, theme="light"))
        self._document, self._known, self._size, self._options = document, known, size, options
        self._rect: Rect = (0.0, 0.0, float(size[0]), float(size[1]))
        self._color_bar = options.color_bar and document.view.color_bar
        height = max(_TEXT_PIXELS_MIN, min(size) * _TEXT_SHARE)
        self._font = ImageFont.load_default(height)
        inks = theme.palette(document.view.theme)
        scale = height / _WINDOW_TEXT_PIXELS
        self._pen = Pen(scale, 1.2 * height, self._font.getlength, inks, TICK * scale)

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(canvas(*self._size))
            surface = self._document.surface()
            self._session = session = Session(surface.mesh, surface.name, at_once=True)
            opened.callback(session.close)
            self._shown = Shown(session)
            opened.callback(self._shown.close)
            session.set_appearance(**self._document.view.appearance)
            session.restore(self._document, self._known, None)
            session.update()
            if problem := session.work.blocking_problem:
                raise FunctionError(problem)
            self._scene = Scene(self._shown, self._options.turns)
            self._scene.pixels = self._pen.scale
            self._scene.name_height = name_height(self._pen) if self._options.labels else 0.0
            bars = bars_height(self._pen, self._size[1]) if self._color_bar else 0.0
            self._scene.bars_height = bars
            self._scene.update(self._rect)
            self._open = opened.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._open.__exit__(*error)

    def picture(self, time: float, degrees: float = 0.0, phase: float = 0.0) -> Image.Image:
        """Return the picture at a time, with the surfaces turned by ``degrees``.

        ``phase``, from 0 to 1, is the position of moving streaks in their cycle.

        The picture is RGB, or RGBA on a transparent background. Raises `AbfmError` if the time is
        outside the time bar, or the flow cannot be computed to this time.
        """
        self._go_to(time)
        self._session.player.phase = phase
        self._scene.update(self._rect)
        if problem := self._shown.flow.problem or self._shown.quantities.error:
            raise AbfmError(f"the picture of time {time:g} cannot be drawn: {problem}")
        self._scene.turn(degrees)
        background = self._options.background
        picture = Image.fromarray(rendered(transparent=background != "theme"))
        if background == "white":
            white = Image.new("RGBA", picture.size, "white")
            picture = Image.alpha_composite(white, picture).convert("RGB")
        parts = annotation_parts(
            self._scene, self._rect, self._pen, self._color_bar, self._options.labels
        )
        draw_parts(picture, parts, self._pen, self._font)
        return picture

    def frames(
        self, start: float, end: float, count: int, turntable: float, cycles: int = 1
    ) -> Iterator[Pixels]:
        """Yield the frames (H, W, 3) of a movie between two times.

        During the movie, the surfaces turn by ``turntable`` degrees, and moving streaks complete
        ``cycles`` cycles. The movie can be repeated without a jump of the streaks.
        """
        if self._document.view.error:
            frame_times = (time for time in self._document.ticks if start < time < end)
            self._scene.painter.largest_error = max(map(self._error, (start, end, *frame_times)))
        for number in range(count):
            share = number / max(count - 1, 1)
            turned, phase = turntable * number / count, cycles * number / count % 1
            yield np.asarray(self.picture(start + share * (end - start), turned, phase))

    def _go_to(self, time: float) -> None:
        session, document = self._session, self._session.document
        start, end = document.start, document.end
        tolerance = 1e-9 * (end - start)
        if not start - tolerance <= time <= end + tolerance:
            raise ParameterError(f"time is {time:g}; expected {document.time_range_text}")
        session.editor.amend(time=min(max(time, start), end))
        session.update()

    def _error(self, time: float) -> float:
        self._go_to(time)
        target, advected = self._session.work.flow_values("target"), self._shown.flow.advected()
        return 0.0 if target is None or advected is None else float(np.abs(target - advected).max())
