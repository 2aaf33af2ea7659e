"""Meshes included in the package."""

import numpy as np

from abfm.assets import asset_names, asset_path
from abfm.errors import MeshError
from abfm.mesh import load_mesh
from tests.messages import raises


def test_assets_have_source_and_licence():
    readme = (asset_path("eight.off").parent / "README.md").read_text(encoding="utf-8")
    assert "human_A.off" in asset_names()
    for name in asset_names():
        assert asset_path(name).stat().st_size > 0
        assert f"`{name}`" in readme


def test_unknown_asset_suggests_a_similar_name():
    with raises(MeshError, "human_a.off"):
        asset_path("human_a.off")
    with raises(MeshError, "eight.off"):
        asset_path("zzzzzzzz")
    with raises(MeshError):
        asset_path("../pyproject.toml")


def test_missing_file_error_names_the_asset_of_its_name(tmp_path):
    with raises(MeshError, "eight.off", str(asset_path("eight.off"))):
        load_mesh(tmp_path / "eight.off")


def test_human_symmetry_maps_faces_to_faces():
    opposite = np.loadtxt(asset_path("human.symperm.txt"), dtype=int)
    mesh = load_mesh(asset_path("human_A.off"))
    np.testing.assert_array_equal(opposite[opposite], np.arange(len(mesh.vertices)))
    faces = {tuple(sorted(face)) for face in mesh.faces.tolist()}
    assert {tuple(sorted(face)) for face in opposite[mesh.faces].tolist()} == faces
    np.testing.assert_array_equal(load_mesh(asset_path("human_B.off")).faces, mesh.faces)
