"""VTK XML files in all forms that ParaView writes, and errors for damaged ones."""

import re
from base64 import b64decode
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from abfm.errors import FunctionError
from abfm.functions import read_values
from abfm.io import export_vtu
from abfm.reading import open_file, read_collection, vtk_contents, vtk_xml
from tests.core.reading.hostile import bomb
from tests.core.reading.vtk_files import COMPRESSORS, point_data, vtk_bytes
from tests.messages import raises
from tests.shapes import tetrahedron

RANDOM = np.random.default_rng(0)
POINTS = RANDOM.normal(size=(9, 3))
DATA = {
    "speed": RANDOM.normal(size=9).astype(np.float32),
    "field": RANDOM.normal(size=(9, 3)),
    "label": RANDOM.integers(-9, 9, 9).astype(np.int16),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("vtk")


def written(folder, content, name="a.vtu"):
    (folder / name).write_bytes(content)
    return folder / name


@pytest.mark.parametrize("compressor", COMPRESSORS)
@pytest.mark.parametrize("form", ["ascii", "binary", "base64", "raw"])
def test_all_forms_of_arrays_are_read(folder, form, compressor):
    kinds = ("UnstructuredGrid", "PolyData")
    for head, order, kind, together in product(("u4", "u8"), "<>", kinds, (False, True)):
        if together and compressor:
            continue  # a combination that no program writes
        content = vtk_bytes(POINTS, DATA, form, compressor, head, order, kind, together, 2.5)
        path = written(folder, content)
        for name, values in DATA.items():
            file = vtk_contents(open_file(path))
            assert_array_equal(file.points, POINTS)
            found = file.point_data[name]
            assert_array_equal(found, values.reshape(9, -1).astype(np.float64))
            assert (found.dtype, file.time) == (np.float64, 2.5)


def test_only_last_time_is_decoded(folder, monkeypatch):
    """Of repeated time arrays only the last is decoded, as decoding may copy the entire file."""
    decoded = []
    monkeypatch.setattr(vtk_xml, "_unpacked", lambda text: decoded.append(1) or b64decode(text))
    field = [vtk_bytes(POINTS, DATA, "base64", time=k) for k in (1.0, 2.0)]
    array = re.compile(rb'<DataArray[^>]*Name="TimeValue".*?(/>|</DataArray>)', re.DOTALL)
    one = array.search(field[1]).group()
    assert vtk_contents(open_file(written(folder, field[1]))).time == 2.0
    count = len(decoded)
    path = written(folder, field[1].replace(one, 50 * one))
    assert vtk_contents(open_file(path)).time == 2.0
    assert len(decoded) == 2 * count


def test_pyevtk_files_are_read(folder):
    mesh, values = tetrahedron(), np.arange(4.0)
    export_vtu(folder / "b.vtu", mesh, {"only": values}, {"cells": np.zeros(4)})
    file = vtk_contents(open_file(folder / "b.vtu"))
    assert_array_equal(file.points, mesh.vertices)
    assert [*file.point_data] == ["only"]
    assert_array_equal(file.point_data["only"][:, 0], values)
    assert np.isnan(file.time)


def test_collections_have_times_and_files(folder):
    text = (
        '<VTKFile type="Collection"><Collection><DataSet timestep="1e-1" part="0" file="a/b.vtu"/>'
        '<DataSet timestep="2" group="" file="c.vtu"/></Collection></VTKFile>'
    )
    found = read_collection(written(folder, text.encode(), "a.pvd"))
    assert found == [(0.1, "a/b.vtu"), (2.0, "c.vtu")]


RAW = vtk_bytes(POINTS, {"a": POINTS[:, 0]}, "raw")
ASCII = vtk_bytes(POINTS, {"a": POINTS[:, 0]}, "ascii")
HUGE = vtk_bytes(POINTS, {"a": POINTS[:, 0]}, "raw", "vtkZLibDataCompressor").replace(
    b'NumberOfPoints="9"', b'NumberOfPoints="999999999999"'
)
PACKED = bomb(1 << 24)
BOMB = (
    b'<VTKFile type="PolyData" compressor="vtkZLibDataCompressor"><PolyData><Piece '
    b'NumberOfPoints="9"><PointData><DataArray type="Float64" Name="a" format="appended" '
    b'offset="0"/></PointData><Points><DataArray type="Float64" NumberOfComponents="3" '
    b'format="appended" offset="0"/></Points></Piece></PolyData><AppendedData encoding="raw">_'
    + np.array([1, 216, 0, len(PACKED)], "<u4").tobytes()
    + PACKED
    + b"</AppendedData></VTKFile>"
)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"", ("file", "empty")),
        (b"<GIFTI/>", ("GIFTI", "VTK")),
        (b'<VTKFile type="ImageData"/>', ("ImageData", "VTK", "UnstructuredGrid")),
        (b'<VTKFile type="PolyData"/>', (0,)),
        (b'<!DOCTYPE VTKFile [<!ATTLIST DataArray b CDATA "c">]><VTKFile/>', ("<!DOCTYPE",)),
        (RAW.replace(b'"9"', b'"8"', 1), (216, 192)),
        (RAW.replace(b'"9"', b'"-9"', 1), ("NumberOfPoints", -9)),
        (RAW.replace(b'"9"', b'"0"', 1), (0,)),
        (RAW.replace(b'offset="0"', b'offset="99999"'), ()),
        (RAW.replace(b"UInt32", b"Int32", 1), ("Int32", "header_type", "UInt32", "UInt64")),
        (RAW.replace(b"LittleEndian", b"MiddleEndian"), ("MiddleEndian", "byte_order")),
        (RAW.replace(b'"Float64"', b'"String"', 1), ("String",)),
        (RAW.replace(b'"appended"', b'"scattered"', 1), ("scattered",)),
        (RAW[: RAW.index(b"</AppendedData")], ()),
        (
            RAW.replace(b" byte", b' compressor="vtkLZ4DataCompressor" byte'),
            ("vtkLZ4DataCompressor",),
        ),
        (RAW.replace(b'Components="3"', b'Components="2"'), (144,)),
        (HUGE, ()),
        (BOMB, (216,)),
        (ASCII.replace(b'"9"', b'"8"', 1), (27, 24)),
        (ASCII.replace(b"\n-", b"\nx-").replace(b"\n0", b"\nx0"), ()),
    ],
)
def test_inconsistent_files_are_refused(folder, content, named):
    with raises(ValueError, *named) as caught:
        point_data(written(folder, content), "a")
    assert len(str(caught.value)) < 300
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('<VTKFile type="PolyData"/>', ""),
        ('<VTKFile type="Collection"><DataSet timestep="x" file="a"/></VTKFile>', "x"),
        ('<VTKFile type="Collection"><DataSet timestep="1"/></VTKFile>', ""),
    ],
)
def test_invalid_collections_are_refused(folder, text, named):
    with raises(ValueError, named):
        read_collection(written(folder, text.encode(), "a.pvd"))


def test_unknown_array_error_lists_the_arrays(folder):
    path = written(folder, vtk_bytes(POINTS, DATA))
    with raises(FunctionError, "sped", "speed"):
        read_values(path, column="sped")
