"""Files of different hemispheres cause a warning that names both."""

import warnings

import nibabel
import numpy as np
import pytest

import abfm
from abfm.errors import AbfmWarning
from abfm.functions import function, read_labels, read_values
from abfm.io import write_labels, write_stc, write_surface, write_values
from abfm.reading import Labels
from abfm.sequences import read_frames
from tests.messages import check_message
from tests.shapes import icosphere

SPHERE = icosphere(1)
VALUES = SPHERE.vertices[:, 0]
KEYS = Labels(np.arange(len(VALUES)) % 2, {0: "a", 1: "b"})


@pytest.fixture
def left(tmp_path):
    write_surface(tmp_path / "lh.white", SPHERE)
    return abfm.load_mesh(tmp_path / "lh.white")


def warnings_of(call, *given):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call(*given)
    return [str(each.message) for each in caught if each.category is AbfmWarning]


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("rh.sulc", lambda mesh, path: function(mesh, f"file:{path}")),
        ("a_right.npy", lambda mesh, path: function(mesh, f"scaled:2(file:{path}) + file:{path}")),
        ("hemi-R_a.shape.gii", lambda mesh, path: read_values(path, mesh)),
        ("R.a.csv", lambda mesh, path: read_frames(path, mesh)),
        ("a-rh.stc", lambda mesh, path: read_frames(path, mesh)),
        ("rh.a.annot", lambda mesh, path: read_labels(path, mesh=mesh)),
        ("cortex.dscalar.nii", lambda mesh, path: function(mesh, f"file:{path},hemisphere=R")),
        ("metadata.shape.gii", lambda mesh, path: function(mesh, f"file:{path}")),
    ],
)
def test_other_hemisphere_causes_one_warning(tmp_path, left, name, call):
    path = tmp_path / name
    if name.endswith(".stc"):
        write_stc(path, [VALUES], np.arange(len(VALUES)), [0.0])
    elif name.endswith(".annot"):
        write_labels(path, KEYS)
    elif name.endswith(".csv"):
        write_values(path, np.stack([VALUES, VALUES], axis=1))
    else:
        write_values(path, VALUES, "CortexRight")
    [text] = warnings_of(call, left, path)
    check_message(text, "lh.white", "left", name, "right")
    assert warnings_of(call, SPHERE, path) == []


@pytest.mark.parametrize("name", ["lh.sulc", "a_left.npy", "values.npy", "lh_to_rh.npy"])
def test_same_hemisphere_causes_no_warning(tmp_path, left, name):
    write_values(tmp_path / name, VALUES)
    assert warnings_of(function, left, f"file:{tmp_path / name}") == []


def test_gifti_metadata_determine_the_hemisphere(tmp_path):
    """GIFTI metadata have priority over the file name."""
    write_surface(tmp_path / "lh.a.surf.gii", SPHERE, "CortexRight")
    mesh = abfm.load_mesh(tmp_path / "lh.a.surf.gii")
    assert mesh.structure == "CortexRight"
    image = nibabel.load(tmp_path / "lh.a.surf.gii")
    assert abfm.load_mesh(image).structure == "CortexRight"
    write_values(tmp_path / "lh.sulc", VALUES)
    [text] = warnings_of(function, mesh, f"file:{tmp_path / 'lh.sulc'}")
    check_message(text, "lh.a.surf.gii", "right", "lh.sulc", "left")


def test_files_of_two_hemispheres_cause_a_warning(tmp_path):
    """Two hemispheres on one surface cause a warning; A and B of a registration may differ."""
    for side in ("lh", "rh"):
        write_values(tmp_path / f"{side}.sulc", VALUES)
    specs = [f"file:{tmp_path}/{side}.sulc" for side in ("lh", "rh")]
    [text] = warnings_of(abfm.Problem, SPHERE, *specs)
    check_message(text, "lh.sulc", "left", "rh.sulc", "right")
    a, b = (abfm.TriangleMesh(SPHERE.vertices, SPHERE.faces) for _ in "ab")
    assert warnings_of(abfm.registration.prepare, a, b, *specs) == []
