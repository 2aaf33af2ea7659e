"""Thumbnails: small pictures of surfaces, drawn in any thread without OpenGL."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

import abfm
from abfm import TriangleMesh
from abfm.pages.color_ranges import color_range
from abfm.pages.colormaps import ColorRange, colors_of
from abfm.pages.front import front_of
from abfm.types import FloatArray

_SUBPIXELS = 2  # drawn along each side of a pixel
_GREY = 0.72
_SHADE_MIN = 0.45  # brightness of faces seen from their edge
_MARGIN_SHARE = 0.04


View = tuple[TriangleMesh, FloatArray | None]
"""A surface and, unless it is plain, its function (V,)."""


def thumbnail(views: Sequence[View], size: tuple[int, int]) -> Image.Image:
    """Return a transparent picture of surfaces one below the other, each in a size in pixels.

    Functions share a colour range.
    """
    functions = [values for _, values in views if values is not None]
    colors = color_range(*functions) if functions else None
    sheet = Image.new("RGBA", (size[0], size[1] * len(views)))
    for number, view in enumerate(views):
        sheet.paste(_drawn(view, size, colors), (0, number * size[1]))
    return sheet


def _drawn(view: View, size: tuple[int, int], colors: ColorRange | None) -> Image.Image:
    """Draw the faces of a surface from the farthest to the nearest."""
    mesh, values = view
    axes = front_of(mesh, *([] if values is None else [np.nan_to_num(values)])).axes
    places, middle = mesh.vertices @ axes.T, np.multiply(_SUBPIXELS, size) / 2
    low, high = places.min(axis=0), places.max(axis=0)
    scale = (1 - 2 * _MARGIN_SHARE) / ((high - low)[:2] / (2 * middle)).max()
    points = (places - (low + high) / 2)[:, :2] * (scale, -scale) + middle
    paint = np.full((len(mesh.faces), 3), _GREY)
    if values is not None and colors is not None:
        of_vertices = colors_of(values, colors, ~np.isfinite(values)) ** (1 / 2.2)
        paint = of_vertices[mesh.faces].mean(axis=1)
    light = _SHADE_MIN + (1 - _SHADE_MIN) * np.abs(abfm.calculus.face_normals(mesh) @ axes[2])
    inks = np.round(255 * paint * light[:, None]).astype(np.uint8)
    picture = Image.new("RGBA", (_SUBPIXELS * size[0], _SUBPIXELS * size[1]))
    canvas, order = ImageDraw.Draw(picture), places[mesh.faces, 2].sum(axis=1).argsort()
    corners = points[mesh.faces[order]].reshape(-1, 6).tolist()
    for triangle, ink in zip(corners, inks[order].tolist(), strict=True):
        canvas.polygon(triangle, fill=(*ink, 255))
    return picture.resize(size, Image.Resampling.BOX)
