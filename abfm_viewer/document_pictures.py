"""Pictures of a document as its window shows it, drawn off the screen: any size, any time, frame by frame.

Nothing is blended or waited for: everything is computed when it is drawn. A process draws either windows or these.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from abfm import AbfmError, ParameterError
from abfm.mesh import FloatArray
from abfm_viewer import opengl, theme
from abfm_viewer.annotations import Bar, bars
from abfm_viewer.background import Latest
from abfm_viewer.colormaps import table
from abfm_viewer.document import EXTRAPOLATION, Document
from abfm_viewer.opengl import ps
from abfm_viewer.scene import Scene
from abfm_viewer.session import Session
from abfm_viewer.theme import Color

if TYPE_CHECKING:
    from abfm_viewer.viewport import Rect

LARGEST = 8192
"""Pixels along a side."""
_SHARP, _FAIR = 2.2e6, 9e6  # pixels: drawn 4 and 2 times as large, and then made smaller


@dataclass(frozen=True)
class PictureOptions:
    """What a picture has besides its surfaces."""

    transparent: bool = False
    color_bar: bool = True


class DocumentRenderer:
    """Draws one document.

    Parameters
    ----------
    document : Document
    known : dict of str to (V,) array
        Values of functions from files, as `load_project` gives them.
    size : (int, int)
        Width and height in pixels.
    options : PictureOptions

    Raises
    ------
    AbfmError
        If the size is out of range, the document's functions cannot be evaluated, or the machine cannot draw.
    """

    def __init__(
        self,
        document: Document,
        known: dict[str, FloatArray],
        size: tuple[int, int],
        options: PictureOptions | None = None,
    ) -> None:
        if not all(16 <= length <= LARGEST for length in size):
            raise ParameterError(f"size is {size[0]}x{size[1]}; expected 16 to {LARGEST} pixels along each side")
        self._size, self._options = size, options or PictureOptions()
        Latest.at_once = True
        opengl.start(opengl.OFFSCREEN, *size)
        ps.set_build_default_gui_panels(False)
        self._session = Session(document.mesh, document.name)
        self._session.restore(document, known, None)
        self._session.update()
        for spec in self._session.specs:
            if self._session.error(spec):
                raise AbfmError(f"{spec}: {self._session.error(spec)}")
        self._scene = Scene()
        self._scene.update(self._session, self._rect)
        self._scene.frame(self._session, self._rect, whole=True)
        ps.frame_tick()

    def picture(self, time: float, degrees: float = 0.0) -> Image.Image:
        """The document at a time, its surfaces turned by an angle: RGBA.

        Raises
        ------
        AbfmError
            If the time is outside 0 to 2 tau, or the flow cannot be followed so far.
        """
        session, tau = self._session, self._session.parameters.tau
        if not 0 <= time <= EXTRAPOLATION * tau * (1 + 1e-9):
            raise ParameterError(
                f"time is {time:g}; expected 0 to {EXTRAPOLATION * tau:g}, which is {EXTRAPOLATION:g} tau"
            )
        session.amend(time=min(time, session.end))
        session.update()
        self._scene.update(session, self._rect)
        if session.flow_problem or session.quantities.error:
            raise AbfmError(session.flow_problem or session.quantities.error)
        self._scene.turn(degrees)
        pixels = self._size[0] * self._size[1]
        ps.set_SSAA_factor(4 if pixels <= _SHARP else 2 if pixels <= _FAIR else 1)
        drawn = ps.screenshot_to_buffer(transparent_bg=True)
        picture = Image.fromarray(np.ascontiguousarray(drawn))
        if not self._options.transparent:
            ground = Image.new("RGBA", picture.size, _rgb(theme.palette(session.view.theme).ground))
            ground.alpha_composite(picture)
            picture = ground
        self._annotate(picture)
        return picture

    def frames(self, start: float, end: float, count: int, turntable: float) -> Iterator[NDArray[np.uint8]]:
        """Frames (H, W, 3) of a movie from one time to another, while the surfaces turn by an angle in degrees."""
        for number in range(count):
            share = number / max(count - 1, 1)
            turned = turntable * number / count  # the first frame follows the last when it is repeated
            picture = self.picture(start + share * (end - start), turned)
            yield np.asarray(picture.convert("RGB"))

    def close(self) -> None:
        """End all threads."""
        self._session.close()

    @property
    def _rect(self) -> Rect:
        width, height = self._size
        below = 4.2 * self._text_height if self._options.color_bar else 0.0
        return (0.0, 0.0, float(width), height - below)

    @property
    def _text_height(self) -> float:
        return max(11.0, min(self._size) / 42)

    def _annotate(self, picture: Image.Image) -> None:
        """Write the surfaces' names and draw the colour bars."""
        palette = theme.palette(self._session.view.theme)
        draw = ImageDraw.Draw(picture)
        height = self._text_height
        font = ImageFont.load_default(height)
        inks = {"source": palette.source, "target": palette.target}
        for name, (x, y) in self._scene.labels().items():
            paint = self._scene.paints.get(name)
            place = (x, max(y - 0.8 * height, 0.9 * height))
            ink = _rgb(inks.get(name, palette.ink))
            draw.text(place, paint.title if paint else name, fill=ink, font=font, anchor="mm")
        if self._options.color_bar:
            left = 1.2 * height
            for bar in bars(self._scene):
                left += self._draw_bar(draw, bar, left, _rgb(palette.ink), _rgb(palette.muted)) + 2 * height

    def _draw_bar(
        self, draw: ImageDraw.ImageDraw, bar: Bar, left: float, ink: tuple[int, ...], muted: tuple[int, ...]
    ) -> float:
        """One colour bar at the bottom; its width."""
        height = self._text_height
        font = ImageFont.load_default(0.85 * height)
        width = round(max(11 * height, draw.textlength(bar.title, font)))
        top = self._size[1] - 2.2 * height
        for column, color in enumerate(np.round(255 * table(bar.colors.colormap, width)).astype(int)):
            draw.line((left + column, top, left + column, top + 0.6 * height), fill=tuple(map(int, color)))
        draw.text((left, top - 0.3 * height), bar.title, fill=muted, font=font, anchor="ls")
        low, high = bar.colors.low, bar.colors.high
        for value, share, anchor in ((low, 0.0, "lt"), ((low + high) / 2, 0.5, "mt"), (high, 1.0, "rt")):
            draw.text((left + share * width, top + 0.9 * height), f"{value:.3g}", fill=ink, font=font, anchor=anchor)
        return float(width)


def _rgb(color: Color) -> tuple[int, int, int, int]:
    red, green, blue, alpha = (round(255 * channel) for channel in color)
    return red, green, blue, alpha
