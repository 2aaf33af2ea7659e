import io
import warnings
import zipfile

import nibabel
import numpy as np
import pandas
import pytest
import scipy.io
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import FunctionError, SeveralArraysError
from abfm.functions import (
    as_values,
    function,
    read_column,
    read_labels,
    read_values,
    read_vertex_map,
)
from abfm.functions.matlab_files import matlab_arrays
from abfm.mesh import TriangleMesh
from abfm.reading import NO_LABEL, Columns
from abfm.sequences import read_frames
from tests.core.reading.vtk_files import vtk_bytes
from tests.messages import raises
from tests.shapes import icosphere, with_loose_vertex

MESH = icosphere(1)
COUNT = len(MESH.vertices)
RANDOM = np.random.default_rng(3)
VALUES = RANDOM.standard_normal(COUNT).astype(np.float32).astype(np.float64)
ORDER = RANDOM.permutation(COUNT)
SUBSET = ORDER[:10]
SUBSET_VALUES = np.where(np.isin(np.arange(COUNT), SUBSET), VALUES, np.nan)
NONE, NODES = "NIFTI_INTENT_NONE", "NIFTI_INTENT_NODE_INDEX"


def gifti(path, arrays, labels=None, structure=""):
    """Write arrays with their intents, and names of labels by key."""
    found = []
    for intent, values in arrays:
        kind = np.float32 if np.asarray(values).dtype.kind == "f" else np.int32
        array = np.asarray(values, kind)
        type_name = f"NIFTI_TYPE_{array.dtype}".upper()
        found.append(nibabel.gifti.GiftiDataArray(array, intent, type_name))
    meta = {"AnatomicalStructurePrimary": structure} if structure else {}
    image = nibabel.gifti.GiftiImage(darrays=found, meta=nibabel.gifti.GiftiMetaData(meta))
    for key, name in (labels or {}).items():
        label = nibabel.gifti.GiftiLabel(key)
        label.label = name
        image.labeltable.labels.append(label)
    nibabel.save(image, path)
    return path


def table(path, text):
    path.write_text(text)
    return path


def rows(*columns):
    return "\n".join(",".join(map(repr, row)) for row in zip(*map(list, columns), strict=True))


def value_of(path, options="", mesh=MESH):
    return function(mesh, f'file:"{path}"{options}', allow_missing=True)


@pytest.mark.parametrize("place", ["first", "last"])
def test_node_indices_number_the_rows(tmp_path, place):
    """Node indices, first or last in a GIFTI, number rows of values, frames, labels and maps."""

    def write(name, arrays, rows, **more):
        indices = [(NODES, rows)]
        both = indices + arrays if place == "first" else arrays + indices
        return gifti(tmp_path / name, both, **more)

    path = write("a.func.gii", [(NONE, VALUES[ORDER])], ORDER)
    assert_array_equal(value_of(path), VALUES)
    path = write("b.func.gii", [(NONE, VALUES[SUBSET]), (NONE, -VALUES[SUBSET])], SUBSET)
    assert_array_equal(
        read_values(path, MESH).values, np.stack([SUBSET_VALUES, -SUBSET_VALUES], axis=1)
    )
    assert_array_equal(read_frames(path, MESH).values, np.stack([SUBSET_VALUES, -SUBSET_VALUES]))
    path = write("c.label.gii", [("NIFTI_INTENT_LABEL", SUBSET % 3)], SUBSET)
    expected = np.where(np.isnan(SUBSET_VALUES), NO_LABEL, np.arange(COUNT) % 3)
    assert_array_equal(read_labels(path, mesh=MESH).values, expected)
    assert_array_equal(value_of(path, ",label=2"), expected == 2)
    path = write("d.gii", [(NONE, ORDER[::-1])], ORDER)
    assert_array_equal(read_vertex_map(MESH, str(path))[ORDER], ORDER[::-1])


def test_vertex_numbers_are_those_of_the_mesh_file(tmp_path):
    mesh = with_loose_vertex(MESH)
    values = np.insert(VALUES, 5, 9.0)
    path = gifti(tmp_path / "a.gii", [(NODES, np.arange(1, COUNT + 1)), (NONE, values[1:])])
    assert_array_equal(value_of(path, mesh=mesh)[1:], VALUES[1:])


@pytest.mark.parametrize(
    ("indices", "named"), [([0, 1, 1], (1,)), ([0, 1, COUNT], (COUNT,)), ([0, -1, 2], (-1,))]
)
def test_wrong_indices_are_refused(tmp_path, indices, named):
    path = gifti(tmp_path / "a.gii", [(NODES, indices), (NONE, VALUES[:3])])
    with raises(FunctionError, *named):
        value_of(path)
    written = table(tmp_path / "a.csv", "vertex,v\n" + rows(indices, VALUES[:3].tolist()))
    with pytest.raises(FunctionError):
        value_of(written)


@pytest.mark.parametrize("name", ["vertex", "Node", "INDEX", "vertex_id", "node index", "Point ID"])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_vertex_column_numbers_the_rows(tmp_path, name, separator):
    text = f"{name},v,w\n" + rows(ORDER.tolist(), VALUES[ORDER].tolist(), ORDER.tolist())
    path = table(tmp_path / "a.csv", text.replace(",", separator))
    assert_array_equal(value_of(path, ",column=v"), VALUES)
    assert_array_equal(value_of(path, ",column=2"), np.arange(COUNT))
    assert_array_equal(read_frames(path, MESH).values, np.stack([VALUES, np.arange(COUNT)]))
    with raises(FunctionError, 2, "v", "w"):
        value_of(path)


@pytest.mark.parametrize("ending", [".npz", ".mat"])
def test_vertex_array_numbers_the_rows(tmp_path, ending):
    path = tmp_path / f"a{ending}"

    def write(**arrays):
        (scipy.io.savemat if ending == ".mat" else savez)(path, arrays)

    def savez(name, arrays):
        np.savez(name, **arrays)

    write(vertex=ORDER, v=VALUES[ORDER])
    assert_array_equal(value_of(path), VALUES)
    write(Node=SUBSET, v=VALUES[SUBSET])
    assert_array_equal(value_of(path, ",column=v"), SUBSET_VALUES)
    write(index=ORDER, frames=np.stack([VALUES, -VALUES])[:, ORDER])
    assert_array_equal(read_frames(path, MESH).values, np.stack([VALUES, -VALUES]))
    write(vertex=ORDER / 2, v=VALUES)
    with raises(FunctionError, "vertex"):
        value_of(path)
    write(vertex=ORDER)
    assert_array_equal(value_of(path), ORDER)
    write(vertex=SUBSET, v=VALUES)  # vertex numbers of another table
    assert_array_equal(value_of(path), VALUES)


def test_single_or_fractional_column_is_values(tmp_path):
    path = table(tmp_path / "a.csv", "index\n" + rows(ORDER.tolist()))
    assert_array_equal(value_of(path), ORDER)
    path = table(tmp_path / "a.csv", "index,v\n" + rows(VALUES.tolist(), ORDER.tolist()))
    assert_array_equal(value_of(path, ",column=index"), VALUES)
    with raises(FunctionError, "vertex"):
        value_of(table(tmp_path / "a.csv", "vertex,v\n" + rows(VALUES.tolist(), ORDER.tolist())))


def test_unnamed_first_column_is_an_index(tmp_path):
    """An unnamed first column is an index, from 1 (R) or from 0 (pandas), by its minimum."""

    def write(numbers):
        return table(tmp_path / "a.csv", ",v\n" + rows(numbers.tolist(), VALUES[ORDER].tolist()))

    assert_array_equal(value_of(write(ORDER)), VALUES)
    for first in (0, 1):
        assert_array_equal(value_of(write(np.arange(COUNT) + first)), VALUES[ORDER])
    with raises(FunctionError, "vertex"):
        value_of(write(ORDER + 1))


def test_comment_above_numbers_names_the_columns(tmp_path):
    columns = np.column_stack([ORDER, VALUES[ORDER]])
    np.savetxt(tmp_path / "a.txt", columns, header="vertex depth", fmt="%.17g")
    assert_array_equal(value_of(tmp_path / "a.txt"), VALUES)


@pytest.mark.parametrize("shape", [(1, COUNT), (COUNT, 1), (COUNT, 1, 1), (1, 1, COUNT)])
def test_axes_of_length_one_are_removed(tmp_path, shape):
    array = VALUES.reshape(shape)
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", depth=array)
    scipy.io.savemat(tmp_path / "a.mat", {"depth": array}, do_compression=True)
    gifti(tmp_path / "a.gii", [(NONE, array)])
    names = ["a.npy", "a.npz", "a.mat", "a.gii"]
    if len(shape) == 2:
        np.savetxt(tmp_path / "a.csv", array, delimiter=",", fmt="%.17g")
        names.append("a.csv")
    for name in names:
        assert_array_equal(value_of(tmp_path / name), VALUES, err_msg=name)


def test_any_axis_may_be_the_vertices(tmp_path):
    """The axis with as many entries as vertices is that of the vertices, also for frames."""
    frames = RANDOM.standard_normal((3, COUNT))
    np.save(tmp_path / "a.npy", frames)
    np.save(tmp_path / "b.npy", frames.T)
    for name in ("a.npy", "b.npy"):
        assert_array_equal(value_of(tmp_path / name, ",column=2"), frames[2])
        assert_array_equal(read_frames(tmp_path / name, MESH).values, frames)
    np.save(tmp_path / "a.npy", frames[:, 1:])
    with raises(FunctionError, 3, COUNT - 1, COUNT):
        value_of(tmp_path / "a.npy")


def test_arrays_are_chosen_by_name(tmp_path):
    arrays = {"depth": VALUES, "field": np.stack([VALUES, -VALUES]), "times": np.arange(2.0)}
    np.savez(tmp_path / "a.npz", **arrays)
    scipy.io.savemat(tmp_path / "a.mat", arrays | {"words": "text", "cell": np.array([1], "O")})
    points = {"depth": VALUES, "field": np.stack([VALUES, -VALUES], axis=1)}
    (tmp_path / "a.vtu").write_bytes(vtk_bytes(MESH.vertices, points))
    for name in ("a.npz", "a.mat", "a.vtu"):
        path = tmp_path / name
        assert_array_equal(value_of(path, ",column=depth"), VALUES)
        assert_array_equal(value_of(path, ',column="field[1]"'), -VALUES)
        with raises(FunctionError, "field[0]", "field[1]"):
            value_of(path, ",column=field")
        with raises(FunctionError, "depht", "depth"):
            value_of(path, ",column=depht")
        with pytest.raises(SeveralArraysError) as caught:
            value_of(path)
        assert caught.value.names == ("depth", "field")
    assert_array_equal(read_frames(tmp_path / "a.mat", MESH, "field").times, [0, 1])


def test_values_of_ply_files_are_read(tmp_path):
    faces = [f"3 {a} {b} {c}" for a, b, c in MESH.faces.tolist()]
    points = [
        f"{x!r} {y!r} {z!r} {v!r}"
        for (x, y, z), v in zip(MESH.vertices.tolist(), VALUES.tolist(), strict=True)
    ]
    kinds = "".join(f"property double {name}\n" for name in ("x", "y", "z", "quality"))
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {COUNT}\n{kinds}element face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    path = table(tmp_path / "a.ply", head + "\n".join(points + faces) + "\n")
    assert_array_equal(value_of(path), VALUES)
    assert_array_equal(value_of(path, ",column=x"), MESH.vertices[:, 0])


def test_values_are_read_from_a_gifti_with_a_mesh(tmp_path):
    """Values are read next to a mesh (CAT12, SPM); ``column=`` numbers all arrays of the file."""
    mesh = [("NIFTI_INTENT_POINTSET", MESH.vertices), ("NIFTI_INTENT_TRIANGLE", MESH.faces)]
    normals = [("NIFTI_INTENT_VECTOR", MESH.vertices)]
    path = gifti(tmp_path / "a.gii", [*mesh, *normals, ("NIFTI_INTENT_SHAPE", VALUES)])
    for column in ("", ",column=3", ",column=0"):
        assert_array_equal(value_of(path, column), VALUES)
    with raises(FunctionError, "surface"):
        value_of(gifti(tmp_path / "b.gii", mesh))


def test_repeated_names_are_refused(tmp_path):
    path = table(tmp_path / "a.csv", "v,v\n" + rows(VALUES.tolist(), ORDER.tolist()))
    with raises(FunctionError, 2, "v", "column=0", 1):
        value_of(path, ",column=v")
    assert_array_equal(value_of(path, ",column=1"), ORDER)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for values in (VALUES, ORDER):
            with archive.open("v.npy", "w") as file:
                np.save(file, values)
    content = io.BytesIO()
    scipy.io.savemat(content, {"v": VALUES})
    (tmp_path / "a.mat").write_bytes(content.getvalue() + content.getvalue()[128:])
    for name in ("a.npz", "a.mat"):
        with raises(FunctionError, 2, "v"):
            value_of(tmp_path / name, ",column=v")
    new, meta = nibabel.gifti.GiftiDataArray, {"Name": "thickness"}
    arrays = [new((k * VALUES).astype(np.float32), NONE, meta=meta) for k in (1, 2)]
    image = nibabel.gifti.GiftiImage(darrays=arrays)
    nibabel.save(image, tmp_path / "a.gii")
    with raises(FunctionError, 2, "thickness", "column=0", 1):
        value_of(tmp_path / "a.gii", ",column=thickness")


def test_labels_are_recognized_without_intent(tmp_path):
    """Integers with named keys (not only 0), or in a file named like labels, are labels."""
    keys = np.arange(COUNT) % 3
    named = {0: "???", 1: "one", 2: "two"}
    for name, labels in (("a.gii", named), ("a.label.gii", {}), ("a.label.gii.gz", None)):
        path = gifti(tmp_path / name, [(NONE, keys)], labels)
        assert_array_equal(read_labels(path).values, keys)
        with raises(FunctionError, "--labels"):
            value_of(path)
        with raises(FunctionError, "labels"):
            read_frames(path, MESH)
    path = gifti(tmp_path / "b.gii", [(NONE, keys)], {0: "???"})
    assert_array_equal(value_of(path), keys)
    path = gifti(tmp_path / "c.gii", [(NONE, VALUES)], named)
    assert_array_equal(value_of(path), VALUES)
    with raises(FunctionError, "integer"):
        read_labels(gifti(tmp_path / "d.label.gii", [(NONE, VALUES)]))


def test_integer_tables_are_labels(tmp_path):
    text = "vertex,key\n" + rows(SUBSET.tolist(), (SUBSET % 3).tolist())
    path = table(tmp_path / "a.csv", text)
    expected = np.where(np.isnan(SUBSET_VALUES), NO_LABEL, np.arange(COUNT) % 3)
    assert_array_equal(read_labels(path, mesh=MESH).values, expected)
    with raises(FunctionError, "mesh"):
        read_labels(path)


def test_annotation_without_table_keeps_its_numbers(tmp_path):
    """Without a table, keys are the numbers in the .annot file, which nibabel cannot read."""
    colors = np.where(np.arange(COUNT) % 2, 0x640519, 0x1405DC)
    pairs = np.column_stack([np.arange(COUNT), colors]).astype(">i4")
    (tmp_path / "lh.a.annot").write_bytes(np.array([COUNT], ">i4").tobytes() + pairs.tobytes())
    found = read_labels(tmp_path / "lh.a.annot", mesh=MESH)
    assert_array_equal(found.values, colors)
    assert_array_equal(value_of(tmp_path / "lh.a.annot", f",label={0x1405DC}"), colors == 0x1405DC)


def test_old_values_and_texts_of_freesurfer_are_read(tmp_path):
    hundredths = np.round(100 * VALUES).astype(">i2")
    head = COUNT.to_bytes(3, "big") + (80).to_bytes(3, "big")
    (tmp_path / "lh.curv").write_bytes(head + hundredths.tobytes())
    assert_array_equal(value_of(tmp_path / "lh.curv"), hundredths / 100)
    found = nibabel.freesurfer.read_morph_data(tmp_path / "lh.curv")
    assert_array_equal(found, hundredths.astype(float) / 100)
    lines = [f"{k:03d} 0.0 0.0 0.0 {v!r}" for k, v in enumerate(VALUES.tolist())]
    path = table(tmp_path / "lh.curv.asc", "\n".join(lines) + "\n")
    assert_array_equal(value_of(path), VALUES)


@pytest.mark.parametrize("words", [("GIFTI_ENDIAN_LITTLE", "GIFTI_ENCODING_B64GZ"), ("2", "3")])
def test_early_gifti_words_are_read(tmp_path, words):
    path = gifti(tmp_path / "a.gii", [(NONE, VALUES)])
    text = path.read_text().replace("LittleEndian", words[0]).replace("GZipBase64Binary", words[1])
    path.write_text(text.replace("NIFTI_TYPE_FLOAT32", "16").replace(NONE, "0"))
    assert_array_equal(value_of(path), VALUES)


def test_signalling_nan_causes_no_warning(tmp_path):
    array = VALUES.astype(np.float32)
    array.view(np.uint32)[4] = 0x7F800001
    np.save(tmp_path / "a.npy", array)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = value_of(tmp_path / "a.npy")
    assert_array_equal(np.flatnonzero(np.isnan(found)), [4])


def test_unsupported_matlab_files_are_refused(tmp_path):
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512))
    with raises(FunctionError, "-v7"):
        value_of(tmp_path / "a.mat")
    content = io.BytesIO()
    scipy.io.savemat(content, {"a": np.zeros(20_000_000, np.uint8)}, do_compression=True)
    (tmp_path / "a.mat").write_bytes(content.getvalue())
    with pytest.raises(FunctionError):  # too large for a file of this size
        value_of(tmp_path / "a.mat")
    scipy.io.savemat(tmp_path / "a.mat", {"a": 1j * VALUES})
    with raises(FunctionError, "real"):
        value_of(tmp_path / "a.mat", ",column=a")
    scipy.io.savemat(tmp_path / "a.mat", {"a": VALUES}, format="4")
    with raises(FunctionError, "-v7"):
        value_of(tmp_path / "a.mat")


@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i4", "u8", "?"])
@pytest.mark.parametrize("packed", [True, False])
def test_matlab_arrays_agree_with_scipy(tmp_path, kind, packed):
    arrays = {"one": np.arange(6).astype(kind).reshape(2, 3), "longer": np.zeros((2, 1, 2), kind)}
    scipy.io.savemat(tmp_path / "a.mat", arrays | {"x": "words"}, do_compression=packed)
    found = matlab_arrays((tmp_path / "a.mat").read_bytes())
    assert {*found} == {*arrays}
    for name, array in arrays.items():
        assert_array_equal(found[name], array)


def test_files_without_values_are_refused(tmp_path):
    (tmp_path / "a.off").write_text("OFF\n3 1 0\n")
    scipy.io.savemat(tmp_path / "a.mat", {"s": {"f": VALUES}})
    for name, named in (("a.off", "OFF mesh"), ("a.mat", "Structures")):
        with raises(FunctionError, named):
            value_of(tmp_path / name)


@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
@pytest.mark.parametrize("shape", [(COUNT, 1, 1), (COUNT // 6, 1, 6), (COUNT, 1, 1, 2)])
def test_values_in_images_of_freesurfer_are_read(tmp_path, kind, shape):
    size = int(np.prod(shape))
    image = kind(np.resize(VALUES, size).astype(np.float32).reshape(shape, order="F"), np.eye(4))
    if size > COUNT:
        image.header.set_zooms((1, 1, 1, 500))
        image.header.set_xyzt_units(t="msec")
    nibabel.save(image, tmp_path / "a.nii.gz")
    found = read_values(tmp_path / "a.nii.gz", MESH)
    assert_array_equal(found.values, VALUES[:, None].repeat(size // COUNT, axis=1))
    if size > COUNT:
        assert_array_equal(found.times, [0, 0.5])


@pytest.mark.parametrize("name", ["a.nii", "a.mgz"])
@pytest.mark.parametrize(
    "shape", [(COUNT, 3), (3, COUNT), (COUNT, 1, 3), (3, 1, COUNT), (1, 3, COUNT), (1, 1, COUNT, 3)]
)
def test_any_image_axis_may_be_the_vertices(tmp_path, name, shape):
    """Images written by Python and MATLAB may have the vertices along any axis."""
    columns = np.float32(np.stack([VALUES, 2 * VALUES, VALUES + 1]))
    values = (columns.T if shape.index(COUNT) < shape.index(3) else columns).reshape(shape)
    kind = nibabel.Nifti1Image if name == "a.nii" else nibabel.MGHImage
    image = kind(values if len(shape) > 2 or name == "a.nii" else values[..., None], np.eye(4))
    nibabel.save(image, tmp_path / name)
    assert_array_equal(read_values(tmp_path / name, MESH).values, columns.T)
    assert_array_equal(read_frames(tmp_path / name, MESH).values, columns)
    assert_array_equal(as_values(MESH, image), columns.T)


@pytest.mark.parametrize("shape", [(2 * COUNT,), (2 * COUNT, 3), (3, 2 * COUNT)])
def test_values_of_both_hemispheres_are_refused(tmp_path, shape):
    """Values of both hemispheres in one file, as BrainSpace writes, are refused."""
    np.save(tmp_path / "a.npy", np.ones(shape))
    with raises(FunctionError, 2 * COUNT, COUNT, "hemispheres"):
        read_values(tmp_path / "a.npy", MESH)


def test_label_without_vertices_is_refused(tmp_path):
    (tmp_path / "a.label").write_text("#!ascii label\n0\n")
    with raises(FunctionError, "a.label", "no vertices"):
        value_of(tmp_path / "a.label")


@pytest.mark.parametrize("name", ["a.nii", "a.mgh"])
def test_volume_is_refused(tmp_path, name):
    kind = nibabel.Nifti1Image if name == "a.nii" else nibabel.MGHImage
    nibabel.save(kind(np.zeros((3, 4, 5), np.float32), np.eye(4)), tmp_path / name)
    with raises(FunctionError, "3 x 4 x 5", COUNT, "Project"):
        value_of(tmp_path / name)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:348])
    with raises(FunctionError, "cut off"):
        value_of(tmp_path / name)


@pytest.mark.parametrize("is_rows", [False, True])
def test_column_numbers_of_pandas_are_names(tmp_path, is_rows):
    frames = np.stack([VALUES, 2 * VALUES, VALUES + 1])
    table = frames if is_rows else frames.T
    pandas.DataFrame(table).to_csv(tmp_path / "a.csv", index=False)
    assert_allclose(read_frames(tmp_path / "a.csv", MESH).values, frames)


def test_unnamed_vertex_numbers_are_refused(tmp_path):
    rows = "".join(f"{k},{VALUES[k]}\n" for k in ORDER)
    for head in ("", "id,value\n"):
        (tmp_path / "a.csv").write_text(head + rows)
        with raises(FunctionError, "vertex"):
            value_of(tmp_path / "a.csv", ",column=1")
    (tmp_path / "a.csv").write_text(f"vertex,value\n{rows}")
    assert_allclose(value_of(tmp_path / "a.csv"), VALUES)


def test_merged_vertices_have_the_first_value(tmp_path):
    vertices = np.concatenate([MESH.vertices, MESH.vertices[:1]])
    faces = MESH.faces.copy()
    one = int(np.flatnonzero((faces == 0).any(axis=1))[0])
    faces[one][faces[one] == 0] = COUNT
    mesh = TriangleMesh(vertices, faces, merge=True)
    found = Columns(np.array([1.0, 2.0]), vertices=np.array([COUNT, 0])).on(mesh)
    assert found.values[0, 0] == 2.0
    found = Columns(np.array([1.0]), vertices=np.array([COUNT])).on(mesh)
    assert found.values[0, 0] == 1.0


def test_columns_of_a_table_need_no_mesh(tmp_path):
    path = table(tmp_path / "a.csv", "vertex,v\n1,2.5\n0,3.5\n")
    assert read_values(path).names == ("vertex", "v")
    assert_allclose(read_column(path, "v"), [2.5, 3.5])
