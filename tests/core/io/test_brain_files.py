import getpass
import os
import time

import nibabel
import nibabel.freesurfer as freesurfer
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import abfm
from abfm.errors import ResultError
from abfm.functions import Labels, function, read_column, read_labels, read_values
from abfm.io import write_labels, write_surface, write_values
from abfm.mesh import load_mesh
from tests.messages import raises
from tests.shapes import icosphere, torus

MESH = icosphere(1)
COUNT = len(MESH.vertices)
RANDOM = np.random.default_rng(1)
VALUES = RANDOM.normal(size=COUNT)
LABELS = Labels(
    RANDOM.integers(-1, 4, COUNT),
    {0: "???", 1: "pre central", 3: "Ärmel & <co>", 2: "post"},
    {0: (0.0, 0.0, 0.0, 0.0), 1: (1.0, 0.2, 0.4, 1.0), 3: (0.2, 0.6, 0.0, 0.8)},
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("brain")


@pytest.mark.parametrize(
    "name",
    [*("a.surf.gii", "a.gii", "a.surf.gii.gz", "a.ply", "lh.white", "rh.sphere.reg", "LH.PIAL")],
)
def test_surfaces_round_trip(tmp_path, name):
    shape = torus(9, 7)
    write_surface(tmp_path / name, shape)
    mesh = load_mesh(tmp_path / name)
    assert_array_equal(mesh.faces, shape.faces)
    kind = np.float64 if name == "a.ply" else np.float32
    assert_array_equal(mesh.vertices, shape.vertices.astype(kind))
    assert os.listdir(tmp_path) == [name]


def test_surfaces_are_read_by_nibabel(tmp_path):
    write_surface(tmp_path / "lh.white.surf.gii", MESH)
    points, triangles = nibabel.load(tmp_path / "lh.white.surf.gii").darrays
    assert (points.intent, points.datatype) == (1008, 16)  # NIFTI_INTENT_POINTSET, FLOAT32
    assert (triangles.intent, triangles.datatype) == (1009, 8)  # NIFTI_INTENT_TRIANGLE, INT32
    assert dict(points.meta) == {"AnatomicalStructurePrimary": "CortexLeft"}
    assert_array_equal(points.data, MESH.vertices.astype(np.float32), strict=True)
    assert_array_equal(triangles.data, MESH.faces.astype(np.int32), strict=True)
    write_surface(tmp_path / "rh.white", MESH)
    vertices, faces, stamp = freesurfer.read_geometry(tmp_path / "rh.white", read_stamp=True)
    assert_array_equal(vertices, MESH.vertices.astype(np.float32).astype(np.float64))
    assert_array_equal(faces, MESH.faces)
    assert stamp == "created by abfm"


@pytest.mark.parametrize(
    "name",
    [
        *("a.shape.gii", "a.func.gii", "a.gii", "a.FUNC.gii.gz", "a.npy"),
        *("a.NPY", "a.csv", "a.Txt", "a.mgh", "a.MGZ"),
    ],
)
@pytest.mark.parametrize("values", [VALUES, VALUES * 1e-30, np.stack([VALUES, np.cos(VALUES)], 1)])
def test_values_round_trip(tmp_path, name, values):
    write_values(tmp_path / name, values)
    found = read_values(tmp_path / name).table()
    is_single = name.lower().endswith((".gii", ".gz", ".mgh", ".mgz"))
    expected = values.astype(np.float32) if is_single else values
    assert_array_equal(found, expected.reshape(COUNT, -1))
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("name", ["a.func.gii", "a.csv"])
def test_columns_keep_their_names(tmp_path, name):
    names, values = ["depth, mean", 'Ärmel "b"'], np.stack([VALUES, np.cos(VALUES)], 1)
    write_values(tmp_path / name, values, names=names)
    assert read_values(tmp_path / name).names == tuple(names)
    with raises(ResultError, 1, 2):
        write_values(tmp_path / name, values, names=["depth"])
    with raises(ResultError, "a\\nb"):
        write_values(tmp_path / name, VALUES, names=["a\nb"])


@pytest.mark.parametrize("name", ["lh.sulc", "rh.thickness", "lh.abfm.area"])
def test_freesurfer_values_round_trip(tmp_path, name):
    write_values(tmp_path / name, VALUES[:, None])
    assert_array_equal(function(MESH, f"file:{tmp_path / name}"), VALUES.astype(np.float32))
    assert_array_equal(freesurfer.read_morph_data(tmp_path / name), VALUES.astype(np.float32))
    with raises(ResultError, 2):
        write_values(tmp_path / name, np.ones((COUNT, 2)))


def test_missing_values_round_trip(tmp_path):
    values = np.where(VALUES > 1, np.nan, VALUES)
    for name in ("a.func.gii", "lh.sulc", "a.txt"):
        write_values(tmp_path / name, values)
        found = read_column(tmp_path / name)
        assert_array_equal(np.isnan(found), np.isnan(values))


@pytest.mark.parametrize(
    ("name", "structure", "intent", "stored"),
    [
        ("lh.abfm.shape.gii", None, "NIFTI_INTENT_SHAPE", "CortexLeft"),
        ("sub-1_hemi-R_x.func.gii", None, "NIFTI_INTENT_NONE", "CortexRight"),
        ("sub-1_hemi-R_x.func.gii", "Cerebellum", "NIFTI_INTENT_NONE", "Cerebellum"),
        ("a.func.gii", None, "NIFTI_INTENT_NONE", None),
    ],
)
def test_gifti_has_intent_structure_and_precision(tmp_path, name, structure, intent, stored):
    write_values(tmp_path / name, np.stack([VALUES, -VALUES], axis=1), structure)
    image = nibabel.load(tmp_path / name)
    expected = {"AnatomicalStructurePrimary": stored} if stored else {}
    assert dict(image.meta) == expected
    for array, sign in zip(image.darrays, (1, -1), strict=True):
        assert nibabel.nifti1.intent_codes.niistring[array.intent] == intent
        assert array.encoding == 3  # the code of GZipBase64Binary
        assert_array_equal(array.data, (sign * VALUES).astype(np.float32), strict=True)


@pytest.mark.parametrize("name", ["a.label.gii", "a.gii", "lh.a.label.gii.gz"])
def test_gifti_labels_round_trip(tmp_path, name):
    write_labels(tmp_path / name, LABELS)
    found, keys = read_labels(tmp_path / name), np.maximum(LABELS.values, 0)
    assert_array_equal(found.values, keys)
    assert (found.names, found.colors) == (LABELS.names, LABELS.colors)
    image = nibabel.load(tmp_path / name)
    [array] = image.darrays
    assert (array.intent, array.datatype) == (1002, 8)  # NIFTI_INTENT_LABEL, INT32
    assert image.labeltable.get_labels_as_dict() == LABELS.names
    assert_array_equal(array.data, keys.astype(np.int32), strict=True)


keys = st.integers(-(2**31) + 1, 2**31 - 1)
names = st.text(st.characters(exclude_categories=["C", "Z"]), max_size=9)
parts = st.integers(0, 255).map(lambda part: part / 255)
colors = st.tuples(parts, parts, parts, parts)


@given(
    table=st.dictionaries(keys, st.tuples(names, colors | st.none()), min_size=1, max_size=6),
    seed=st.integers(0, 99),
)
@settings(max_examples=60)
def test_any_labels_round_trip(folder, table, seed):
    """Each vertex keeps the name of its label; keys read from .annot files are new numbers."""
    random = np.random.default_rng(seed)
    labels = Labels(
        random.choice(list(table), 9),
        {key: name for key, (name, _) in table.items()},
        {key: color for key, (_, color) in table.items() if color},
    )
    write_labels(folder / "a.label.gii", labels)
    found = read_labels(folder / "a.label.gii")
    assert_array_equal(found.values, labels.values)
    assert (found.names, found.colors) == (labels.names, labels.colors)
    write_labels(folder / "lh.annot", labels)
    found = read_labels(folder / "lh.annot")
    assert list(found.names) == list(range(len(table)))
    assert list(found.names.values()) == list(labels.names.values())
    again = freesurfer.read_annot(folder / "lh.annot")[0]
    assert_array_equal(found.values, again)
    assert_array_equal(np.array(list(table))[found.values], labels.values)


def test_annotations_keep_distinct_colors(tmp_path):
    """Black or repeated colours become the next free ones; labels without a name become -1."""
    red, blue = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.8)
    labels = Labels(
        np.array([7, 3, 9, 11, 12, 7]),
        {7: "a", 3: "b", 9: "c", 11: "d"},
        {7: red, 3: blue, 9: red, 11: (0.0, 0.0, 0.0, 1.0)},
    )
    write_labels(tmp_path / "lh.annot", labels)
    found = read_labels(tmp_path / "lh.annot")
    assert found.values.tolist() == [0, 1, 2, 3, -1, 0]
    assert found.colors[0] == red
    assert found.colors[1] == pytest.approx(blue)
    assert found.colors[2] == (0.0, 1 / 255, 1.0 * 0, 1.0)
    assert found.colors[3] == (1 / 255, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("name", "structure"),
    [
        ("lh.white", "CortexLeft"),
        ("sub-1_hemi-R_pial.surf.gii", "CortexRight"),
        ("pial_left.surf.gii", "CortexLeft"),
        ("rh_pial.ply", "CortexRight"),
        ("hand_left.ply", None),
    ],
)
def test_meshes_have_a_structure(tmp_path, name, structure):
    """The structure follows from the file name and is stored in results, but not in digests."""
    sphere = icosphere(1)
    write_surface(tmp_path / name, sphere)
    mesh = load_mesh(tmp_path / name)
    assert mesh.structure == structure
    write_surface(tmp_path / "a.surf.gii", mesh)
    meta = dict(nibabel.load(tmp_path / "a.surf.gii").meta)
    assert meta == ({"AnatomicalStructurePrimary": structure} if structure else {})
    f, g = mesh.vertices.T[:2]
    problem = abfm.Problem(mesh, f, g)
    problem.save(tmp_path / "p.npz")
    assert abfm.load(tmp_path / "p.npz").mesh.structure == structure
    plain = abfm.TriangleMesh(mesh.vertices, mesh.faces)
    assert abfm.Problem(plain, f, g).digest == problem.digest


@pytest.mark.parametrize(
    ("keys", "names", "unknown", "written"),
    [
        ([1, -1, 2], {1: "a", 2: "b"}, 0, {0: "???", 1: "a", 2: "b"}),
        ([0, -1, 1], {0: "a", 1: "b"}, 2, {2: "???", 0: "a", 1: "b"}),
        ([0, -1, 3], {0: "a", 3: "Unknown"}, 3, {0: "a", 3: "Unknown"}),
        ([0, -1, 5], {}, 1, {1: "???"}),
        ([0, -1, 1], {-1: "wall", 0: "a", 1: "b"}, -1, {-1: "wall", 0: "a", 1: "b"}),
    ],
)
def test_gifti_names_missing_labels(tmp_path, keys, names, unknown, written):
    """Vertices without a label (-1) get a key named unknown that no other label has."""
    write_labels(tmp_path / "a.label.gii", Labels(np.array(keys), names))
    found = read_labels(tmp_path / "a.label.gii")
    assert found.values.tolist() == [keys[0], unknown, keys[2]]
    assert found.names == written


@pytest.mark.parametrize("name", ["a.npy", "a.csv", "a.txt"])
def test_label_keys_round_trip(tmp_path, name):
    write_labels(tmp_path / name, LABELS)
    assert_array_equal(read_column(tmp_path / name), LABELS.values)


def test_equal_data_give_equal_files(tmp_path, monkeypatch):
    """Files contain neither the time nor the user's name."""
    for name, write, data in (
        *((name, write_surface, MESH) for name in ("a.surf.gii", "a.surf.gii.gz", "lh.white")),
        *((name, write_values, VALUES) for name in ("lh.a.func.gii", "a.func.gii.gz", "lh.sulc")),
        *((name, write_values, VALUES) for name in ("a.mgh", "a.mgz")),
        *((name, write_labels, LABELS) for name in ("lh.a.label.gii", "lh.annot")),
    ):
        contents = set()
        for seconds in (10**9, 2 * 10**9):
            monkeypatch.setattr(time, "time", lambda seconds=seconds: seconds)
            monkeypatch.setattr(time, "ctime", lambda *_, seconds=seconds: str(seconds))
            monkeypatch.setattr(getpass, "getuser", lambda seconds=seconds: str(seconds))
            write(tmp_path / f"{seconds}.{name}", data)
            contents.add((tmp_path / f"{seconds}.{name}").read_bytes())
        assert len(contents) == 1


@pytest.mark.parametrize(
    ("write", "data", "name"),
    [
        (write_surface, MESH, "a.shape.gii"),
        (write_surface, MESH, "a.label.gii.gz"),
        (write_surface, MESH, "lh.sulc"),
        (write_surface, MESH, "a.ply.gz"),
        (write_surface, MESH, "white"),
        (write_values, VALUES, "a.surf.gii"),
        (write_values, VALUES, "lh.white"),
        (write_values, VALUES, "a.label.gii"),
        (write_values, VALUES, "a"),
        (write_labels, LABELS, "a.func.gii"),
        (write_labels, LABELS, "lh.sulc"),
        (write_labels, LABELS, "lh.annot.gz"),
    ],
)
def test_unsupported_endings_are_refused(tmp_path, write, data, name):
    with raises(ResultError) as e:
        write(tmp_path / name, data)
    assert ".gii" in str(e.value)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("write", "data", "name", "named"),
    [
        (write_values, np.full(COUNT, 1e39), "a.func.gii", ("single",)),
        (write_values, np.ones((2, 3, 4)), "a.func.gii", ("(2, 3, 4)",)),
        (write_values, np.ones(0), "a.npy", ("(0,)",)),
        (write_values, ["a"], "a.txt", ("real",)),
        (write_labels, VALUES, "a.label.gii", ("read_labels",)),
        (write_labels, Labels(VALUES), "a.label.gii", ("key", "integer")),
        (write_labels, Labels([2**31]), "a.label.gii", ("2.14748e+09", 2147483647)),
        (write_labels, Labels([[1]]), "a.label.gii", ("(1, 1)", "(n,)")),
        (write_labels, Labels([np.nan]), "a.label.gii", ("nan", "integer")),
        (write_labels, Labels([1], {1: "a\nb"}), "a.label.gii", ("name of label 1",)),
        (write_labels, Labels([1], {1: b"a"}), "a.label.gii", ("name of label 1",)),
        (write_labels, Labels([1], {0.5: "a"}), "a.label.gii", ("0.5", "integer")),
        (write_labels, Labels([1], {"a": "a"}), "a.label.gii", ("keys of names",)),
        (write_labels, Labels([1], {1: "a"}, {1: (2, 0, 0, 1)}), "lh.annot", ("four", 0, 1)),
        (write_labels, Labels([1], {1: "a"}, {1: (0, 0, 1)}), "a.label.gii", ("four", 0, 1)),
        (write_labels, Labels([1]), "lh.annot", ("names", ".npy")),
    ],
)
def test_invalid_data_are_not_written(tmp_path, write, data, name, named):
    with raises(ResultError, *named):
        write(tmp_path / name, data)
    assert os.listdir(tmp_path) == []
