import nibabel
import nibabel.freesurfer
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from abfm.errors import FunctionError
from abfm.functions import function, read_labels, read_values, read_vertex_map
from tests.messages import raises
from tests.shapes import icosphere, with_loose_vertex

MESH = icosphere(1)
COUNT = len(MESH.vertices)
KEYS = np.array([-7, 0, 3, 2**31 - 1])
NAMES = {-7: "odd", 0: "???", 3: "pre central", 2**31 - 1: "Ärmel & <co>", 5: "nowhere"}
COLORS = {-7: (0.25, 0.5, 1.0, 0.0), 0: (0.0, 0.0, 0.0, 0.0), 3: (1.0, 0.125, 0.0, 1.0)}
VALUES = KEYS[np.random.default_rng(2).integers(0, 4, COUNT)]


def write_gifti(path, columns, intent="NIFTI_INTENT_LABEL", names=NAMES, kind=np.int32):
    """Write columns with the names ``map 0``, ``map 1``, ..."""
    arrays = [
        nibabel.gifti.GiftiDataArray(c.astype(kind), intent, meta={"a": "b", "Name": f"map {k}"})
        for k, c in enumerate(columns)
    ]
    image = nibabel.gifti.GiftiImage(darrays=arrays)
    for key, name in names.items():
        label = nibabel.gifti.GiftiLabel(key, *COLORS.get(key, ()))
        label.label = name
        image.labeltable.labels.append(label)
    nibabel.save(image, path)
    return path


def write_annotation(path, values):
    table = np.array([[25, 5, 25, 0], [220, 20, 100, 0], [25, 100, 40, 0]])
    names = [b"unknown", b"precentral", b"lingual"]
    nibabel.freesurfer.write_annot(path, values, table, names)
    return path


@pytest.mark.parametrize("name", ["a.label.gii", "a.gii.gz"])
def test_gifti_labels_have_names_and_colors(tmp_path, name):
    labels = read_labels(write_gifti(tmp_path / name, [VALUES]))
    assert_array_equal(labels.values, VALUES, strict=True)
    assert labels.names == NAMES
    assert labels.colors == COLORS


@given(
    table=st.dictionaries(
        st.integers(-(2**31), 2**31 - 1),
        st.text(st.characters(exclude_categories=["C", "Z"]), max_size=20),
        max_size=8,
    )
)
@settings(max_examples=50)
def test_any_label_table_round_trips(folder, table):
    path = write_gifti(folder / "a.label.gii", [np.array([*table, 0])], names=table)
    assert read_labels(path).names == table
    for key, name in table.items():
        found = read_labels(path).where(key) if name else None
        assert found is None or found[list(table).index(key)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("labels")


def test_labels_are_chosen_by_name_or_key(tmp_path):
    path = write_gifti(tmp_path / "a.label.gii", [VALUES])
    for word, key in (("odd", -7), ("-7", -7), ('"pre central"', 3), ("3", 3), ("0", 0)):
        assert_array_equal(function(MESH, f"file:{path},label={word}"), key == VALUES)
    assert not function(MESH, f"file:{path},label=nowhere").any()
    path = write_annotation(tmp_path / "lh.annot", np.arange(COUNT) % 3)
    for word, key in (("precentral", 1), ("2", 2)):
        assert_array_equal(function(MESH, f"file:{path},label={word}"), np.arange(COUNT) % 3 == key)


def test_label_names_have_priority_over_keys(tmp_path):
    names = {1: "2", 2: "both", 3: "both"}
    values = np.arange(COUNT) % 4
    path = write_gifti(tmp_path / "a.label.gii", [values], names=names)
    assert_array_equal(function(MESH, f"file:{path},label=2"), values == 1)
    assert_array_equal(function(MESH, f"file:{path},label=both"), values >= 2)


def test_labels_have_the_numbers_of_the_mesh_file(tmp_path):
    mesh = with_loose_vertex(MESH)
    path = write_gifti(tmp_path / "a.label.gii", [np.insert(VALUES, 5, 3)])
    assert_array_equal(function(mesh, f"file:{path},label=3"), VALUES == 3)


def test_columns_of_labels_are_chosen(tmp_path):
    path = write_gifti(tmp_path / "a.label.gii", [VALUES, VALUES[::-1]])
    assert_array_equal(function(MESH, f"file:{path},label=odd,column=1"), VALUES[::-1] == -7)
    assert_array_equal(read_labels(path, "map 1").values, VALUES[::-1])
    for options, named in (("", (2, "column=0", 1)), (",column=2", (2,))):
        with raises(FunctionError, *named):
            function(MESH, f"file:{path},label=odd{options}")


LIST = "#!ascii label, from subject a\n3\n5 0 0 0 2.5\n0 1.5 0 0 -1\n7 0 0 0 1\n"


def test_label_file_is_a_function(tmp_path):
    path = tmp_path / "lh.V1.label"
    path.write_text(LIST)
    for mesh, offset in ((MESH, 0), (with_loose_vertex(MESH), 1)):
        found = function(mesh, f"file:{path}")
        values = function(mesh, f"file:{path},column=value")
        expected = {5: 2.5, 0: -1, 7: 1} if not offset else {0: -1, 6: 1}
        assert dict(zip(np.flatnonzero(found), values[found > 0], strict=True)) == expected
        assert set(found) == {0, 1}
        assert np.count_nonzero(values) == len(expected)
    found = read_values(path)
    assert (found.names, found.vertices.tolist()) == (("value",), [5, 0, 7])
    assert found.values.tolist() == [[2.5], [-1], [1]]
    path.write_text(LIST.replace("7 0", f"{COUNT} 0"))
    for options, named in (("", (COUNT, 0)), (",column=2", ("value",)), (",label=V1", ())):
        with raises(FunctionError, *named):
            function(MESH, f"file:{path}{options}")


def test_labels_are_not_values_or_maps(tmp_path):
    """Labels are refused as values and vertex maps: interpolating them would be meaningless."""
    for path in (
        write_gifti(tmp_path / "a.label.gii", [VALUES]),
        write_gifti(tmp_path / "b.gii.gz", [VALUES], names={}),
        write_annotation(tmp_path / "lh.aparc.annot", np.zeros(COUNT, dtype=int)),
    ):
        for read in (read_values, lambda p: function(MESH, f"file:{p}")):
            with raises(FunctionError, "label=NAME", "read_labels") as caught:
                read(str(path))
            assert str(caught.value).startswith("file ")
        with raises(FunctionError):
            read_vertex_map(MESH, str(path))


def test_gifti_columns_have_names_of_metadata(tmp_path):
    columns = [np.arange(COUNT), -np.arange(COUNT)]
    path = write_gifti(tmp_path / "a.func.gii", columns, "NIFTI_INTENT_NONE", {}, np.float32)
    assert read_values(path).names == ("map 0", "map 1")
    assert_array_equal(function(MESH, f"file:{path},column=map 1"), -np.arange(COUNT))


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("a.xyz", b"a", (".gii", ".annot", ".dlabel.nii")),
        ("lh.annot", b"\0", ()),
        ("missing.annot", None, ()),
        ("a.label.gii", b"<GIFTI", ("XML",)),
        ("b.label.gii", b'<GIFTI><LabelTable><Label Key="1.5"/></LabelTable></GIFTI>', ("1.5",)),
        ("c.label.gii", b'<GIFTI><LabelTable><Label Key="%d"/>' % 10**18, ()),
        ("d.label.gii", b'<GIFTI><Label Key="9223372036854775808"/></GIFTI>', ()),
        ("e.label.gii", b"<GIFTI><Label>a</Label></GIFTI>", ()),
    ],
)
def test_files_without_labels_are_refused(tmp_path, name, content, named):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with raises(FunctionError, *named) as caught:
        read_labels(tmp_path / name)
    assert name in str(caught.value)
    assert str(caught.value).isprintable()


def test_values_are_not_labels(tmp_path):
    path = write_gifti(tmp_path / "a.gii", [VALUES], "NIFTI_INTENT_SHAPE", kind=np.float32)
    with raises(FunctionError, "values"):
        read_labels(path)
    write_gifti(path, [VALUES + 0.5], kind=np.float32)
    with raises(FunctionError):
        read_labels(path)
    write_gifti(path, [np.full(COUNT, np.nan)], kind=np.float32)
    with raises(FunctionError):
        read_labels(path)
    write_gifti(path, [VALUES])
    for word, named in (
        ("pre centrall", "pre central"),
        *((number, "odd") for number in ("9", "9" * 40, "9" * 5000, "1.5")),
    ):
        with raises(FunctionError, named):
            function(MESH, f'file:{path},label="{word}"')


@pytest.mark.parametrize(
    "color", ['Red="2" Green="0" Blue="0"', 'Red="x" Green="0" Blue="0"', 'Red="0"', ""]
)
def test_invalid_label_colors_are_ignored(tmp_path, color):
    """Invalid colours are ignored; early files have ``Index`` instead of ``Key``."""
    array = (
        '<DataArray Intent="NIFTI_INTENT_LABEL" DataType="NIFTI_TYPE_INT32" Encoding="ASCII" '
        'Dimensionality="1" Dim0="2"><Data>4 4</Data></DataArray>'
    )
    (tmp_path / "a.label.gii").write_text(
        f'<GIFTI><LabelTable><Label Index="4" {color}><![CDATA[ a&b ]]></Label></LabelTable>'
        f"{array}</GIFTI>"
    )
    labels = read_labels(tmp_path / "a.label.gii")
    assert (labels.values.tolist(), labels.names, labels.colors) == ([4, 4], {4: "a&b"}, {})
