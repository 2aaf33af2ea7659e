"""Kernels on the texels of an atlas: laying it out, and the way between texels and faces."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray

FloatImage = NDArray[np.float32]

ROUNDING = 1e-9


class Canvas(NamedTuple):
    """A mesh and its texture."""

    vertices: FloatArray  # (V, 3), in units of the texel length
    faces: IndexArray  # (F, 3)
    areas: FloatArray  # (F,)
    # (F, 3), slot 3 f + k across the edge opposite each corner, -1 on the boundary
    neighbours: IndexArray
    corners: FloatArray  # (F, 3, 2), where the corners of each face lie, column and row in texels
    owners: IndexArray  # (texels,), face of each texel, row by row, or -1
    size: int  # texels in a row


@kernel
def set_on_shelves(widths: IndexArray, heights: IndexArray, size: int, corners: IndexArray) -> bool:
    """Set rectangles of descending height on shelves of a square; says whether they have room."""
    x, y, shelf = 0, 0, 0
    for i in range(widths.size):
        if x + widths[i] > size:
            x, y, shelf = 0, y + shelf, 0
        shelf = max(shelf, heights[i])
        if widths[i] > size or y + shelf > size:
            return False
        corners[i, 0], corners[i, 1] = x, y
        x += widths[i]
    return True


@kernel
def halve_rectangles(
    corners: IndexArray,
    widths: IndexArray,
    heights: IndexArray,
    owners: IndexArray,
    texels: IndexArray,
) -> None:
    """Give the texels of rectangles to two owners (n, 2), below and above the falling diagonal."""
    for i in range(widths.size):
        w, h = widths[i], heights[i]
        for row in range(h):
            for column in range(w):
                above = (2 * column + 1) * h + (2 * row + 1) * w > 2 * w * h
                texels[corners[i, 1] + row, corners[i, 0] + column] = owners[i, 1 if above else 0]


@kernel
def weigh_texel(canvas: Canvas, texel: int, b: FloatArray) -> bool:
    """Compute barycentric weights of a texel's centre in its face; says whether it is inside."""
    f = canvas.owners[texel]
    corners = canvas.corners[f]
    u0, u1 = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1]
    v0, v1 = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1]
    p0, p1 = texel % canvas.size + 0.5 - corners[0, 0], texel // canvas.size + 0.5 - corners[0, 1]
    area = u0 * v1 - u1 * v0
    b[1] = (p0 * v1 - p1 * v0) / area
    b[2] = (u0 * p1 - u1 * p0) / area
    b[0] = 1.0 - b[1] - b[2]
    inside: bool = min(b[0], b[1], b[2]) >= -ROUNDING
    return inside


@kernel
def between_known(canvas: Canvas, nearest: IndexArray, texel: int) -> bool:
    """Say whether two opposite neighbours are of the same face and known: 1 to 254."""
    for away in (1, canvas.size):
        count = 0
        for other in (texel - away, texel + away):
            if (
                0 <= other < nearest.size
                and canvas.owners[other] == canvas.owners[texel]
                and 0 < nearest[other] < 255
            ):
                count += 1
        if count == 2:
            return True
    return False


@kernel
def clip(b: FloatArray) -> None:
    """Move weights into the triangle."""
    total = 0.0
    for i in range(3):
        b[i] = max(b[i], 0.0)
        total += b[i]
    for i in range(3):
        b[i] /= total


@kernel
def unfold(canvas: Canvas, f: int, b: FloatArray) -> int:
    """Rewrite weights of a place around face ``f`` for the face that it lies in, one edge further;
    returns that face.

    Stays at the edge where nothing lies behind it.
    """
    c = 0
    for i in range(1, 3):
        if b[i] < b[c]:
            c = i
    slot = canvas.neighbours[f, c]
    if b[c] >= 0.0 or slot < 0:
        clip(b)
        return f
    i, j, k = canvas.faces[f, (c + 1) % 3], canvas.faces[f, (c + 2) % 3], canvas.faces[f, c]
    g: int = slot // 3
    o = canvas.faces[g, slot % 3]
    ee, ek, eo = 0.0, 0.0, 0.0
    for x in range(3):
        start = canvas.vertices[i, x]
        edge = canvas.vertices[j, x] - start
        ee += edge * edge
        ek += edge * (canvas.vertices[k, x] - start)
        eo += edge * (canvas.vertices[o, x] - start)
    depth = -b[c] * canvas.areas[f] / canvas.areas[g]
    along = b[(c + 2) % 3] + b[c] * ek / ee - depth * eo / ee
    b[slot % 3] = depth
    b[(slot + 1) % 3] = along
    b[(slot + 2) % 3] = 1.0 - depth - along
    clip(b)
    return g


@kernel
def fill_gaps(canvas: Canvas, done: IndexArray, images: FloatImage) -> None:
    """Give texels inside triangles that are not ``done`` the mean of their neighbours."""
    b = np.empty(3)
    for texel in range(done.size):
        if canvas.owners[texel] < 0 or done[texel] or not weigh_texel(canvas, texel, b):
            continue
        known = [
            other
            for other in (texel - 1, texel + 1, texel - canvas.size, texel + canvas.size)
            if 0 <= other < done.size
            and canvas.owners[other] == canvas.owners[texel]
            and done[other]
        ]
        for other in known:
            for picture in range(images.shape[0]):
                images[picture, texel] += images[picture, other] / len(known)
        done[texel] = True


@kernel
def fill_margins(canvas: Canvas, done: IndexArray, images: FloatImage) -> None:
    """Give texels around each triangle what lies behind its edge, from those ``done``."""
    b = np.empty(3)
    for texel in range(done.size):
        if canvas.owners[texel] < 0 or done[texel]:
            continue
        weigh_texel(canvas, texel, b)
        g = unfold(canvas, canvas.owners[texel], b)
        x, y = -0.5, -0.5
        for i in range(3):
            x += b[i] * canvas.corners[g, i, 0]
            y += b[i] * canvas.corners[g, i, 1]
        column, row = math.floor(x), math.floor(y)
        total = 0.0
        for corner in range(4):
            i, j = column + corner % 2, row + corner // 2
            other = j * canvas.size + i
            if i < canvas.size and other < done.size and canvas.owners[other] == g and done[other]:
                weight = max(1.0 - abs(x - i), ROUNDING) * max(1.0 - abs(y - j), ROUNDING)
                total += weight
                for picture in range(images.shape[0]):
                    images[picture, texel] += weight * images[picture, other]
        if total > 0.0:
            for picture in range(images.shape[0]):
                images[picture, texel] /= total
