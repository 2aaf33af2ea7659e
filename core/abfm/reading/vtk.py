"""Files of VTK of all formats that hold one grid: .vtk, .vtp and .vtu."""

import os
from typing import NamedTuple

from abfm.errors import SeveralArraysError, brief, did_you_mean, one_line
from abfm.reading.opening import Format, Opened, open_file
from abfm.reading.vtk_file import VtkFile
from abfm.reading.vtk_legacy import legacy_contents
from abfm.reading.vtk_xml import xml_contents
from abfm.types import FloatArray


class Grid(NamedTuple):
    """Points (n, 3) of a file, one array of its point data (n, C), and what that is called.

    ``time`` is the ``TimeValue`` of the file, NaN if it has none.
    """

    points: FloatArray
    values: FloatArray
    name: str
    time: float


def vtk_contents(opened: Opened) -> VtkFile:
    """Read points, polygons, point data and time of a file; a ValueError reports what is wrong."""
    readers = {Format.VTK_LEGACY: legacy_contents, Format.VTK_XML: xml_contents}
    if opened.format not in readers:
        raise ValueError(f"it is {opened.format}; expected a file of VTK")
    return readers[opened.format](opened.data)


def read_grid(path: str | os.PathLike[str], name: str | None = None) -> Grid:
    """Read points and an array of point data; without a name there must be only one.

    An OSError reports that the file cannot be read, a ValueError what is wrong with it.
    """
    file = vtk_contents(open_file(path))
    names = list(file.point_data)
    listed = ", ".join(one_line(each, 30) for each in names[:8]) or "none"
    if name is None and len(names) != 1:
        text = f"it has {len(names)} arrays of point data: {listed}; choose one of them"
        raise SeveralArraysError(text, names) if names else ValueError(text)
    chosen = names[0] if name is None else name
    if chosen not in names:
        raise ValueError(
            f"it has no point data {brief(chosen)}{did_you_mean(chosen, names)}; there is {listed}"
        )
    return Grid(file.points, file.point_data[chosen], chosen, file.time)
