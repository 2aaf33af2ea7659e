"""The side from which surfaces are shown: named views, the best view, and the axis upwards."""

import numpy as np
import pytest

from abfm import Correspondence, ParameterError, TriangleMesh, load_mesh
from abfm.assets import asset_path
from abfm.display import UP_AXES, VIEWS, ViewSpec
from abfm.maps import PointMap
from abfm.pages.front import Front, front_of, same_side, upward_axis
from abfm.pages.registration_views import fronts
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere, torus

BODY = load_mesh(asset_path("human_A.off"))
EGG = ellipsoid(3, 1.0, 0.8, 0.6)


def bump(mesh, place):
    """Return a function that is 1 at a place and decreases quickly away from it."""
    return np.exp(-20 * ((mesh.vertices - place) ** 2).sum(axis=1))


def turned_about_y(mesh, degrees):
    """Return a mesh turned about y, and the matrix of the rotation."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return TriangleMesh(mesh.vertices @ rotation.T, mesh.faces), rotation


def test_best_view_shows_both_functions():
    sphere = icosphere(3)
    inside_out = TriangleMesh(sphere.vertices, sphere.faces[:, ::-1])
    for places in ([[1, 0, 0], [0, 0, 1]], [[-1, 0, 0], [0, 0, -1]], [[0, 0, 1], [0, 0, 1]]):
        functions = [bump(sphere, place) for place in places]
        front = front_of(sphere, *functions)
        assert min(np.array(places) @ front.direction) > 0.5
        assert front_of(inside_out, *functions) == front


@pytest.mark.parametrize("place", np.vstack([np.eye(3), -np.eye(3)]).tolist())
def test_best_view_shows_a_bump_anywhere(place):
    sphere = icosphere(3)
    assert np.dot(front_of(sphere, bump(sphere, place)).direction, place) > 0.5


def test_best_view_turns_with_the_surface():
    """The best view depends neither on the azimuth of the file nor on its unit or numbers."""
    functions = [bump(EGG, [0.7, 0.3, 0.4]), bump(EGG, [-0.2, 0.7, 0.3])]
    front = front_of(EGG, *functions)
    for degrees in (30, 90, 255):
        mesh, rotation = turned_about_y(EGG, degrees)
        found = front_of(mesh, *functions)
        np.testing.assert_allclose(found.axes, front.axes @ rotation.T, atol=1e-9)
    random = np.random.default_rng(0)
    numbers = random.permutation(len(EGG.vertices))
    faces = np.argsort(numbers)[random.permutation(EGG.faces)]
    mesh = TriangleMesh(1e4 * EGG.vertices[numbers] + [1e5, -1e5, 3e4], faces)
    assert front_of(mesh, *(f[numbers] for f in functions)) == front


def test_hidden_functions_do_not_count():
    """A bump in a valley between two tall arms is seen from the open side."""
    sphere = icosphere(4)
    x, y, z = sphere.vertices.T
    arms = 3 * np.exp(-8 * ((np.abs(z) - 0.95) ** 2 + y**2)) * (np.abs(x) < 0.6)
    mesh = TriangleMesh(sphere.vertices + arms[:, None] * [0, 1.5, 0], sphere.faces)
    place = sphere.vertices[np.argmax(y)]
    direction = front_of(mesh, bump(mesh, place)).direction
    assert abs(direction[0]) > abs(direction[2])


def test_best_view_without_functions_is_the_front():
    assert abs(front_of(ellipsoid(3, 3, 2, 1)).direction[2]) > 0.95
    front = front_of(BODY)
    assert front.direction[2] > 0.9
    for turned in np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, 1.0, 1.0]):
        faces = BODY.faces if np.linalg.det(turned) > 0 else BODY.faces[:, ::-1]
        assert front_of(TriangleMesh(1e3 * BODY.vertices @ turned, faces)).direction[2] > 0.9


def test_wire_is_seen_from_its_side():
    """The memory does not grow with the ratio of length to thickness."""
    assert abs(front_of(ellipsoid(3, 1e-6, 1e-6, 1)).direction[2]) < 0.5


def test_flat_surface_is_seen_from_above():
    standing = torus(24, 12, r=0.2)
    lying = TriangleMesh(standing.vertices[:, [0, 2, 1]], standing.faces[:, [0, 2, 1]])
    functions = [lying.vertices[:, 0], lying.vertices[:, 2]]
    assert front_of(lying, *functions).direction[1] > 0.8
    assert abs(front_of(standing, *functions).direction[1]) < 0.5


@pytest.mark.parametrize("up", ["x", "y", "z"])
@pytest.mark.parametrize("view", VIEWS)
def test_views_keep_the_given_up_axis(up, view):
    front = front_of(EGG, bump(EGG, [1, 0, 0]), bump(EGG, [0, 0, 0.6]), view=ViewSpec(view, up))
    np.testing.assert_allclose(front.axes @ front.axes.T, np.eye(3), atol=1e-12)
    axis = "xyz".index(up)
    if view in ("top", "bottom"):
        assert front.direction[axis] == (1 if view == "top" else -1)
    else:
        assert front.up[axis] > (0.55 if view == "best" else 0.99)


def test_opposite_views():
    for up in UP_AXES:
        for one, other in (("front", "back"), ("left", "right"), ("top", "bottom")):
            directions = [front_of(EGG, view=ViewSpec(name, up)).direction for name in (one, other)]
            assert np.dot(*directions) == -1
        right, front = (front_of(EGG, view=ViewSpec(name, up)) for name in ("right", "front"))
        np.testing.assert_array_equal(front.axes[0], right.direction)


def test_up_axis_by_file_and_shape():
    """Files of brains have z upwards and glTF y; other files stand if they are long along z."""
    tall = ellipsoid(2, 0.4, 0.4, 1)
    for name, shape, expected in (
        ("a.off", EGG, "y"),
        ("a.off", tall, "z"),
        ("a.glb", tall, "y"),
        ("a.surf.gii", EGG, "z"),
        ("a.surf.gii.gz", EGG, "z"),
    ):
        mesh = TriangleMesh(shape.vertices, shape.faces, file_name=name)
        assert "xyz"[int(np.argmax(upward_axis(mesh)))] == expected
    assert upward_axis(tall, "x") @ [1, 0, 0] == 1


def test_unknown_views_are_refused():
    for words in (("above",), ("best", "w")):
        with raises(ParameterError, repr(words[-1])):
            ViewSpec(*words)


@pytest.mark.parametrize(("structure", "side"), [("CortexLeft", -1), ("CortexRight", 1)])
def test_cortex_is_seen_as_in_workbench(structure, side):
    """The lateral side is shown, with z upwards, unless the functions are on the medial side."""
    mesh = TriangleMesh(EGG.vertices, EGG.faces, structure=structure)
    f = bump(mesh, [0, 0, 0.6])
    lateral = Front((side, 0, 0), (0, 0, 1))
    for up in ("auto", "z"):
        assert front_of(mesh, f, view=ViewSpec(up=up)) == lateral
    assert front_of(mesh, bump(mesh, [-side, 0, 0])).direction == (-side, 0, 0)
    assert front_of(mesh, view=ViewSpec("left")).direction == (-1, 0, 0)
    assert front_of(mesh, view=ViewSpec("front")).direction == (0, 1, 0)
    for up in "xy":
        assert front_of(mesh, f, view=ViewSpec(up=up)) == front_of(EGG, f, view=ViewSpec(up=up))
    same = Correspondence(PointMap.of_vertices(mesh, mesh))
    assert fronts(same)[0] == fronts(same)[1] == front_of(mesh)


@pytest.mark.parametrize("degrees", [0, 75, 180])
def test_surfaces_of_a_map_are_seen_from_the_same_side(degrees):
    """A is turned as by the map, and upright also if the map tilts it a little."""
    a, rotation = turned_about_y(BODY, degrees)
    of_a, of_b = fronts(Correspondence(PointMap.of_vertices(BODY, a)))
    np.testing.assert_allclose(of_a.axes, of_b.axes @ rotation.T, atol=1e-9)
    tilt = np.array([[0.96, 0.28, 0], [-0.28, 0.96, 0], [0, 0, 1]])
    tilted = TriangleMesh(a.vertices @ tilt, a.faces)
    of_a, of_b = fronts(Correspondence(PointMap.of_vertices(BODY, tilted)), ViewSpec("right"))
    np.testing.assert_allclose(of_a.up, [0, 1, 0], atol=1e-12)


def test_same_side_of_other_axes():
    """The front of a mesh with y upwards is the front of one with z upwards."""
    tall = ellipsoid(2, 0.4, 0.4, 1)
    assert same_side(front_of(EGG, view=ViewSpec("left")), EGG, tall) == front_of(
        tall, view=ViewSpec("left")
    )
