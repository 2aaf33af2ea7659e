"""Strips of triangles, as VTK, PLY and glTF have them."""

import numpy as np

from abfm.types import IntArray


def triangles_of_strips(sizes: IntArray, corners: IntArray) -> IntArray:
    """Return the triangles (F, 3) of strips, all with the side of the first one of each strip.

    Triangles that name a vertex twice only join two parts of a strip, and are left out.

    Parameters
    ----------
    sizes : (S,) array of int
        Number of corners of each strip.
    corners : (sum of sizes,) array of int
        The vertices of one strip after the other.
    """
    counts = np.maximum(sizes - 2, 0)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    first = np.repeat(np.cumsum(sizes) - sizes, counts) + place
    odd = place % 2
    faces = np.empty((len(first), 3), dtype=np.int64)
    for column, shift in enumerate((0, 1 + odd, 2 - odd)):
        faces[:, column] = corners[first + shift]
    a, b, c = faces.T
    is_kept = (a != b) & (b != c) & (c != a)
    return faces if is_kept.all() else faces[is_kept]
