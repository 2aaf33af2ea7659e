"""Triangulation of plane polygons by ear clipping.

An ear is a corner whose triangle contains no other corner [Meisters, "Polygons have ears", 1975].
``mapbox_earcut`` is not used: it drops corners on straight sides, which leaves cracks between
polygons, and it does not report polygons that intersect themselves.
"""

import numpy as np

from abfm.numerics.kernels import kernel
from abfm.types import BoolArray, FloatArray, IndexArray


@kernel
def clip_polygons(
    points: FloatArray,
    corners: IndexArray,
    sizes: IndexArray,
    requested: BoolArray,
    faces: IndexArray,
) -> BoolArray:
    """Write the triangles of the requested polygons (P,) to ``faces`` (n - 2 P, 3).

    ``points`` (n, 2) are the concatenated corners of the polygons, each in counterclockwise order,
    and ``corners`` (n,) their vertex numbers. A polygon with k corners (``sizes``) has k - 2 rows
    in ``faces``. Return whether each polygon (P,) failed because it intersects itself. The
    triangles of failed polygons are not changed.
    """
    failed = np.zeros(sizes.size, dtype=np.bool_)
    start, face = 0, 0
    for polygon in range(sizes.size):
        count = sizes[polygon]
        if requested[polygon]:
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
    """Return the triangles (n - 2, 3) of one polygon with corners (n, 2) by ear clipping.

    The most even ear is cut first. Flat ears wait, because cutting their neighbours may improve
    them. A simple polygon always has an ear. For one that intersects itself, the result has fewer
    triangles if no ear remains. The time grows with the square of n.
    """
    count = len(points)
    before, after = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    for k in range(count):
        before[k], after[k] = k - 1 if k else count - 1, k + 1 if k + 1 < count else 0
    evenness = np.empty(count)
    for k in range(count):
        evenness[k] = _ear(points, before[k], k, after[k], after)
    triangles = np.empty((count - 2, 3), dtype=np.int64)
    found, start = 0, 0
    while found < count - 2:
        best = k = start
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
        start = a
    return triangles[:found]


@kernel
def _ear(points: FloatArray, a: int, b: int, c: int, after: IndexArray) -> float:
    """Return the evenness of the triangle a, b, c if it is an ear of the polygon; 0 if not.

    Evenness is twice the area over the square of the longest side. ``after`` is the next remaining
    corner of each corner.
    """
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
    """Return twice the signed area of the triangle a, b, c; positive if counterclockwise."""
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    return float(ux * (points[c, 1] - points[a, 1]) - uy * (points[c, 0] - points[a, 0]))


@kernel
def _distance(points: FloatArray, a: int, b: int) -> float:
    return float((points[a, 0] - points[b, 0]) ** 2 + (points[a, 1] - points[b, 1]) ** 2)
