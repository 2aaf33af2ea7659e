"""Exports for other programs."""

import csv
import os
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal

from abfm.errors import ResultError
from abfm.io import export_energy_csv, export_ply, export_vtu
from tests.shapes import tetrahedron, torus

MESH = torus(7, 5)
RANDOM = np.random.default_rng(3)
F, COLOURS, MAP = (RANDOM.normal(size=shape) for shape in (35, (35, 4), (35, 3)))
AREA, VELOCITY = RANDOM.uniform(size=70), RANDOM.normal(size=(70, 3))


def read_vtu(path):
    """Every array of a VTU file with raw appended data, by name, as the format describes it."""
    head, _, data = path.read_bytes().partition(b'<AppendedData encoding="raw">')
    data = data[data.index(b"_") + 1 :]
    root = ElementTree.fromstring(head + b"</VTKFile>")
    assert root.attrib == {
        "type": "UnstructuredGrid",
        "version": "1.0",
        "byte_order": {"little": "LittleEndian", "big": "BigEndian"}[sys.byteorder],
        "header_type": "UInt64",
    }
    arrays = {}
    for element in root.iter("DataArray"):
        dtype = np.dtype(element.attrib["type"].lower())
        start = int(element.attrib["offset"])
        size = int(np.frombuffer(data, np.uint64, 1, start)[0])
        array = np.frombuffer(data, dtype, size // dtype.itemsize, start + 8)
        components = int(element.attrib["NumberOfComponents"])
        arrays[element.attrib["Name"]] = array.reshape(-1, components) if components > 1 else array
    return arrays


def columns(arrays, name, count):
    return np.stack([np.ravel(arrays[f"{name}_{k}"]) for k in range(count)], axis=1)


def test_vtu_keeps_every_digit(tmp_path):
    path = tmp_path / "a.b.vtu"
    points = {"f": F, "colours": COLOURS, "map": MAP}
    cells = {"area": AREA, "velocity": VELOCITY, "flipped": AREA > 0.5}
    export_vtu(path, MESH, points, cells)
    assert os.listdir(tmp_path) == ["a.b.vtu"]
    arrays = read_vtu(path)
    arrays["connectivity"] = arrays["connectivity"].reshape(-1, 3)
    arrays["colours"] = columns(arrays, "colours", 4)
    triangles = np.full(70, 5)  # VTK_TRIANGLE
    places = {"points": MESH.vertices, "connectivity": MESH.faces, "types": triangles}
    for name, wanted in {**places, "offsets": np.arange(3, 211, 3), **points, **cells}.items():
        assert_array_equal(arrays[name], wanted)


def test_ply_keeps_every_digit_and_without_data_is_a_plain_mesh(tmp_path):
    path = tmp_path / "a.ply"
    export_ply(path, MESH, {"f": F, "colours": COLOURS}, {"area": AREA, "velocity": VELOCITY})
    read = trimesh.load_mesh(path, process=False)
    assert_array_equal(read.vertices, MESH.vertices)
    assert_array_equal(read.faces, MESH.faces)
    points, cells = (read.metadata["_ply_raw"][name]["data"] for name in ("vertex", "face"))
    assert_array_equal(points["f"], F)
    assert_array_equal(columns(points, "colours", 4), COLOURS)
    assert_array_equal(cells["area"].ravel(), AREA)
    assert_array_equal(columns(cells, "velocity", 3), VELOCITY)
    export_ply(tmp_path / "a.ply", tetrahedron(), {}, {})
    plain = (
        b"property double z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    )
    assert plain in (tmp_path / "a.ply").read_bytes()


@pytest.mark.parametrize(
    ("points", "cells", "words"),
    [
        ({"f": np.ones(34)}, {}, r"'f' has shape \(34,\); expected \(35,\) or \(35, C\)"),
        ({}, {"v": np.ones((35, 3))}, r"'v' has shape \(35, 3\); expected \(70,\)"),
        ({"f": np.ones((35, 2, 2))}, {}, r"'f' has shape \(35, 2, 2\)"),
        ({"my f": np.ones(35)}, {}, "cannot be named 'my f'"),
        ({}, {"<v>": np.ones(70)}, "cannot be named '<v>'"),
        ({"f": np.ones((35, 2)), "f_1": np.ones(35)}, {}, "cannot be named 'f_1'"),
    ],
)
def test_data_that_does_not_fit_is_refused(tmp_path, points, cells, words):
    for export, name in ((export_ply, "a.ply"), (export_vtu, "a.vtu")):
        with pytest.raises(ResultError, match=words):
            export(tmp_path / name, MESH, points, cells)
    with pytest.raises(ResultError, match="cannot be named 'x'"):
        export_ply(tmp_path / "a.ply", MESH, {"x": F}, {})
    with pytest.raises(ResultError, match=r"must end in \.vtu"):
        export_vtu(tmp_path / "a.vtk", MESH, {}, {})
    assert os.listdir(tmp_path) == []


def test_energy_table(tmp_path):
    history = np.random.default_rng(1).uniform(size=(3, 3)) ** 40
    export_energy_csv(tmp_path / "energy.csv", history, np.array([0, 0, 1]))
    with (tmp_path / "energy.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == ["iteration", "stage", "total", "regularity", "mismatch"]
    assert [row[:2] for row in rows] == [["0", "0"], ["1", "0"], ["2", "1"]]
    assert_array_equal(np.array([row[2:] for row in rows], dtype=float), history)
