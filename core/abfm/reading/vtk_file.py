"""What VTK's files hold: points, polygons and point data, whatever format they are in."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.types import FloatArray, IntArray

Polygons = tuple[IntArray, IntArray]
"""Number of corners of each polygon, (P,), and the corners of one after the other."""

TRIANGLE = 5
STRIP = 6
POLYGON = 7
PIXEL = 8
QUAD = 9
_POINTS_AND_LINES = (0, 1, 2, 3, 4)
_VOLUMES = {10: "tetrahedra", 11: "voxels", 12: "hexahedra", 13: "wedges", 14: "pyramids"}


class PointData(Mapping[str, NDArray[Any]]):
    """Arrays by name, such as point data, (n, C); each is decoded when it is looked up.

    A ValueError reports a damaged array, or a name that several arrays have.
    """

    def __init__(self, arrays: Iterable[tuple[str, Callable[[], NDArray[Any]]]]) -> None:
        self._arrays: dict[str, list[Callable[[], NDArray[Any]]]] = {}
        for name, decode in arrays:
            self._arrays.setdefault(name, []).append(decode)

    def __getitem__(self, name: str) -> NDArray[Any]:
        found = self._arrays[name]
        if len(found) > 1:
            raise ValueError(
                f"{len(found)} of its arrays are called {brief(name)}: rename all but one"
            )
        return found[0]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)


class VtkFile(NamedTuple):
    """Points (n, 3), a function that returns the polygons, point data, and the time in the file.

    The time is NaN if there is none. ``polygons`` raises a ValueError if cells are damaged or do
    not belong to a surface; files of values need none.
    """

    points: FloatArray
    polygons: Callable[[], Polygons]
    point_data: PointData
    time: float = math.nan


def polygons_of_cells(sizes: IntArray, corners: IntArray, types: IntArray) -> Polygons:
    """Return the polygons among cells, in their order, strips as triangles.

    Cells that are points and lines are left out; a ValueError refuses volumes and curved cells.
    """
    known = (*_POINTS_AND_LINES, TRIANGLE, STRIP, POLYGON, PIXEL, QUAD)
    other = types[~np.isin(types, known)]
    if other.size:
        what = _VOLUMES.get(int(other[0]), f"cells of VTK's type {other[0]}")
        raise ValueError(
            f"it has {what}, which are not parts of a surface of polygons: extract the surface "
            "first (in ParaView: Extract Surface)"
        )
    is_kept = ~np.isin(types, _POINTS_AND_LINES)
    corners, sizes, types = corners[np.repeat(is_kept, sizes)], sizes[is_kept], types[is_kept]
    starts = np.cumsum(sizes) - sizes
    pixels = starts[(types == PIXEL) & (sizes == 4)]
    corners[pixels + 2], corners[pixels + 3] = corners[pixels + 3], corners[pixels + 2]
    strips = types == STRIP
    if not strips.any():
        return sizes, corners
    in_strips = np.repeat(strips, sizes)
    faces = triangles_of_strips(sizes[strips], corners[in_strips])
    others = sizes[~strips], corners[~in_strips]
    return (
        np.concatenate([others[0], np.full(len(faces), 3)]),
        np.concatenate([others[1], faces.ravel()]),
    )


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
