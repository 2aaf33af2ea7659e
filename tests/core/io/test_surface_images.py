import sys
from types import SimpleNamespace

import numpy as np
import pytest
from nilearn.surface import InMemoryMesh, PolyData, PolyMesh, SurfaceImage
from numpy.testing import assert_array_equal

from abfm.errors import MeshError, ResultError
from abfm.io import from_surface_image, to_surface_image, write_surface, write_values
from tests.messages import raises
from tests.shapes import icosphere, torus, with_loose_vertex

LEFT, RIGHT = icosphere(1), torus(8, 5)
RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("columns", [(), (1,), (3,)])
def test_parts_round_trip(columns):
    parts = {
        name: (mesh, RANDOM.normal(size=(len(mesh.vertices), *columns)))
        for name, mesh in (("left", LEFT), ("right", RIGHT))
    }
    image = to_surface_image(parts)
    assert isinstance(image, SurfaceImage)
    found = from_surface_image(image)
    assert list(found) == ["left", "right"]
    for name, (mesh, values) in parts.items():
        assert_array_equal(image.mesh.parts[name].coordinates, mesh.vertices)
        assert_array_equal(found[name][0].vertices, mesh.vertices)
        assert_array_equal(found[name][0].faces, mesh.faces)
        assert_array_equal(found[name][1], values)


def test_images_of_one_hemisphere_are_read(tmp_path):
    values = np.arange(len(LEFT.vertices) + 1)
    loose = with_loose_vertex(LEFT)
    vertices = np.insert(LEFT.vertices, 5, 9.0, axis=0)
    faces = LEFT.faces + (LEFT.faces >= 5)
    image = SurfaceImage(PolyMesh(left=InMemoryMesh(vertices, faces)), PolyData(left=values))
    [(name, (mesh, found))] = from_surface_image(image).items()
    assert name == "left"
    assert_array_equal(mesh.vertex_ids, loose.vertex_ids)
    assert_array_equal(found, np.delete(values, 5))
    write_surface(tmp_path / "a.surf.gii", RIGHT)
    write_values(tmp_path / "a.func.gii", RIGHT.vertices[:, 0])
    image = SurfaceImage({"right": tmp_path / "a.surf.gii"}, {"right": tmp_path / "a.func.gii"})
    mesh, found = from_surface_image(image)["right"]
    single = RIGHT.vertices.astype(np.float32)
    assert_array_equal(mesh.vertices, single)
    assert_array_equal(found.ravel(), single[:, 0])


def test_result_is_independent_of_the_image():
    values = np.zeros(len(LEFT.vertices))
    image = to_surface_image({"left": (LEFT, values)})
    image.data.parts["left"][:] = 1
    image.mesh.parts["left"].coordinates[:] = 0
    assert not values.any()
    assert LEFT.vertices.any()


@pytest.mark.parametrize("given", [None, 3, "image", SimpleNamespace(mesh=1, data=2)])
def test_other_objects_are_refused(given):
    with raises(ResultError, "SurfaceImage"):
        from_surface_image(given)


def test_invalid_parts_are_named():
    two = np.concatenate([LEFT.vertices, LEFT.vertices + 9])
    faces = np.concatenate([LEFT.faces, LEFT.faces + len(LEFT.vertices)])
    image = SurfaceImage(PolyMesh(left=InMemoryMesh(two, faces)), PolyData(left=two[:, 0]))
    with raises(MeshError, "left", 2):
        from_surface_image(image)
    mesh = SimpleNamespace(coordinates=LEFT.vertices, faces=LEFT.faces)
    for values, named in (({"left": np.array(["a"])}, ""), ({}, "left")):
        mesh_parts, data = SimpleNamespace(parts={"left": mesh}), SimpleNamespace(parts=values)
        parts = SimpleNamespace(mesh=mesh_parts, data=data)
        with raises(ResultError, named):
            from_surface_image(parts)


@pytest.mark.parametrize(
    ("parts", "named"),
    [
        ({}, ()),
        ({"top": (LEFT, np.ones(42))}, ()),
        ({"left": (LEFT, np.ones(41))}, ("left", "(41,)", "(42,)", 42)),
        ({"left": (LEFT, np.ones((42, 1, 1)))}, ("(42, 1, 1)",)),
        ({"left": (LEFT, np.ones(42)), "right": (RIGHT, np.ones((40, 2)))}, ("(42,)", "(40, 2)")),
    ],
)
def test_inconsistent_parts_are_refused(parts, named):
    with raises(ResultError, *named):
        to_surface_image(parts)


def test_missing_nilearn_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "nilearn.surface", None)
    with raises(ResultError, "abfm[brain]"):
        to_surface_image({"left": (LEFT, np.ones(42))})
