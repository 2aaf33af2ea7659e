"""What every reader returns, the words of text files, and polygons split into triangles."""

from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from abfm.reading import number
from abfm.types import BoolArray, FloatArray, IntArray

_MOST_CORNERS = 1 << 18  # of one polygon
# corners of polygons that are looked at together, as many as the processor's caches hold
_AT_A_TIME = 1 << 15
# squares of corners of polygons that are clipped, in all: some seconds
_MOST_WORK = 2e8
_WORK_OF_A_CORNER = 30
_FLATNESS = 1e-12  # twice the area over the longest side squared
_SPLIT = "split polygons into triangles in the program that made them"


class FileContents(NamedTuple):
    """Vertices (V, 3) in the file's order and count, triangles (F, 3), what was changed, and the
    hemisphere, "L" or "R", if the file names it.
    """

    vertices: FloatArray
    faces: IntArray
    messages: tuple[str, ...] = ()
    side: str = ""


class Lists:
    """What a text file gives one by one: 24 bytes a vertex, 8 for each polygon and corner."""

    def __init__(self) -> None:
        self._points, self._sizes, self._corners = array("d"), array("q"), array("q")

    @property
    def vertex_count(self) -> int:
        return len(self._points) // 3

    @property
    def polygon_count(self) -> int:
        return len(self._sizes)

    def add_vertex(self, words: Sequence[str]) -> None:
        if len(words) < 3:
            raise ValueError(
                f"vertex {self.vertex_count}, counting from 0, has {len(words)} coordinates "
                "instead of 3"
            )
        self._points.extend(map(number, words[:3]))

    def add_polygon(self, corners: Sequence[int]) -> None:
        try:
            self._corners.extend(corners)
        except OverflowError:
            raise ValueError(
                f"face {len(self._sizes)}, counting from 0, names a vertex beyond all numbers"
            ) from None
        self._sizes.append(len(corners))

    def vertices(self) -> FloatArray:
        return np.frombuffer(self._points, np.float64).reshape(-1, 3)

    def polygons(self) -> tuple[IntArray, IntArray]:
        """Return how many corners each has, and the corners of one after the other."""
        return np.frombuffer(self._sizes, np.int64), np.frombuffer(self._corners, np.int64)

    def contents(self) -> FileContents:
        return split_polygons(self.vertices(), *self.polygons())


def merge_by_position(vertices: FloatArray, faces: IntArray) -> FileContents:
    """Make vertices at exactly the same position one, numbered in order of first appearance."""
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.argsort(order)
    message = (
        f"{len(vertices)} vertices were merged to {len(first)} by position, "
        "and are counted in order of first appearance"
    )
    return FileContents(vertices[first[order]], rank[inverse.reshape(-1)][faces], (message,))


def split_polygons(vertices: FloatArray, sizes: IntArray, corners: IntArray) -> FileContents:
    """Split every polygon of more than three corners into triangles that lie in it.

    Where a fan around its first corner is right, as in every convex polygon, it is that. Others
    lose their ears one by one, the most even first, as seen along their mean normal. Those that
    cross themselves have no right split: they become fans, with a warning. A ValueError refuses
    what cannot be split in reasonable time. ``sizes`` (P,) are the numbers of corners, ``corners``
    (sum of sizes,) the vertices of one polygon after the other.
    """
    if np.all(sizes == 3):
        return FileContents(vertices, corners.reshape(-1, 3))
    if sizes.min() < 3:
        face = np.argmax(sizes < 3)
        raise ValueError(
            f"face {face}, counting from 0, has {sizes[face]} corners instead of 3 or more"
        )
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
    faces = np.empty((count, 3), dtype=np.int64)
    faces[:, 0] = np.repeat(corners[np.cumsum(sizes) - sizes], sizes - 2)
    place = np.repeat(2 * np.arange(len(sizes)), sizes - 2)
    place += np.arange(1, count + 1)
    for column in (1, 2):
        faces[:, column] = corners[place]
        place += 1
    split = "polygons with more than three corners were split into triangles"
    messages = [f"{split}: {np.sum(sizes > 3)}"]
    if corners.min() >= 0 and corners.max() < len(vertices):  # or the mesh is refused for it
        crossing = _clip(vertices, sizes, corners, faces)
        if len(crossing):
            messages.append(
                f"warning: {len(crossing)} of them cross themselves (for example face "
                f"{crossing[0]}, counting from 0), and were split from their first corner"
            )
    return FileContents(vertices, faces, tuple(messages))


def _clip(vertices: FloatArray, sizes: IntArray, corners: IntArray, faces: IntArray) -> IntArray:
    """Put better triangles into ``faces`` where fans are wrong; return the polygons without any."""
    ends = np.cumsum(sizes)
    first, work, crossing = 0, 0.0, [np.zeros(0, dtype=np.int64)]
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
            failed = clip_polygons(seen, its_corners, some, wrong, its_faces)
            crossing.append(first + np.flatnonzero(failed))
        first = last
    return np.concatenate(crossing)


def _wrong_fans(fans: FloatArray, sizes: IntArray) -> tuple[BoolArray, FloatArray]:
    """Return polygons (P,) with a triangle that is flat or looks away from their normals (P, 3).

    Those without a normal, which are flat as a whole, have no triangles that are better.
    """
    owner, starts = np.repeat(np.arange(len(sizes)), sizes - 2), np.cumsum(sizes - 2) - (sizes - 2)
    sides = [fans[:, k] - fans[:, k - 1] for k in range(3)]
    cross = np.cross(sides[0], sides[1])
    normals = np.add.reduceat(cross, starts)
    lengths = np.linalg.norm(normals, axis=1)
    longest = np.maximum.reduce([np.einsum("fx,fx->f", side, side) for side in sides])
    away = np.einsum("fx,fx->f", cross, normals[owner]) <= _FLATNESS * longest * lengths[owner]
    sized = lengths > _FLATNESS * np.maximum.reduceat(longest, starts)
    return (np.bincount(owner, away, len(sizes)) > 0) & sized & (sizes > 3), normals


def _seen_along(points: FloatArray, sizes: IntArray, normals: FloatArray) -> FloatArray:
    """Project the corners of polygons, (n, 2), so that they run counterclockwise."""
    axis = np.argmax(np.abs(normals), axis=1)
    turned = normals[np.arange(len(axis)), axis] < 0
    first = np.repeat(points[np.cumsum(sizes) - sizes], sizes, axis=0)
    columns = np.stack([axis + 1 + turned, axis + 2 - turned], axis=1) % 3
    return np.take_along_axis(points - first, np.repeat(columns, sizes, axis=0), axis=1)
