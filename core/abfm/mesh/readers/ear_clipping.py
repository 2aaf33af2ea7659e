"""Plane polygons cut into triangles: one ear, a corner whose triangle is empty, after the other.

Meisters, "Polygons have ears", 1975. (``mapbox_earcut`` leaves corners on straight sides out, which
makes cracks between polygons, and does not tell what crosses itself.)
"""

import numpy as np

from abfm.numerics.kernels import kernel
from abfm.types import BoolArray, FloatArray, IndexArray


@kernel
def clip_polygons(
    points: FloatArray, corners: IndexArray, sizes: IndexArray, asked: BoolArray, faces: IndexArray
) -> BoolArray:
    """Write into ``faces`` (n - 2 P, 3) the triangles of the polygons (P,) that are ``asked`` for.

    ``points`` (n, 2) are the corners of one polygon after the other, each counterclockwise, which
    the faces call ``corners``. Return those (P,) that have no right ones: they keep what they had.
    """
    failed = np.zeros(sizes.size, dtype=np.bool_)
    start, face = 0, 0
    for polygon in range(sizes.size):
        count = sizes[polygon]
        if asked[polygon]:
            triangles = _clip_ears(points[start : start + count])
            failed[polygon] = len(triangles) < count - 2
            if not failed[polygon]:
                for k in range(count - 2):
                    for corner in range(3):
                        faces[face + k, corner] = corners[start + triangles[k, corner]]
        start += count
        face += count - 2
    return failed


@kernel
def _clip_ears(points: FloatArray) -> IndexArray:
    """Compute triangles (n - 2, 3) of corners (n, 2), or fewer if there are no more ears.

    Of all ears the most even is cut first: flat ones are left to the end, when their neighbours
    have helped them. A simple polygon always has one; what crosses itself may not. Each cut changes
    only whether its two neighbours are ears: the time grows with the square of n.
    """
    count = len(points)
    before, after = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    for k in range(count):
        before[k], after[k] = k - 1 if k else count - 1, k + 1 if k + 1 < count else 0
    evenness = np.empty(count)
    for k in range(count):
        evenness[k] = _ear(points, before[k], k, after[k], after)
    triangles = np.empty((count - 2, 3), dtype=np.int64)
    found, somewhere = 0, 0
    while found < count - 2:
        best = k = somewhere
        for _ in range(count - found):
            if evenness[k] > evenness[best]:
                best = k
            k = after[k]
        if evenness[best] <= 0:
            break
        a, c = before[best], after[best]
        triangles[found, 0], triangles[found, 1], triangles[found, 2] = a, best, c
        found += 1
        after[a], before[c] = c, a
        evenness[a] = _ear(points, before[a], a, c, after)
        evenness[c] = _ear(points, a, c, after[c], after)
        somewhere = a
    return triangles[:found]


@kernel
def _ear(points: FloatArray, a: int, b: int, c: int, after: IndexArray) -> float:
    """Compute twice the area of a corner's triangle over its longest side squared; 0: no ear."""
    area = _turn(points, a, b, c)
    if area <= 0:
        return 0.0
    k = after[c]
    while k != a:
        if (
            _turn(points, a, b, k) >= 0
            and _turn(points, b, c, k) >= 0
            and _turn(points, c, a, k) >= 0
            and _distance(points, k, a) > 0
            and _distance(points, k, b) > 0
            and _distance(points, k, c) > 0
        ):
            return 0.0
        k = after[k]
    sides = _distance(points, a, b), _distance(points, b, c), _distance(points, c, a)
    return float(area / max(sides))


@kernel
def _turn(points: FloatArray, a: int, b: int, c: int) -> float:
    """Compute twice the signed area of a triangle."""
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    return float(ux * (points[c, 1] - points[a, 1]) - uy * (points[c, 0] - points[a, 0]))


@kernel
def _distance(points: FloatArray, a: int, b: int) -> float:
    """Compute the squared distance of two points."""
    return float((points[a, 0] - points[b, 0]) ** 2 + (points[a, 1] - points[b, 1]) ** 2)
