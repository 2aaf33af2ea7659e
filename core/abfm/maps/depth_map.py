"""Depth maps: for each pixel of a picture, the depth of the surface point nearest to the viewer."""

import numpy as np

from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IntArray


def nearest_depths(vertices: FloatArray, faces: IntArray, width: int, height: int) -> FloatArray:
    """Return the depth of the nearest surface point at each pixel, shape (height, width).

    A row of ``vertices`` (V, 3) has the column and the row of a vertex in pixels, and its depth.
    Depths are larger for points nearer to the viewer, and linear on the projected face. The result
    is evaluated at pixel centres; it is -inf where there is no face.
    """
    nearest = np.full((height, width), -np.inf)
    rasterize_depths(vertices, faces, nearest)
    return nearest


@kernel
def rasterize_depths(vertices: FloatArray, faces: IntArray, nearest: FloatArray) -> None:
    """Write the depths of faces (F, 3) to the pixels where they are larger than in ``nearest``."""
    height, width = nearest.shape
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if double == 0.0:
            continue
        left = max(int(np.ceil(min(a[0], b[0], c[0]) - 0.5)), 0)
        right = min(int(np.floor(max(a[0], b[0], c[0]) - 0.5)), width - 1)
        low = max(int(np.ceil(min(a[1], b[1], c[1]) - 0.5)), 0)
        high = min(int(np.floor(max(a[1], b[1], c[1]) - 0.5)), height - 1)
        for row in range(low, high + 1):
            for column in range(left, right + 1):
                x, y = column + 0.5, row + 0.5
                of_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / double
                of_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / double
                if of_b >= 0.0 and of_c >= 0.0 and of_b + of_c <= 1.0:
                    near = a[2] + of_b * (b[2] - a[2]) + of_c * (c[2] - a[2])
                    nearest[row, column] = max(nearest[row, column], near)
