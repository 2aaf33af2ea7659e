import io

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from abfm import ResultError, TriangleMesh, load_mesh
from abfm.io import textured_files, write_textured
from abfm.mesh.colors import load_colors
from tests.core.surfaces import renumbered
from tests.messages import raises
from tests.shapes import icosphere, open_cylinder, tetrahedron

MESH = renumbered(icosphere(1), 4)[0]
PLACES = np.random.default_rng(1).uniform(size=(len(MESH.faces), 3, 2))
PIXELS = np.random.default_rng(0).integers(0, 256, (6, 9, 4)).astype(np.uint8)


def png(pixels=PIXELS):
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "PNG")
    return data.getvalue()


@pytest.mark.parametrize("name", ["a.obj", "a b.OBJ", "a.glb"])
@pytest.mark.parametrize("mesh", [MESH, open_cylinder(5, 2)])
def test_textured_surfaces_round_trip(tmp_path, name, mesh):
    places = np.random.default_rng(1).uniform(size=(len(mesh.faces), 3, 2))
    path = tmp_path / name
    write_textured(path, mesh, places, png(), "MASK")
    assert {*tmp_path.iterdir()} == {*textured_files(path)}
    read = load_mesh(path)
    assert_array_equal(read.faces, mesh.faces)
    assert_allclose(read.vertices, mesh.vertices, rtol=0 if "OBJ" in name.upper() else 1e-7)
    colors = load_colors(path, read)
    assert_allclose(colors.coordinates, places, atol=1e-7)
    assert [each.image for each in colors.materials] == [png()]
    if name == "a.glb":
        assert colors.materials[0][2:] == (("clamp", "clamp"), "MASK")


@pytest.mark.parametrize("name", ["a.obj", "a.glb"])
def test_trimesh_reads_the_same_texture(tmp_path, name):
    write_textured(tmp_path / name, MESH, PLACES, png(), "BLEND")
    found = trimesh.load(tmp_path / name, process=False, force="mesh")
    corners = found.vertices[found.faces]
    assert_allclose(corners, MESH.vertices[MESH.faces], atol=1e-7)
    assert_allclose(found.visual.uv[found.faces], PLACES, atol=1e-6)
    material = found.visual.material
    image = material.image if name == "a.obj" else material.baseColorTexture
    assert_array_equal(np.asarray(image), PIXELS)


def test_obj_has_all_digits(tmp_path):
    moved = TriangleMesh(MESH.vertices / 3 + 1e6, MESH.faces)
    write_textured(tmp_path / "a.obj", moved, PLACES, png())
    assert_array_equal(load_mesh(tmp_path / "a.obj").vertices, moved.vertices)


def test_failed_write_keeps_existing_files(tmp_path):
    path = tmp_path / "a.obj"
    write_textured(path, MESH, PLACES, png())
    before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    (tmp_path / "a.png").unlink()
    (tmp_path / "a.png").mkdir()
    with raises(ResultError, "a.png"):
        write_textured(path, tetrahedron(), np.zeros((4, 3, 2)), png())
    (tmp_path / "a.png").rmdir()
    left = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    assert left == {name: data for name, data in before.items() if name != "a.png"}


@pytest.mark.parametrize(
    ("name", "named"),
    [("a.ply", (".obj", ".glb")), ("a#1.obj", ()), ("a\n.obj", ()), ("a  b.obj", ())],
)
def test_invalid_names_are_refused(tmp_path, name, named):
    with raises(ResultError, *named):
        write_textured(tmp_path / name, MESH, PLACES, png())
    assert not [*tmp_path.iterdir()]


def test_lost_precision_is_refused(tmp_path):
    far = TriangleMesh(MESH.vertices + 1e8, MESH.faces)
    with raises(ResultError, ".obj"):
        write_textured(tmp_path / "a.glb", far, PLACES, png())
    with raises(ResultError, "(2, 3, 2)", "(80, 3, 2)"):
        write_textured(tmp_path / "a.glb", MESH, PLACES[:2], png())
    assert not [*tmp_path.iterdir()]
