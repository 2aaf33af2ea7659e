"""Thumbnails: small pictures of surfaces, drawn in any thread without OpenGL."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image

from abfm import TriangleMesh
from abfm.pages.color_ranges import color_range
from abfm.pages.colormaps import ColorRange, colors_of
from abfm.pages.front import front_of
from abfm.types import FloatArray, IntArray

_SUBPIXELS = 2  # drawn along each side of a pixel
_POINTS_PER_PIXEL = 6  # of the drawn surface
_POINTS_MAX = 2_000_000
_GREY = 0.72
_SHADE_MIN = 0.45  # brightness of faces seen from their edge
_MARGIN_SHARE = 0.04


class View(NamedTuple):
    """A surface and, unless it is plain, its function (V,)."""

    mesh: TriangleMesh
    values: FloatArray | None = None


def thumbnails(views: Sequence[View], size: tuple[int, int]) -> list[Image.Image]:
    """Return a transparent picture of each surface, in one size; functions share a colour range."""
    functions = [view.values for view in views if view.values is not None]
    colors = color_range(*functions) if functions else None
    return [_drawn(view, size, colors) for view in views]


def _drawn(view: View, size: tuple[int, int], colors: ColorRange | None) -> Image.Image:
    """Draw the nearest of many points of a surface in each pixel."""
    mesh, values = view
    known = [] if values is None else [np.nan_to_num(values)]
    axes = front_of(mesh, *known).axes
    places = mesh.vertices @ axes.T
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    width, height = (_SUBPIXELS * length for length in size)
    scale = (1 - 2 * _MARGIN_SHARE) / max((high - low) / (width, height))
    corners = places[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.abs(normals[:, 2])
    covered = facing.sum() / 2 * scale**2  # pixels, counted for each layer of the surface
    faces, weights = _points(facing, int(min(_POINTS_PER_PIXEL * covered + 1, _POINTS_MAX)))
    at = np.einsum("pc,pcx->px", weights, corners[faces])
    x, y = ((at[:, :2] - (low + high) / 2) * scale * (1, -1) + (width / 2, height / 2)).T
    column = np.clip(x.astype(np.int64), 0, width - 1)
    row = np.clip(y.astype(np.int64), 0, height - 1)
    shade = facing / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    light = (_SHADE_MIN + (1 - _SHADE_MIN) * shade)[faces, None]
    if values is None or colors is None:
        paint = np.full((len(faces), 3), _GREY)
    else:
        of_vertices = colors_of(values, colors, ~np.isfinite(values)) ** (1 / 2.2)
        paint = np.einsum("pc,pcx->px", weights, of_vertices[mesh.faces[faces]])
    pixels = np.zeros((height, width, 4))
    nearest = np.argsort(at[:, 2], kind="stable")  # the nearest point is written last
    painted = np.concatenate([paint * light, np.ones((len(faces), 1))], axis=1)
    pixels[row[nearest], column[nearest]] = painted[nearest]
    parts = pixels.reshape(size[1], _SUBPIXELS, size[0], _SUBPIXELS, 4).mean(axis=(1, 3))
    parts[..., :3] /= np.maximum(parts[..., 3:], 1e-300)
    return Image.fromarray(np.round(255 * parts).astype(np.uint8), "RGBA")


def _points(areas: FloatArray, count: int) -> tuple[IntArray, FloatArray]:
    """Return faces (P,) and barycentric weights (P, 3) of points, evenly by the areas of faces."""
    random = np.random.default_rng(0)
    ends = np.cumsum(areas)
    shares = (np.arange(count) + random.random(count)) / count
    faces = np.minimum(np.searchsorted(ends, shares * ends[-1]), len(areas) - 1)
    u, v = random.random((2, count))
    root = np.sqrt(u)
    return faces, np.stack([1 - root, root * (1 - v), root * v], axis=1)
