"""CIFTI files written by nibabel: the choice of a hemisphere, and damaged files."""

import nibabel
import numpy as np
import pytest
from nibabel import cifti2
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import FunctionError
from abfm.functions import function, read_labels, read_values
from abfm.mesh import TriangleMesh
from abfm.sequences import read_frames
from tests.messages import raises
from tests.shapes import icosphere

LEFT, RIGHT = icosphere(1), icosphere(2)
COUNT = len(LEFT.vertices)
WALL = np.arange(COUNT) % 5 == 0  # medial wall, without values
RANDOM = np.random.default_rng(0)
VALUES = RANDOM.standard_normal((3, COUNT)).astype(np.float32)
EXPECTED = np.where(WALL, np.nan, VALUES)


def models(right=RIGHT):
    """Return both hemispheres, the left one without its medial wall, and some voxels."""
    left = cifti2.BrainModelAxis.from_mask(~WALL, "CortexLeft")
    volume = cifti2.BrainModelAxis.from_mask(np.ones((2, 1, 1), bool), "thalamus_left", np.eye(4))
    every_vertex = np.ones(len(right.vertices), bool)
    return left + volume + cifti2.BrainModelAxis.from_mask(every_vertex, "CortexRight")


def write(path, rows, values=VALUES, right=RIGHT, dtype=np.float32):
    count = len(right.vertices)
    others = np.full((len(values), 2 + count), 7.0)
    others[:, 2:] = np.arange(count)
    data = np.concatenate([values[:, ~WALL], others], axis=1).astype(dtype)
    nibabel.save(cifti2.Cifti2Image(data, (rows, models(right))), path)
    return path


@pytest.fixture(scope="module")
def scalars(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cifti")
    return write(folder / "a.dscalar.nii", cifti2.ScalarAxis(["sulc", "curv", "area"]))


def test_scalars_are_those_of_the_hemisphere_of_the_mesh(scalars):
    """Values are those of the mesh's hemisphere; its medial wall has none and is masked."""
    found = read_values(scalars, LEFT)
    assert_array_equal(found.values, EXPECTED.T)
    assert (found.names, found.structure) == (("sulc", "curv", "area"), "L")
    values = function(LEFT, f"file:{scalars},column=curv", allow_missing=True)
    assert_array_equal(values, EXPECTED[1])
    assert_array_equal(read_values(scalars, RIGHT).values[:, 2], np.arange(len(RIGHT.vertices)))
    with raises(FunctionError, 3, "sulc", "curv"):
        function(LEFT, f"file:{scalars}")
    with raises(FunctionError, COUNT, 12):
        function(icosphere(0), f"file:{scalars},column=0,hemisphere=L")


def test_hemisphere_of_equal_sizes_is_chosen(tmp_path):
    path = write(tmp_path / "a.dscalar.nii", cifti2.ScalarAxis(["sulc"]), VALUES[:1], LEFT)
    for side, expected in (("L", EXPECTED[0]), ("R", np.arange(COUNT))):
        text = f"file:{path},hemisphere={side}"
        assert_array_equal(function(LEFT, text, allow_missing=True), expected)
        mesh = TriangleMesh(
            LEFT.vertices, LEFT.faces, structure=f"Cortex{'Left' if side == 'L' else 'Right'}"
        )
        assert_array_equal(read_values(path, mesh).values[:, 0], expected)
    with raises(FunctionError, "hemisphere=L", "hemisphere=R"):
        function(LEFT, f"file:{path}")
    np.save(tmp_path / "a.npy", VALUES[0])
    with raises(FunctionError, "hemisphere=L"):
        function(LEFT, f"file:{tmp_path / 'a.npy'},hemisphere=L")


def test_series_are_frames_with_their_times(tmp_path):
    path = write(tmp_path / "a.dtseries.nii", cifti2.SeriesAxis(0.5, 0.72, 3))
    found = read_frames(path, LEFT)
    assert_array_equal(found.values, EXPECTED)
    assert_allclose(found.times, 0.5 + 0.72 * np.arange(3))


def test_each_map_has_its_label_names(tmp_path):
    tables = [{0: ("???", (0, 0, 0, 0)), k: (f"area {k}", (1, 0.5, 0, 1))} for k in (1, 2)]
    keys = np.where(np.arange(COUNT) % 2, [[1], [2]], 0)
    path = write(tmp_path / "a.dlabel.nii", cifti2.LabelAxis(["one", "two"], tables), keys)
    for column, key in (("one", 1), ("1", 2)):
        found = read_labels(path, column, LEFT)
        assert_array_equal(found.values, np.where(WALL, -1, keys[key - 1]))
        assert found.names == {0: "???", key: f"area {key}"}
        assert found.colors[key] == (1, 0.5, 0, 1)
    where = function(LEFT, f'file:{path},column=two,label="area 2"')
    assert_array_equal(where, (keys[1] == 2) & ~WALL)
    for read in (read_values, read_frames):
        with raises(FunctionError, "labels"):
            read(path, LEFT)


def test_other_cifti_files_are_refused(tmp_path):
    axis = cifti2.BrainModelAxis.from_mask(np.ones(3, bool), "CortexLeft")
    nibabel.save(cifti2.Cifti2Image(np.eye(3), (axis, axis)), tmp_path / "a.dconn.nii")
    with raises(FunctionError, "brain_models"):
        read_values(tmp_path / "a.dconn.nii", LEFT)


def test_cifti_1_is_refused(scalars, tmp_path):
    """Files of CIFTI-1, such as the Human Connectome Project's RSN networks, are refused."""
    data = scalars.read_bytes().replace(b'CIFTI Version="2', b'CIFTI Version="1')
    (tmp_path / "a.dscalar.nii").write_bytes(data)
    with raises(FunctionError, "CIFTI-1", "-cifti-version-convert"):
        read_values(tmp_path / "a.dscalar.nii", LEFT)


def test_scaled_integers_agree_with_nibabel(scalars, tmp_path):
    image = nibabel.load(scalars)
    data = bytearray(scalars.read_bytes())
    header = image.nifti_header
    offset = int(np.frombuffer(data[168:176], "<i8")[0])
    data[176:192] = np.array([0.5, 3.0], "<f8").tobytes()  # scl_slope and scl_inter
    (tmp_path / "a.dscalar.nii").write_bytes(data)
    assert header.get_data_dtype() == np.float32
    assert offset > 540
    expected = nibabel.load(tmp_path / "a.dscalar.nii").get_fdata()[:, : np.count_nonzero(~WALL)]
    assert_allclose(read_values(tmp_path / "a.dscalar.nii", LEFT).values[~WALL], expected.T)


def test_wrong_sizes_and_dtd_are_refused(scalars, tmp_path):
    path, content = tmp_path / "a.dscalar.nii", scalars.read_bytes()
    begin, changes = content.index(b"<CIFTI"), []
    for number in (b"99999999", b"-1", b"x"):
        changes.append(content.replace(b'IndexCount="33"', b'IndexCount="' + number + b'"'))
        changes.append(content.replace(b'IndexOffset="0"', b'IndexOffset="' + number + b'"'))
    dtd = b"<!DOCTYPE CIFTI [<!ENTITY a 'aaaa'>]>"
    inserted = content[:begin] + dtd + content[begin:]
    size = int(np.frombuffer(content[544:548], "<i4")[0])
    changes.append(content[:548] + bytes(4) + content[552:])  # the code of another extension
    changes.append(inserted[:544] + np.array([size], "<i4").tobytes() + inserted[548:])
    for change in changes:
        path.write_bytes(change)
        with pytest.raises(FunctionError) as caught:
            read_values(path, LEFT)
        assert str(caught.value).isprintable()
