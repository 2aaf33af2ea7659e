"""Polygons of more than three corners, split into triangles."""

import numpy as np

from abfm.mesh.readers.contents import FileContents
from abfm.types import BoolArray, FloatArray, IntArray

_MOST_CORNERS = 1 << 18  # of one polygon
# corners of polygons that are looked at together, as many as the processor's caches hold
_AT_A_TIME = 1 << 15
# squares of corners of polygons that are clipped, in all: some seconds
_MOST_WORK, _WORK_OF_A_CORNER = 2e8, 30
_FLAT = 1e-12  # twice the area over the longest side squared
_SPLIT = "split polygons into triangles in the program that made them"


def split_polygons(vertices: FloatArray, sizes: IntArray, corners: IntArray) -> FileContents:
    """Return the contents with every polygon of more than three corners split into triangles that
    lie in it.

    Where a fan around its first corner is right, as in every convex polygon, it is that. Others
    lose their ears one by one, the most even first, as seen along their mean normal. Those that
    cross themselves have no right split: they become fans, with a warning.

    Parameters
    ----------
    vertices : (V, 3) array
    sizes : (P,) array
        Numbers of corners, at least three.
    corners : (sum of sizes,) array
        Vertices of one polygon after the other.

    Raises
    ------
    ValueError
        If a polygon, or those that are no fans together, have too many corners to be split in
        reasonable time.
    """
    if np.all(sizes == 3):
        return FileContents(vertices, corners.reshape(-1, 3))
    if sizes.max() > _MOST_CORNERS:
        raise ValueError(
            f"face {np.argmax(sizes)}, counting from 0, has {sizes.max()} corners: {_SPLIT}"
        )
    count = len(corners) - 2 * len(sizes)
    if 3 * count > len(vertices) * (len(vertices) - 1) and count > _MOST_CORNERS:
        raise ValueError(
            f"its polygons come to {count} triangles on {len(vertices)} vertices: they repeat, or "
            "have edges with more than two faces"
        )
    faces = _fans(sizes, corners)
    messages = [
        f"polygons with more than three corners were split into triangles: {np.sum(sizes > 3)}"
    ]
    if corners.min() >= 0 and corners.max() < len(vertices):  # or the mesh is refused for it
        crossing = _clip(vertices, sizes, corners, faces)
        if len(crossing):
            messages.append(
                f"warning: {len(crossing)} of them cross themselves (for example face "
                f"{crossing[0]}, counting from 0), and were split from their first corner"
            )
    return FileContents(vertices, faces, tuple(messages))


def _fans(sizes: IntArray, corners: IntArray) -> IntArray:
    """Compute triangles (sum of sizes - 2, 3) around the first corner of each polygon."""
    counts = sizes - 2
    starts = np.repeat(np.cumsum(sizes) - sizes, counts)
    second = np.arange(len(starts)) + 1 + 2 * np.repeat(np.arange(len(sizes)), counts)
    return np.stack([corners[starts], corners[second], corners[second + 1]], axis=1).astype(
        np.int64
    )


def _clip(vertices: FloatArray, sizes: IntArray, corners: IntArray, faces: IntArray) -> IntArray:
    """Put better triangles into ``faces`` where fans are wrong; return the numbers of the polygons
    that have none.
    """
    ends = np.cumsum(sizes)
    first, work, crossing = 0, 0.0, []
    while first < len(sizes):  # some polygons at a time, so that little memory is taken
        start = ends[first] - sizes[first]
        last = max(int(np.searchsorted(ends, start + _AT_A_TIME)), first + 1)
        some, its_corners = sizes[first:last], corners[start : ends[last - 1]]
        its_faces = faces[start - 2 * first : ends[last - 1] - 2 * last]
        wrong, normals = _wrong_fans(vertices.take(its_faces, axis=0), some)
        if wrong.any():
            work += float(np.sum(some[wrong].astype(np.float64) ** 2))
            if work > max(_MOST_WORK, _WORK_OF_A_CORNER * len(corners)):
                raise ValueError(
                    f"its concave polygons, one with {some[wrong].max()} corners, are too many: "
                    f"{_SPLIT}"
                )
            # compiled, which few files need
            from abfm.mesh.readers.ear_clipping import clip_polygons

            seen = _seen_along(vertices[its_corners], some, normals)
            crossing.append(
                first + np.flatnonzero(clip_polygons(seen, its_corners, some, wrong, its_faces))
            )
        first = last
    return np.concatenate([np.zeros(0, dtype=np.int64), *crossing])


def _wrong_fans(fans: FloatArray, sizes: IntArray) -> tuple[BoolArray, FloatArray]:
    """Return polygons (P,) with a triangle of their fan that is flat or looks away from their
    normals, and these (P, 3).

    Those without a normal, which are flat as a whole, have no triangles that are better.
    """
    owner = np.repeat(np.arange(len(sizes)), sizes - 2)
    sides = [fans[:, k] - fans[:, k - 1] for k in range(3)]
    cross = np.cross(sides[0], sides[1])
    normals = np.add.reduceat(cross, np.cumsum(sizes - 2) - (sizes - 2))
    lengths = np.linalg.norm(normals, axis=1)
    longest = np.maximum.reduce([np.einsum("fx,fx->f", side, side) for side in sides])
    away = np.einsum("fx,fx->f", cross, normals[owner]) <= _FLAT * longest * lengths[owner]
    sized = lengths > _FLAT * np.maximum.reduceat(longest, np.cumsum(sizes - 2) - (sizes - 2))
    return (np.bincount(owner, away, len(sizes)) > 0) & sized & (sizes > 3), normals


def _seen_along(points: FloatArray, sizes: IntArray, normals: FloatArray) -> FloatArray:
    """Project the corners of polygons, (n, 2), so that they run counterclockwise."""
    axis = np.argmax(np.abs(normals), axis=1)
    turned = normals[np.arange(len(axis)), axis] < 0
    first = np.repeat(points[np.cumsum(sizes) - sizes], sizes, axis=0)
    columns = (
        np.stack(
            [np.where(turned, axis + 2, axis + 1), np.where(turned, axis + 1, axis + 2)], axis=1
        )
        % 3
    )
    return np.take_along_axis(points - first, np.repeat(columns, sizes, axis=0), axis=1)
