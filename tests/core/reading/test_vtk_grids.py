"""VTK grids as surfaces: cells of legacy and XML files, and data of legacy files."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from abfm.reading import open_file, vtk_contents
from tests.core.reading.vtk_files import point_data
from tests.mesh_writers import write
from tests.messages import raises

POINTS = np.array([[x, y, 0] for x in range(4) for y in range(2)], dtype=np.float64)
POLYGONS = [[0, 2, 1], [1, 2, 3], [2, 4, 5, 3]]
STRIP = [4, 6, 5, 7]
FACES = [[0, 2, 1], [1, 2, 3], [2, 4, 5], [2, 5, 3], [4, 6, 5], [6, 7, 5]]
DATA = np.arange(8, dtype=np.float64) / 4
LINE = [0, 1]
TRIANGLE, QUAD, PIXEL, STRIPS, POLY_LINE, TETRAHEDRON = 5, 9, 8, 6, 4, 10


class Legacy:
    """Writer of a legacy file, text or big-endian, with old or new cells."""

    def __init__(self, kind, is_text, is_new):
        self.is_text, self.is_new = is_text, is_new
        form = "ASCII" if is_text else "BINARY"
        self.content = f"# vtk DataFile Version 5.1\na title\n{form}\nDATASET {kind}\n".encode()

    def line(self, text):
        self.content += f"{text}\n".encode()

    def numbers(self, values, code):
        values = np.asarray(values)
        if self.is_text:
            self.line("\n".join(map(str, values.ravel().tolist())))
        else:
            self.content += values.astype(f">{code}").tobytes() + b"\n"

    def strings(self, texts):
        """Write texts as lines, or after lengths of 1, 2 or 4 bytes, depending on two bits."""
        for text in texts:
            size = len(text)
            kind, width = (3, 1) if size < 1 << 6 else (2, 2) if size < 1 << 14 else (1, 4)
            head = (kind << (8 * width - 2) | size).to_bytes(width, "big")
            self.content += (b"" if self.is_text else head) + text.encode() + b"\n" * self.is_text
        self.content += b"\n"

    def cells(self, keyword, cells):
        flat = [corner for cell in cells for corner in cell]
        if not self.is_new:
            self.line(f"{keyword} {len(cells)} {len(cells) + len(flat)}")
            return self.numbers([n for cell in cells for n in (len(cell), *cell)], "i4")
        self.line(f"{keyword} {len(cells) + 1} {len(flat)}\nOFFSETS vtktypeint64")
        self.numbers(np.cumsum([0, *map(len, cells)]), "i8")
        self.line("CONNECTIVITY vtktypeint64")
        return self.numbers(flat, "i8")


def legacy(kind="POLYDATA", is_text=True, is_new=False):
    """Return a surface with all kinds of cells, point and cell data, a time and metadata."""
    file = Legacy(kind, is_text, is_new)
    file.line("FIELD FieldData 1\nTimeValue 1 1 double")
    file.numbers([2.5], "f8")
    file.line(f"POINTS {len(POINTS)} double")
    file.numbers(POINTS, "f8")
    file.line("METADATA\nINFORMATION 1\nNAME L2 LOCATION vtkDataArray\nDATA 2 0 1\n")
    if kind == "POLYDATA":
        file.cells("LINES", [LINE])
        file.cells("POLYGONS", POLYGONS)
        file.cells("TRIANGLE_STRIPS", [STRIP])
    else:
        pixel = [2, 4, 3, 5]
        file.cells("CELLS", [LINE, *POLYGONS[:2], pixel, STRIP])
        file.line("CELL_TYPES 5")
        file.numbers([POLY_LINE, TRIANGLE, TRIANGLE, PIXEL, STRIPS], "i4")
    file.line("CELL_DATA 5\nSCALARS of_cells int 1")
    file.numbers(range(5), "i4")
    file.line("POINT_DATA 8\nSCALARS a%20b float\nLOOKUP_TABLE own")
    file.numbers(DATA, "f4")
    file.line("LOOKUP_TABLE own 2")
    file.numbers(np.ones(8), "u1")
    file.line("VECTORS v double")
    file.numbers(POINTS, "f8")
    file.line("FIELD FieldData 3\nf 1 8 int")
    file.numbers(range(8), "i4")
    file.line("names 1 8 string")
    file.strings(["", "POINTS 9 float", "x" * 100, "y" * 20_000, *"abcd"])
    file.line("METADATA\nCOMPONENT_NAMES\nx\n\ng 2 8 unsigned_char")
    file.numbers(np.arange(16), "u1")
    return file.content


FORMS = [
    (kind, is_text, is_new)
    for kind in ("POLYDATA", "UNSTRUCTURED_GRID")
    for is_text in (True, False)
    for is_new in (True, False)
]


@pytest.mark.parametrize(("kind", "is_text", "is_new"), FORMS)
def test_legacy_files_are_read(tmp_path, kind, is_text, is_new):
    path = write(tmp_path, "a.vtk", legacy(kind, is_text, is_new))
    mesh = load_mesh(path)
    assert_array_equal(mesh.vertices, POINTS)
    assert mesh.faces.tolist() == FACES
    file = vtk_contents(open_file(path))
    assert file.time == 2.5
    assert list(file.point_data) == ["a b", "v", "f", "g"]
    assert_array_equal(file.point_data["a b"], DATA[:, None])
    assert_array_equal(file.point_data["v"], POINTS)
    assert_array_equal(file.point_data["f"][:, 0], range(8))
    assert_array_equal(file.point_data["g"], np.arange(16).reshape(8, 2))
    assert_array_equal(point_data(path, "v"), POINTS)


LEGACY, NEW = legacy(), legacy(is_new=True)
REFUSED_LEGACY = {
    "words": (b"# vtk DataFile\nhello\nworld\n", ("world", "ASCII", "BINARY")),
    "no lines": (b"# vtk DataFile", ()),
    "no dataset": (b"# vtk DataFile\n\nASCII\n", ("DATASET",)),
    "image": (LEGACY.replace(b"POLYDATA", b"STRUCTURED_POINTS"), ("STRUCTURED_POINTS",)),
    "bits": (LEGACY.replace(b"f 1 8 int", b"f 1 8 bit"), ("bit",)),
    "texts beyond": (LEGACY.replace(b"names 1 8", b"names 1 999"), (999,)),
    "unknown": (LEGACY.replace(b"VECTORS", b"VICTORS"), ("VICTORS",)),
    "few words": (LEGACY.replace(b"POINTS 8 double", b"POINTS 8"), ()),
    "many points": (LEGACY.replace(b"POINTS 8", b"POINTS 99999999999"), ()),
    "negative": (LEGACY.replace(b"POINTS 8", b"POINTS -8"), (-8,)),
    "cells beyond": (LEGACY.replace(b"POLYGONS 3", b"POLYGONS 4"), (4,)),
    "begins late": (NEW.replace(b"int64\n0", b"int64\n1"), ("offsets", 0)),
    "goes down": (NEW.replace(b"\n3\n6\n10", b"\n6\n3\n10"), ("offsets", 0, 10)),
    "few values": (LEGACY[:-8], (16,)),
    "decimal comma": (LEGACY.replace(b"\n0.25", b"\n0,25"), ("0,25", "decimal")),
    "tetrahedron": (
        legacy("UNSTRUCTURED_GRID").replace(b"4\n5\n5\n8\n6", b"4\n5\n5\n10\n6"),
        ("tetrahedra",),
    ),
    "curved": (legacy("UNSTRUCTURED_GRID").replace(b"4\n5\n5\n8\n6", b"4\n5\n5\n23\n6"), (23,)),
}


@pytest.mark.parametrize(("content", "named"), REFUSED_LEGACY.values(), ids=REFUSED_LEGACY)
def test_invalid_legacy_files_are_refused(tmp_path, content, named):
    with raises(MeshError, *named) as caught:
        load_mesh(write(tmp_path, "a.vtk", content))
    assert "\n" not in str(caught.value)


def test_values_of_volumes_need_no_surface(tmp_path):
    content = legacy("UNSTRUCTURED_GRID").replace(b"4\n5\n5\n8\n6", b"4\n5\n5\n10\n6")
    assert_array_equal(point_data(write(tmp_path, "a.vtk", content), "v"), POINTS)


def _array(name, values):
    values = np.asarray(values)
    kind = "Float64" if values.dtype.kind == "f" else "Int64"
    columns = values.shape[1] if values.ndim > 1 else 1
    words = " ".join(map(str, values.ravel().tolist()))
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{columns}" format="ascii">'
        f"{words}</DataArray>"
    )


def _cells(place, cells, types=()):
    arrays = [
        _array("connectivity", [corner for cell in cells for corner in cell]),
        _array("offsets", np.cumsum([len(cell) for cell in cells])),
        *([_array("types", types)] if len(types) else []),
    ]
    return f"<{place}>{''.join(arrays)}</{place}>"


def xml(kind="PolyData", data="", types=(POLY_LINE, TRIANGLE, TRIANGLE, QUAD, STRIPS)):
    """Return the same surface as an XML file."""
    counts = 'NumberOfCells="5"'
    cells = _cells("Cells", [LINE, *POLYGONS, STRIP], types)
    if kind == "PolyData":
        counts = 'NumberOfLines="1" NumberOfPolys="3" NumberOfStrips="1"'
        cells = _cells("Lines", [LINE]) + _cells("Strips", [STRIP]) + _cells("Polys", POLYGONS)
    return (
        f'<VTKFile type="{kind}"><{kind}><Piece NumberOfPoints="8" {counts}><PointData>{data}'
        f"</PointData><Points>{_array('Points', POINTS)}</Points>{cells}</Piece></{kind}></VTKFile>"
    )


@pytest.mark.parametrize(("kind", "ending"), [("PolyData", "vtp"), ("UnstructuredGrid", "vtu")])
def test_xml_files_are_read(tmp_path, kind, ending):
    mesh = load_mesh(write(tmp_path, f"a.{ending}", xml(kind)))
    assert_array_equal(mesh.vertices, POINTS)
    assert mesh.faces.tolist() == FACES


def test_repeated_array_name_is_refused_on_access(tmp_path):
    data = _array("f", DATA) + _array("f", 2 * DATA) + _array("g", DATA)
    path = write(tmp_path, "a.vtp", xml(data=data))
    assert len(load_mesh(path).faces) == 6
    assert_array_equal(point_data(path, "g")[:, 0], DATA)
    with raises(ValueError, "f", 2):
        point_data(path, "f")


XML = xml("UnstructuredGrid")
REFUSED_XML = {
    "no types": (xml("UnstructuredGrid", types=()), ("types",)),
    "no offsets": (XML.replace("offsets", "ends"), ("offsets",)),
    "volumes": (xml("UnstructuredGrid", types=(TETRAHEDRON,) * 5), ("tetrahedra",)),
    "down": (XML.replace("2 5 8", "5 2 8"), ("offsets",)),
    "few corners": (XML.replace("4 6 5 7", "4 6 5"), (15, 16)),
    "points twice": (XML.replace("<Points>", "<Points>" + _array("p", POINTS)), (2,)),
    "more cells": (XML.replace('NumberOfCells="5"', 'NumberOfCells="6"'), (5, 6)),
}


@pytest.mark.parametrize(("content", "named"), REFUSED_XML.values(), ids=REFUSED_XML)
def test_invalid_xml_files_are_refused(tmp_path, content, named):
    with raises(MeshError, *named):
        load_mesh(write(tmp_path, "a.vtu", content))
