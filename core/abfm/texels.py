"""Numba kernels on the texels of an atlas: laying it out, and finding the way between texels and faces."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from abfm.kernels import FloatArray, IndexArray, kernel


class Canvas(NamedTuple):
    """A mesh and its texture.

    Attributes
    ----------
    vertices : (V, 3) array
        In units of the texel length.
    faces : (F, 3) array of int
    areas : (F,) array
    neighbours : (F, 3) array of int
        The slot ``3 f + k`` on the other side of the edge opposite each corner, -1 on the boundary.
    corners : (F, 3, 2) array
        Where the corners of each face lie, column and row in texels.
    owners : (size, size) array of int
        The face of each texel, or -1.
    """

    vertices: FloatArray
    faces: IndexArray
    areas: FloatArray
    neighbours: IndexArray
    corners: FloatArray
    owners: IndexArray


@kernel
def set_on_shelves(widths: IndexArray, heights: IndexArray, size: int, corners: IndexArray) -> bool:
    """Set rectangles of descending height on shelves of a square; lower left corners (n, 2). Whether they have room."""
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
    corners: IndexArray, widths: IndexArray, heights: IndexArray, owners: IndexArray, texels: IndexArray
) -> None:
    """Give the texels of each rectangle to its two owners (n, 2): below and above the falling diagonal."""
    for i in range(widths.size):
        w, h = widths[i], heights[i]
        for row in range(h):
            for column in range(w):
                above = (2 * column + 1) * h + (2 * row + 1) * w > 2 * w * h
                texels[corners[i, 1] + row, corners[i, 0] + column] = owners[i, 1 if above else 0]


@kernel
def texel_weights(corners: FloatArray, f: int, column: float, row: float, b: FloatArray) -> None:
    """Barycentric weights of a place in the texture, in or around face ``f``."""
    u0, u1 = corners[f, 1, 0] - corners[f, 0, 0], corners[f, 1, 1] - corners[f, 0, 1]
    v0, v1 = corners[f, 2, 0] - corners[f, 0, 0], corners[f, 2, 1] - corners[f, 0, 1]
    p0, p1 = column - corners[f, 0, 0], row - corners[f, 0, 1]
    area = u0 * v1 - u1 * v0
    b[1] = (p0 * v1 - p1 * v0) / area
    b[2] = (u0 * p1 - u1 * p0) / area
    b[0] = 1.0 - b[1] - b[2]


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
    """Rewrite weights of a place around face ``f`` for the face that it lies in, one edge further; returns that face.

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
    g = slot // 3
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
def fill_margins(canvas: Canvas, done: IndexArray, images: FloatArray) -> None:
    """Give texels around each triangle, in ``images`` (P, texels), what lies behind its edge, from those ``done``."""
    size = canvas.owners.shape[1]
    b = np.empty(3)
    for texel in range(done.size):
        f = canvas.owners[texel // size, texel % size]
        if f < 0 or done[texel]:
            continue
        texel_weights(canvas.corners, f, texel % size + 0.5, texel // size + 0.5, b)
        g = unfold(canvas, f, b)
        x, y = -0.5, -0.5
        for i in range(3):
            x += b[i] * canvas.corners[g, i, 0]
            y += b[i] * canvas.corners[g, i, 1]
        column, row = int(math.floor(x)), int(math.floor(y))
        share = 0.0
        for step in range(4):
            i, j = min(column + step % 2, size - 1), min(row + step // 2, size - 1)
            if canvas.owners[j, i] == g and done[j * size + i]:
                weight = max(1.0 - abs(x - i), 0.0) * max(1.0 - abs(y - j), 0.0) + 1e-9
                share += weight
                for picture in range(images.shape[0]):
                    images[picture, texel] += weight * images[picture, j * size + i]
        if share > 0.0:
            for picture in range(images.shape[0]):
                images[picture, texel] /= share
