"""CIFTI files, read by nibabel."""

from pathlib import Path

import nibabel
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import ResultError
from abfm.io import write_labels, write_values
from abfm.reading import Labels
from tests.messages import raises

VALUES = np.array([[0.25, 1.0], [np.nan, np.nan], [-2.0, 3.0], [np.nan, 5.0]])


@pytest.mark.parametrize(("side", "structure"), [("L", "CORTEX_LEFT"), ("R", "CORTEX_RIGHT")])
def test_scalars_omit_vertices_without_values(tmp_path: Path, side: str, structure: str) -> None:
    path = tmp_path / f"hemi-{side}_a.dscalar.nii"
    write_values(path, VALUES, names=["one", "two"])
    image = nibabel.load(path)
    maps, cortex = (image.header.get_axis(k) for k in range(2))
    assert maps.name.tolist() == ["one", "two"]
    assert cortex.name.tolist() == [f"CIFTI_STRUCTURE_{structure}"] * 3
    assert cortex.nvertices == {f"CIFTI_STRUCTURE_{structure}": 4}
    assert_array_equal(cortex.vertex, [0, 2, 3])
    assert_array_equal(image.get_fdata(), VALUES[[0, 2, 3]].T)


def test_series_has_a_frame_for_each_column(tmp_path: Path) -> None:
    write_values(tmp_path / "a.dtseries.nii", VALUES, "CortexRight")
    image = nibabel.load(tmp_path / "a.dtseries.nii")
    assert len(image.header.get_axis(0)) == 2
    assert image.nifti_header.get_intent()[0] == "ConnDenseSeries"


def test_series_has_the_times_of_its_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.dtseries.nii"
    for times, expected in ((None, (0, 1)), ([-0.36, 0.36], (-0.36, 0.72))):
        write_values(path, VALUES, "CortexLeft", times=times)
        axis = nibabel.load(path).header.get_axis(0)
        assert_allclose((axis.start, axis.step), expected)
        assert axis.unit == "SECOND"
    with raises(ResultError, "a.dtseries.nii", "evenly"):
        write_values(path, np.ones((4, 3)), "CortexLeft", times=[0, 1, 3])


def test_labels_keep_keys_names_and_colors(tmp_path: Path) -> None:
    """A key without a name is named by its number, and -1 (no label) is named "???"."""
    labels = Labels(np.array([3, 0, -1, 7]), {0: "???", 3: "Ä & <b>"}, {3: (0.2, 0.4, 0.6, 0.8)})
    write_labels(tmp_path / "lh.a.dlabel.nii", labels)
    image = nibabel.load(tmp_path / "lh.a.dlabel.nii")
    table = image.header.get_axis(0).label[0]
    assert {key: name for key, (name, _) in table.items()} == {0: "???", 3: "Ä & <b>", 7: "7"}
    assert_allclose(table[3][1], labels.colors[3])
    assert_array_equal(image.get_fdata()[0], [3, 0, 0, 7])


def test_unknown_hemisphere_is_refused(tmp_path: Path) -> None:
    with raises(ResultError, "a.dscalar.nii", "hemisphere"):
        write_values(tmp_path / "a.dscalar.nii", VALUES)
    with raises(ResultError, "no vertex"):
        write_values(tmp_path / "lh.a.dscalar.nii", np.full((3, 1), np.nan))
    with raises(ResultError, "16777216"):
        write_labels(tmp_path / "lh.a.dlabel.nii", Labels(np.array([1 << 25]), {}))
