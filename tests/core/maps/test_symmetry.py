import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from abfm.assets import asset_path
from abfm.errors import ParameterError
from abfm.experiments.scripts import bundled
from abfm.maps.symmetry import KINDS, SymmetryError, detect_symmetry
from abfm.mesh import TriangleMesh, shapes
from tests.messages import raises
from tests.shapes import disc, ellipsoid, hemisphere, open_cylinder, square, tetrahedron, torus

BOX = trimesh.creation.box()
HUMAN = bundled("human_A.off")
SYMMETRIC = {
    "sphere": shapes.sphere(3),
    "ellipsoid": ellipsoid(3, 1, 0.7, 0.5),
    "tetrahedron": tetrahedron(),
    "torus": torus(24, 12),
    "disc": disc(6),
    "hemisphere": hemisphere(6),
    "cylinder": open_cylinder(20, 6),
    "cube": TriangleMesh(BOX.vertices, BOX.faces),
}


def exact(mesh, kind, order=2):
    """Return a symmetry after asserting that it is a permutation of the given order."""
    found = detect_symmetry(mesh, kind, order)
    assert found.error < 1e-9
    assert found.is_permutation
    images = vertices = np.arange(len(mesh.vertices))
    for _ in range(order):
        images = found.vertex_map[images]
    assert_array_equal(images, vertices)
    assert_allclose(np.linalg.matrix_power(found.linear, order), np.eye(3), atol=1e-12)
    assert not np.allclose(found.linear, np.eye(3))
    assert (found.vertex_map != vertices).any()
    assert_allclose(found.apply(mesh.vertices), mesh.vertices[found.vertex_map], atol=1e-9)
    sign = -1 if kind == "mirror" else 1
    assert np.linalg.det(found.linear) == pytest.approx(sign)
    assert_allclose(found.linear @ found.axis, sign * found.axis, atol=1e-12)
    return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SYMMETRIC)
def test_symmetric_meshes_have_exact_involutions(name, kind):
    exact(SYMMETRIC[name], kind)


@pytest.mark.parametrize(
    ("mesh", "order"),
    [(tetrahedron(), 3), (SYMMETRIC["cube"], 3), (SYMMETRIC["cube"], 4), (torus(30, 8), 5)],
)
def test_rotations_of_higher_order_are_found(mesh, order):
    exact(mesh, "rotation", order)


@pytest.mark.parametrize("mesh", [shapes.two_armed(2), shapes.stepped_slab(2)])
def test_generated_shapes_have_a_rotation(mesh):
    found = exact(mesh, "rotation")
    assert mesh.is_closed
    assert mesh.genus == 0
    assert_allclose(np.abs(found.axis), [0, 0, 1], atol=1e-9)
    mirrored = {tuple(sorted(face)) for face in found.vertex_map[mesh.faces].tolist()}
    assert mirrored == {tuple(sorted(face)) for face in mesh.faces.tolist()}


def test_rotation_of_a_ring_in_its_plane_is_preferred():
    around = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    vertices = np.concatenate([radius * circle for radius in np.linspace(1, 2, 6)])
    ring, place = np.indices((5, 60)).reshape(2, -1)
    a, b = 60 * ring + place, 60 * ring + (place + 1) % 60
    faces = np.concatenate([np.stack(c, axis=1) for c in ((a, a + 60, b), (b, a + 60, b + 60))])
    assert_allclose(exact(TriangleMesh(vertices, faces), "rotation").axis, [0, 0, 1], atol=1e-9)


def test_mirror_of_the_human_agrees_with_its_file():
    found = detect_symmetry(HUMAN, "mirror")
    assert_array_equal(found.vertex_map, np.loadtxt(asset_path("human.symperm.txt"), dtype=int))
    assert_allclose(np.abs(found.axis), [1, 0, 0], atol=1e-9)
    assert detect_symmetry(HUMAN, "mirror") is found


@settings(max_examples=8)
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    scale=st.floats(1e-3, 1e3),
    shift=st.tuples(*[st.floats(-10, 10)] * 3),
    seed=st.integers(0, 2**20),
)
def test_symmetry_moves_with_the_mesh(turn, scale, shift, seed):
    mesh, turn = shapes.two_armed(2), Rotation.from_rotvec(turn)
    order = np.random.default_rng(seed).permutation(len(mesh.vertices))
    vertices = scale * (turn.apply(mesh.vertices.copy()) + shift)
    other = TriangleMesh(vertices[order], np.argsort(order)[mesh.faces])
    before, after = detect_symmetry(mesh, "rotation"), detect_symmetry(other, "rotation")
    assert_array_equal(order[after.vertex_map], before.vertex_map[order])
    assert after.error < 1e-8
    assert abs(turn.apply(before.axis) @ after.axis) == pytest.approx(1, abs=1e-9)


@settings(max_examples=6)
@given(level=st.floats(0, 4e-3), seed=st.integers(0, 2**20))
def test_noise_hardly_moves_the_plane(level, seed):
    mesh, rng = HUMAN.normalized(), np.random.default_rng(seed)
    noise = np.clip(level * rng.standard_normal(mesh.vertices.shape), -0.01, 0.01)
    found = detect_symmetry(TriangleMesh(mesh.vertices + noise, mesh.faces), "mirror")
    assert abs(found.axis[0]) > np.cos(np.radians(1))
    assert found.error < 0.02
    assert (found.error > 0.1 * level) or level < 1e-6


def test_mirror_of_a_shape_with_asymmetric_mesh_is_found():
    turn = Rotation.from_rotvec([0.3, 0.2, 0.1])
    turned = turn.apply(shapes.sphere(3).vertices.copy()) * [1, 0.7, 0.5]
    found = detect_symmetry(TriangleMesh(turned, shapes.sphere(3).faces), "mirror")
    assert not found.is_permutation
    assert 1e-6 < found.error < 0.01
    assert np.abs(found.axis).max() > np.cos(np.radians(1))
    offset = turned[found.vertex_map] - found.apply(turned)
    assert np.linalg.norm(offset, axis=1).max() < 0.2  # the error is at most one edge length


def test_symmetry_with_the_largest_motion_is_preferred():
    for kind, axis in (("mirror", [1, 0, 0]), ("rotation", [0, 0, 1])):
        found = detect_symmetry(SYMMETRIC["ellipsoid"], kind)
        assert_allclose(np.abs(found.axis), axis, atol=1e-9)
    # reflection in the plane of a flat surface moves nothing and is ignored
    assert detect_symmetry(square(6), "mirror").axis[2] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["fandisk.off", "human_B.off"])
def test_missing_symmetry_is_refused_with_the_best_error(name, kind):
    mesh = bundled(name)
    with raises(SymmetryError) as refused:
        detect_symmetry(mesh, kind)
    assert refused.value.error > 0.05
    assert f"{refused.value.error:.3g} sqrt(area)" in str(refused.value)
    assert detect_symmetry(mesh, kind, tolerance=1).error == refused.value.error


@pytest.mark.parametrize(
    ("kind", "order"), [("mirror", 3), ("rotation", 1), ("rotation", 0), ("glide", 2)]
)
def test_unknown_kinds_and_orders_are_refused(kind, order):
    with raises(ParameterError):
        detect_symmetry(tetrahedron(), kind, order)
