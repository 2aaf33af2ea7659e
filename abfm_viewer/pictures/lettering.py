"""Names, labels and colour bars on pictures."""

from collections.abc import Iterable

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from abfm_viewer.appearance.colormaps import table
from abfm_viewer.appearance.theme import Color
from abfm_viewer.scene.annotations import Line, Part, Pen, Strip, Text

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont


def letter(picture: Image.Image, parts: Iterable[Part], pen: Pen, font: Font) -> None:
    """Write texts and draw colour bars, as they were laid out for a pen of a font."""
    for part in parts:
        if isinstance(part, Text):
            _write(picture, part, pen, font)
        elif isinstance(part, Line):
            ImageDraw.Draw(picture).line(
                part.points, fill=rgb(part.color), width=max(round(part.width), 1)
            )
        else:
            _color(picture, part)


def _color(picture: Image.Image, strip: Strip) -> None:
    left, top, right, bottom = map(round, strip.rect)
    length, across = (bottom - top, right - left) if strip.upright else (right - left, bottom - top)
    row = np.round(255 * table(strip.colormap, max(length, 2))).astype(np.uint8)
    colors = Image.fromarray(np.tile(row, (across, 1, 1)))
    picture.paste(
        colors.transpose(Image.Transpose.ROTATE_90) if strip.upright else colors, (left, top)
    )


def _write(picture: Image.Image, text: Text, pen: Pen, font: Font) -> None:
    """Write a text on a layer of its colour, so that its edges fade to nothing else."""
    left, top = round(text.left), round(text.top)
    red, green, blue = rgb(text.color)
    size = round(pen.width(text.text)) + 2, round(pen.line) + 2
    layer = Image.new("RGBA", size, (red, green, blue, 0))
    ImageDraw.Draw(layer).text(
        (0, 0), text.text, fill=(red, green, blue, 255), font=font, anchor="la"
    )
    if picture.mode == "RGBA":
        hidden = min(max(-left, 0), layer.width), min(max(-top, 0), layer.height)
        picture.alpha_composite(layer, (max(left, 0), max(top, 0)), hidden)
    else:
        picture.paste(layer, (left, top), layer)


def rgb(color: Color) -> tuple[int, int, int]:
    """A colour of the theme as pictures have it, without alpha."""
    red, green, blue, _ = (round(255 * channel) for channel in color)
    return red, green, blue
