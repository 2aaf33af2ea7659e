import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm import TriangleMesh
from abfm.calculus.operators import gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.sequences import critical_points, face_indices
from tests.core.surfaces import SURFACES
from tests.shapes import icosphere

SPHERE = icosphere(3)
CLOSED = {name: mesh for name, mesh in SURFACES.items() if mesh.is_closed}


def grid(n: int) -> TriangleMesh:
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (
        part.ravel()
        for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:])
    )
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return TriangleMesh(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1), faces)


PLANE = grid(12)


def linear(matrix, at) -> np.ndarray:
    """Return the field ``matrix (p - at)`` of the plane, at the centre of each face."""
    middles = PLANE.vertices[PLANE.faces].mean(axis=1)[:, :2]
    flat = (middles - at) @ np.asarray(matrix, float).T
    return np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)


@pytest.mark.parametrize("mesh", CLOSED.values(), ids=CLOSED.keys())
@given(seed=st.integers(0, 2**31))
def test_indices_add_up_to_the_euler_characteristic(mesh, seed):
    """Poincaré-Hopf holds for any field without a zero at a vertex, however rough."""
    field = np.random.default_rng(seed).standard_normal((len(mesh.faces), 3))
    euler = len(mesh.vertices) - len(mesh.edges) + len(mesh.faces)
    assert face_indices(mesh, field).sum() == euler


@pytest.mark.parametrize(
    ("matrix", "kind", "index"),
    [
        ([[1, 0.2], [-0.1, 2]], "source", 1),
        ([[-1, 0], [0.3, -1.5]], "sink", 1),
        ([[0, -1], [1, 0]], "spiral", 1),
        ([[0.3, 1], [-1, 0.2]], "spiral", 1),
        ([[1, 0], [0, -2]], "saddle", -1),
    ],
)
@pytest.mark.parametrize("at", [(0.137, -0.24), (-0.51, 0.33), (0.02, 0.61)])
def test_zero_of_a_linear_field_is_found(matrix, kind, index, at):
    found = critical_points(PLANE, linear(matrix, at))
    assert found.kinds == (kind,)
    assert_array_equal(found.index, [index])
    assert_allclose(found.points.positions[0, :2], at, atol=1e-9)
    m = np.array(matrix)
    assert_allclose(found.divergence, m.trace(), rtol=1e-9, atol=1e-9)
    assert_allclose(found.curl, m[1, 0] - m[0, 1], rtol=1e-9, atol=1e-9)


def test_fields_without_zeros_have_no_points():
    assert len(critical_points(PLANE, np.tile([1.0, 0.3, 0.0], (len(PLANE.faces), 1)))) == 0
    assert len(critical_points(PLANE, np.zeros((len(PLANE.faces), 3)))) == 0


def test_height_gradient_has_a_source_and_a_sink():
    direction = np.array([0.3, -0.5, 0.8])
    direction /= np.linalg.norm(direction)
    field = to_ambient(SPHERE, (gradient(SPHERE) @ (SPHERE.vertices @ direction)).reshape(-1, 2))
    found = critical_points(SPHERE, field)
    assert sorted(found.kinds) == ["sink", "source"]
    for kind, side in (("source", -1), ("sink", 1)):
        place = found.points.positions[found.kinds.index(kind)]
        assert np.linalg.norm(place - side * direction) < 0.02


@pytest.mark.parametrize("level", [1, 2, 3])
def test_zeros_at_vertices_are_found(level):
    mesh = icosphere(level)
    about = mesh.vertices[7]
    height = to_ambient(mesh, (gradient(mesh) @ (mesh.vertices @ about)).reshape(-1, 2))
    turning = np.cross(about, mesh.vertices[mesh.faces].mean(axis=1))
    for field, kinds in ((height, ["sink", "source"]), (turning, ["spiral", "spiral"])):
        found = critical_points(mesh, field)
        assert sorted(found.kinds) == kinds
        assert found.index.sum() == 2
        assert_allclose(np.abs(found.points.positions @ about), 1, atol=0.02)


def test_points_follow_rotations_scales_and_signs():
    rng = np.random.default_rng(3)
    function = np.sin(3 * SPHERE.vertices @ rng.standard_normal(3)) + SPHERE.vertices[:, 0]
    field = to_ambient(SPHERE, (gradient(SPHERE) @ function).reshape(-1, 2))
    found = critical_points(SPHERE, field)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    other = TriangleMesh(5 * SPHERE.vertices @ turn.T, SPHERE.faces)
    there = critical_points(other, 1e3 * field @ turn.T)
    assert there.kinds == found.kinds
    assert_allclose(there.points.positions, 5 * found.points.positions @ turn.T, atol=1e-6)
    back = critical_points(SPHERE, -field)
    swap = {"source": "sink", "sink": "source"}
    assert [swap.get(kind, kind) for kind in back.kinds] == list(found.kinds)
    assert_array_equal(back.index, found.index)
