"""What of a surface is nearest to an eye, pixel by pixel."""

import numpy as np

from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IntArray


def nearest_depths(seen: FloatArray, faces: IntArray, width: int, height: int) -> FloatArray:
    """Draw faces (F, 3) of vertices (V, 3), in pixels and with a depth that is larger where they
    are nearer and linear in the picture: the largest at each pixel's middle, (height, width), or
    -inf where there is nothing.
    """
    nearest = np.full((height, width), -np.inf)
    draw_nearest(seen, faces, nearest)
    return nearest


@kernel
def draw_nearest(seen: FloatArray, faces: IntArray, nearest: FloatArray) -> None:
    """Draw faces (F, 3) of vertices (V, 3), in pixels, into what is nearest at pixels' middles."""
    height, width = nearest.shape
    for f in range(len(faces)):
        a, b, c = seen[faces[f, 0]], seen[faces[f, 1]], seen[faces[f, 2]]
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
