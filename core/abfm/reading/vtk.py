"""Reader of VTK files with one grid: .vtk, .vtp and .vtu."""

from abfm.reading.opening import Format, Opened
from abfm.reading.vtk_file import VtkFile
from abfm.reading.vtk_legacy import legacy_contents
from abfm.reading.vtk_xml import xml_contents


def vtk_contents(opened: Opened) -> VtkFile:
    """Read the points, polygons, point data and time of a file; ValueError if it is invalid."""
    readers = {Format.VTK_LEGACY: legacy_contents, Format.VTK_XML: xml_contents}
    if opened.format not in readers:
        raise ValueError(f"the file is {opened.format}; expected a VTK file")
    return readers[opened.format](opened.data)
