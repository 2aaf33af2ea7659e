"""Off-screen drawing in any size with antialiasing, and annotations of pictures."""

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from abfm.pages.colormaps import table
from abfm.types import FloatArray
from abfm_viewer.appearance.theme import Color
from abfm_viewer.errors import DrawingError
from abfm_viewer.scene import opengl
from abfm_viewer.scene.annotations import Disc, Line, Part, Pen, Strip, Text, Triangle
from abfm_viewer.scene.opengl import ps

Pixels = NDArray[np.uint8]
Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

# by samples along a side of a pixel: maximum number of samples in a picture
_SAMPLES_MAX = {4: 40e6, 3: 80e6, 2: 140e6}
_SIDE_SAMPLES_MAX = 16384  # along a side of a picture, a limit of graphics cards
_START_SIZE = 64
_DISC_SAMPLES = 4  # samples along a side of a pixel of a disc or a triangle
# constants of polyscope's tone mapping
_GAMMA = 2.2
_WHITE = 0.75
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@contextmanager
def canvas(width: int, height: int) -> Iterator[None]:
    """Make polyscope draw pictures of this size; raise `DrawingError` if OpenGL cannot."""
    opengl.start(opengl.OFFSCREEN_BACKEND, _START_SIZE, _START_SIZE)
    opengl.clear()
    limits = _SAMPLES_MAX.items()
    allowed = [side for side, samples in limits if width * height * side**2 <= samples]
    side = next((side for side in allowed if max(width, height) * side <= _SIDE_SAMPLES_MAX), 1)
    try:
        _resize(width, height, side)
        yield
    except RuntimeError as error:
        if "OpenGl error" not in str(error):
            raise
        raise DrawingError(
            f"OpenGL cannot draw a picture of {width} x {height} pixels; choose a smaller size"
        ) from None
    finally:
        with suppress(RuntimeError):
            _resize(_START_SIZE, _START_SIZE, 1)


def rendered(transparent: bool) -> Pixels:
    """Return polyscope's current picture: (H, W, 3), or (H, W, 4) with a transparent background.

    A screen of a Mac has several pixels for each pixel of a window. Their averages are returned.
    """
    pixels, size = _rendered(transparent), tuple(ps.get_window_size())
    if pixels.shape[1::-1] == size:
        return pixels
    return np.array(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))


def _rendered(transparent: bool) -> Pixels:
    if not transparent:
        return np.ascontiguousarray(ps.screenshot_to_buffer(transparent_bg=False)[:, :, :3])
    ps.set_background_color((0.0, 0.0, 0.0, 0.0))
    pixels = np.ascontiguousarray(ps.screenshot_to_buffer(transparent_bg=True))
    edge = (pixels[..., 3] > 0) & (pixels[..., 3] < 255)
    pixels[edge, :3] = _without_black(pixels[edge, :3], pixels[edge, 3:])
    return pixels


def _resize(width: int, height: int, side: int) -> None:
    ps.set_window_size(_START_SIZE, _START_SIZE)
    ps.set_SSAA_factor(side)
    ps.screenshot_to_buffer()  # polyscope applies the factor when it draws
    ps.set_window_size(width, height)  # creates new off-screen buffers


def _without_black(colors: Pixels, alpha: Pixels) -> Pixels:
    """Return the colours (n, 3) of pixels at edges without the black background mixed into them.

    polyscope mixes the background in before its tone mapping. ``alpha`` (n, 1) is 0 to 255.
    """
    share = alpha / 255
    light = (np.maximum(colors, 1) / 255) ** _GAMMA
    mapped = light @ _LUMINANCE[:, None]
    # the inverse of `_mapped`, the extended Reinhard curve
    b = 1 - mapped
    luminance = _WHITE**2 / 2 * (np.sqrt(b**2 + 4 * mapped / _WHITE**2) - b)
    unmixed = luminance / share
    encoded = np.clip(light / mapped * _mapped(unmixed), 0, 1) ** (1 / _GAMMA)
    return np.asarray(np.round(255 * encoded), dtype=np.uint8)


def _mapped(luminance: FloatArray) -> FloatArray:
    return luminance * (1 + luminance / _WHITE**2) / (1 + luminance)


def draw_parts(picture: Image.Image, parts: Iterable[Part], pen: Pen, font: Font) -> None:
    for part in parts:
        if isinstance(part, Text):
            _write(picture, part, pen, font)
        elif isinstance(part, Line):
            width = max(round(part.width), 1)
            ImageDraw.Draw(picture).line(part.points, fill=rgb(part.color), width=width)
        elif isinstance(part, Disc):
            _draw_disc(picture, part)
        elif isinstance(part, Triangle):
            _draw_triangle(picture, part)
        elif isinstance(part, Strip):
            _draw_strip(picture, part)


def _draw_disc(picture: Image.Image, disc: Disc) -> None:
    left, top = (math.floor(middle - disc.radius) for middle in disc.centre)
    side = math.ceil(2 * disc.radius) + 2
    middle = [_DISC_SAMPLES * (at - low) for at, low in zip(disc.centre, (left, top), strict=True)]
    mask = Image.new("L", (_DISC_SAMPLES * side, _DISC_SAMPLES * side), 0)
    for radius, shade in ((disc.radius, 255), *([(disc.hole, 0)] if disc.hole else [])):
        box = [at + sign * _DISC_SAMPLES * radius for sign in (-1, 1) for at in middle]
        ImageDraw.Draw(mask).ellipse(box, fill=shade)
    _fill(picture, mask, disc.color, (left, top))


def _draw_triangle(picture: Image.Image, triangle: Triangle) -> None:
    across, down = zip(*triangle.points, strict=True)
    left, top = math.floor(min(across)), math.floor(min(down))
    size = math.ceil(max(across)) - left, math.ceil(max(down)) - top
    mask = Image.new("L", tuple(_DISC_SAMPLES * max(side, 1) for side in size), 0)
    corners = [(_DISC_SAMPLES * (x - left), _DISC_SAMPLES * (y - top)) for x, y in triangle.points]
    ImageDraw.Draw(mask).polygon(corners, fill=255)
    _fill(picture, mask, triangle.color, (left, top))


def _fill(
    picture: Image.Image, samples: Image.Image, color: Color, corner: tuple[int, int]
) -> None:
    """Draw a shape, a mask with several samples along a side of a pixel, at a corner."""
    size = samples.width // _DISC_SAMPLES, samples.height // _DISC_SAMPLES
    layer = Image.new("RGBA", size, (*rgb(color), 0))
    layer.putalpha(samples.resize(size, Image.Resampling.BOX))
    _composite(picture, layer, *corner)


def _composite(picture: Image.Image, layer: Image.Image, left: int, top: int) -> None:
    """Draw a picture, ``layer``, onto another one at a position; parts outside are ignored."""
    if picture.mode == "RGBA":
        hidden = min(max(-left, 0), layer.width), min(max(-top, 0), layer.height)
        picture.alpha_composite(layer, (max(left, 0), max(top, 0)), hidden)
    else:
        picture.paste(layer, (left, top), layer)


def _draw_strip(picture: Image.Image, strip: Strip) -> None:
    left, top, right, bottom = map(round, strip.rect)
    length, across = (bottom - top, right - left) if strip.upright else (right - left, bottom - top)
    row = np.round(255 * table(strip.colormap, max(length, 2))).astype(np.uint8)
    colors = Image.fromarray(np.tile(row, (across, 1, 1)))
    if strip.upright:
        colors = colors.transpose(Image.Transpose.ROTATE_90)
    picture.paste(colors, (left, top))


def _write(picture: Image.Image, text: Text, pen: Pen, font: Font) -> None:
    """Write a text on a picture.

    Transparent pixels around the letters have the text's colour, which keeps their edges clean.
    """
    left, top, color = round(text.left), round(text.top), rgb(text.color)
    size = round(pen.width(text.text)) + 2, round(pen.line) + 2
    layer = Image.new("RGBA", size, (*color, 0))
    ImageDraw.Draw(layer).text((0, 0), text.text, fill=(*color, 255), font=font, anchor="la")
    _composite(picture, layer, left, top)


def rgb(color: Color) -> tuple[int, int, int]:
    """Return a colour of the theme as integers from 0 to 255, without alpha."""
    red, green, blue, _ = (round(255 * channel) for channel in color)
    return red, green, blue
