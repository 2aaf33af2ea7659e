"""Contents of VTK files of all formats: points, polygons and point data."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.types import FloatArray, IntArray

Polygons = tuple[IntArray, IntArray]
"""Number of corners of each polygon, (P,), and the concatenated corners."""

TRIANGLE = 5
STRIP = 6
POLYGON = 7
PIXEL = 8
QUAD = 9
_POINTS_AND_LINES = (0, 1, 2, 3, 4)
_VOLUMES = {10: "tetrahedra", 11: "voxels", 12: "hexahedra", 13: "wedges", 14: "pyramids"}


class PointData(Mapping[str, NDArray[Any]]):
    """Arrays at the points by name, such as (n, C), decoded on access.

    Access raises a ValueError if an array is damaged, or if several arrays have the name.
    """

    def __init__(self, arrays: Iterable[tuple[str, Callable[[], NDArray[Any]]]]) -> None:
        self._arrays: dict[str, list[Callable[[], NDArray[Any]]]] = {}
        for name, decode in arrays:
            self._arrays.setdefault(name, []).append(decode)

    def __getitem__(self, name: str) -> NDArray[Any]:
        found = self._arrays[name]
        if len(found) > 1:
            raise ValueError(f"{len(found)} arrays are named {brief(name)}. Rename all but one")
        return found[0]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)


class VtkFile(NamedTuple):
    """Contents of a VTK file: points (n, 3), polygons, point data, and time or NaN.

    The function ``polygons`` returns the polygons, or raises a ValueError if cells are damaged or
    not part of a surface. Files of values may have no polygons.
    """

    points: FloatArray
    polygons: Callable[[], Polygons]
    point_data: PointData
    time: float = math.nan


def polygons_of_cells(sizes: IntArray, corners: IntArray, types: IntArray) -> Polygons:
    """Return the polygons among cells, in their order; strips become triangles.

    Points and lines are ignored. Volumes and curved cells raise a ValueError.
    """
    supported = (*_POINTS_AND_LINES, TRIANGLE, STRIP, POLYGON, PIXEL, QUAD)
    other = types[~np.isin(types, supported)]
    if other.size:
        what = _VOLUMES.get(int(other[0]), f"cells of VTK type {other[0]}")
        raise ValueError(
            f"the file has {what}; expected a surface of polygons. Extract the surface first (in "
            "ParaView: Extract Surface)"
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
    all_sizes = np.concatenate([others[0], np.full(len(faces), 3)])
    return all_sizes, np.concatenate([others[1], faces.ravel()])


def triangles_of_strips(sizes: IntArray, corners: IntArray) -> IntArray:
    """Return the triangles (F, 3) of strips, with the orientation of the first one of each strip.

    ``sizes`` (S,) are the numbers of corners of the strips, and ``corners`` (sum of sizes,) their
    concatenated vertices. Triangles with a vertex twice only connect parts of a strip; they are
    omitted.
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
