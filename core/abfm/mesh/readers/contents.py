"""Results of the mesh readers, and the splitting of polygons into triangles."""

from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from abfm.reading import number
from abfm.types import BoolArray, FloatArray, IntArray
from abfm.wording import counted

_CORNERS_MAX = 1 << 18  # largest number of corners of a polygon
_CHUNK_CORNERS = 1 << 15  # number of corners processed together; they fit the CPU caches
# limit of the sum of squared numbers of corners over clipped polygons; it takes some seconds
_WORK_MAX = 2e8
_WORK_PER_CORNER = 30
_FLATNESS = 1e-12  # of flat triangles: twice the area over the squared longest side
_SPLIT = "Split polygons into triangles in the program that made them"


class FileContents(NamedTuple):
    """Vertices (V, 3) with the order and count of a mesh file, and triangles (F, 3)."""

    vertices: FloatArray
    faces: IntArray
    messages: tuple[str, ...] = ()  # notes on changes, one line each
    side: str = ""  # the hemisphere, "L" or "R", if the file has this information


class Lists:
    """Vertices and polygons that are read one by one from a text file.

    The memory is 24 bytes a vertex, 8 a polygon and 8 a corner.
    """

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
            found = counted(len(words), "coordinate")
            raise ValueError(
                f"vertex {self.vertex_count}, counting from 0, has {found}; expected 3"
            )
        self._points.extend(map(number, words[:3]))

    def add_polygon(self, corners: Sequence[int]) -> None:
        try:
            self._corners.extend(corners)
        except OverflowError:
            raise ValueError(
                f"face {len(self._sizes)}, counting from 0, refers to a vertex number that does "
                "not fit in 64 bits"
            ) from None
        self._sizes.append(len(corners))

    def vertices(self) -> FloatArray:
        return np.frombuffer(self._points, np.float64).reshape(-1, 3)

    def polygons(self) -> tuple[IntArray, IntArray]:
        """Return the number of corners of each polygon, (P,), and the concatenated corners."""
        return np.frombuffer(self._sizes, np.int64), np.frombuffer(self._corners, np.int64)

    def contents(self) -> FileContents:
        return split_polygons(self.vertices(), *self.polygons())


def merge_by_position(vertices: FloatArray, faces: IntArray) -> FileContents:
    """Merge vertices at exactly the same position, numbered in order of first appearance."""
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.argsort(order)
    message = (
        f"{len(vertices)} vertices were merged to {len(first)} by position, and numbered in order "
        "of first appearance"
    )
    return FileContents(vertices[first[order]], rank[inverse.reshape(-1)][faces], (message,))


def split_polygons(vertices: FloatArray, sizes: IntArray, corners: IntArray) -> FileContents:
    """Split every polygon with more than three corners into triangles inside it.

    ``sizes`` (P,) are the numbers of corners of the polygons. ``corners`` (sum of sizes,) are their
    concatenated vertices. Convex polygons become a fan around their first corner. Polygons whose
    fan would be wrong are split by ear clipping, projected along their mean normal. Polygons that
    intersect themselves become fans, with a warning.

    Raises ValueError if a polygon has fewer than 3 corners, or the split would take too long.
    """
    if np.all(sizes == 3):
        return FileContents(vertices, corners.reshape(-1, 3))
    if sizes.min() < 3:
        face = np.argmax(sizes < 3)
        raise ValueError(
            f"face {face}, counting from 0, has {counted(sizes[face], 'corner')}; "
            "expected 3 or more"
        )
    if sizes.max() > _CORNERS_MAX:
        raise ValueError(
            f"face {np.argmax(sizes)}, counting from 0, has {sizes.max()} corners; at most "
            f"{_CORNERS_MAX} are supported. {_SPLIT}"
        )
    count = len(corners) - 2 * len(sizes)
    if 3 * count > len(vertices) * (len(vertices) - 1) and count > _CORNERS_MAX:
        raise ValueError(
            f"the polygons have {count} triangles on {len(vertices)} vertices, which is too many: "
            "some repeat, or some edges have more than two faces"
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
    if corners.min() >= 0 and corners.max() < len(vertices):  # else a later check raises an error
        crossing = _clip(vertices, sizes, corners, faces)
        if len(crossing):
            phrases = "polygon intersects itself", "polygons intersect themselves"
            messages.append(
                f"warning: {counted(len(crossing), *phrases)} (for example face {crossing[0]}, "
                "counting from 0). Such polygons were split into fans around their first corner"
            )
    return FileContents(vertices, faces, tuple(messages))


def _clip(vertices: FloatArray, sizes: IntArray, corners: IntArray, faces: IntArray) -> IntArray:
    """Replace the triangles in ``faces`` of polygons whose fan is wrong by those of ear clipping.

    Return the indices of polygons that intersect themselves, whose triangles are not changed.
    """
    ends = np.cumsum(sizes)
    first, work, crossing = 0, 0.0, [np.zeros(0, dtype=np.int64)]
    while first < len(sizes):
        start = ends[first] - sizes[first]
        last = max(int(np.searchsorted(ends, start + _CHUNK_CORNERS)), first + 1)
        some, its_corners = sizes[first:last], corners[start : ends[last - 1]]
        its_faces = faces[start - 2 * first : ends[last - 1] - 2 * last]
        wrong, normals = _wrong_fans(vertices.take(its_faces, axis=0), some)
        if wrong.any():
            work += float(np.sum(some[wrong].astype(np.float64) ** 2))
            if work > max(_WORK_MAX, _WORK_PER_CORNER * len(corners)):
                raise ValueError(
                    "the file has too many concave polygons (the largest has "
                    f"{some[wrong].max()} corners). {_SPLIT}"
                )
            # imported here as it is compiled, and few files need it
            from abfm.mesh.readers.ear_clipping import clip_polygons

            projected = _projected(vertices[its_corners], some, normals)
            failed = clip_polygons(projected, its_corners, some, wrong, its_faces)
            crossing.append(first + np.flatnonzero(failed))
        first = last
    return np.concatenate(crossing)


def _wrong_fans(fans: FloatArray, sizes: IntArray) -> tuple[BoolArray, FloatArray]:
    """Return which polygons have a wrong fan, (P,), and the normals of all polygons, (P, 3).

    A fan is wrong if one of its triangles is flat, or if the normal of a triangle is opposite to
    that of the polygon. The fans of polygons without area are accepted.
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


def _projected(points: FloatArray, sizes: IntArray, normals: FloatArray) -> FloatArray:
    """Return the counterclockwise corners (n, 2) of polygons in coordinate planes.

    The plane of a polygon is chosen by its normal.
    """
    axis = np.argmax(np.abs(normals), axis=1)
    turned = normals[np.arange(len(axis)), axis] < 0
    first = np.repeat(points[np.cumsum(sizes) - sizes], sizes, axis=0)
    columns = np.stack([axis + 1 + turned, axis + 2 - turned], axis=1) % 3
    return np.take_along_axis(points - first, np.repeat(columns, sizes, axis=0), axis=1)
