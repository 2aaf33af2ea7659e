"""Lie brackets and pushforward: Eq. 11 as printed, exact brackets, and rotations."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from abfm.calculus import operators as op
from abfm.calculus.operators import Matrix
from abfm.calculus.vector_fields import (
    directional_derivative,
    exponential_action,
    lie_bracket,
    lie_bracket_of,
    pushforward,
    to_frame,
)
from abfm.errors import AdvectionError, ParameterError
from tests.core.calculus import torus_calculus as exact
from tests.core.fields import rotation_field, tangent, wavy_field
from tests.core.surfaces import SURFACES, last_order, relative_error
from tests.core.verification import near
from tests.messages import raises
from tests.shapes import icosphere, square

TORI = exact.refined(4)
# Icospheres have kinks along edges of coarser levels. Brackets there converge with order 1/2 in
# L2, and with order 2 if integrated against smooth test fields.
SPHERES = [icosphere(level) for level in (2, 3, 4)]


def close(actual, expected, scale=1.0):
    near(actual, expected, 1e-11 * scale)


def printed_bracket(mesh, v):
    """Return Eq. 11 as printed: (3F, 3F), on fields in space, component by component."""
    corners = mesh.vertices[mesh.faces]
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    hats = np.cross(op.face_normals(mesh)[:, None], opposite)
    hats /= 2 * op.face_areas(mesh)[:, None, None]
    entries = (np.repeat(np.arange(len(mesh.faces)), 3), mesh.faces.ravel())
    slopes = [sparse.csr_array((hats[:, :, x].ravel(), entries)) for x in range(3)]
    on_faces = [slope @ op.averaging(mesh) for slope in slopes]
    derivative = sum(sparse.diags_array(v[:, x]) @ on_faces[x] for x in range(3))
    dual = [[sparse.diags_array(on_faces[x] @ v[:, k]) for x in range(3)] for k in range(3)]
    return sparse.block_diag([derivative] * 3) - sparse.block_array(dual)


def test_bracket_equals_the_printed_operator(mesh):
    v, u = wavy_field(mesh, 1), wavy_field(mesh, 2)
    found = lie_bracket_of(mesh, v, u)
    scale = abs(op.gradient(mesh)).max() * mesh.length_scale**2  # a bound of the bracket
    printed = (printed_bracket(mesh, v) @ u.T.ravel()).reshape(3, -1).T
    close(found, tangent(mesh, printed), scale)
    expected = lie_bracket(mesh, to_frame(mesh, v)) @ to_frame(mesh, u).ravel()
    close(to_frame(mesh, found).ravel(), expected, scale)


def first(mesh):
    """Return the field ``sin v d/du + d/dv``."""
    return exact.face_field(mesh, lambda u, v: np.sin(v), lambda u, v: 1.0)


def second(mesh):
    """Return the field ``cos u d/dv``."""
    return exact.face_field(mesh, lambda u, v: 0 * u, lambda u, v: np.cos(u))


def test_bracket_and_its_derivative_converge():
    """The bracket of `first` and `second` and its derivative (Eq. 10) converge to exact ones.

    The exact bracket is ``-cos u cos v d/du - sin v sin u d/dv``.
    """
    errors = []
    for mesh in TORI:
        answer = exact.face_field(
            mesh, lambda u, v: -np.cos(u) * np.cos(v), lambda u, v: -np.sin(v) * np.sin(u)
        )
        v, u = first(mesh), second(mesh)
        found, f = lie_bracket_of(mesh, v, u), np.sin(mesh.vertices @ [2.0, 1.0, 0.5] + 0.3)
        of_v, of_u, of_found = (
            directional_derivative(mesh, to_frame(mesh, w)) for w in (v, u, found)
        )
        commutator = of_v @ (of_u @ f) - of_u @ (of_v @ f)
        off = abs(of_found @ f - commutator).max() / abs(commutator).max()
        errors.append([relative_error(mesh, found, answer), abs(found - answer).max(), off])
    assert (abs(last_order(errors) - [1, 1, 2]) <= [0.05, 0.1, 0.1]).all()


def test_jacobi_identity_has_order_one():
    errors = []
    for mesh in TORI[:3]:
        third = exact.face_field(mesh, lambda u, v: np.cos(u - v), lambda u, v: np.sin(v))
        fields = [first(mesh), second(mesh), third]
        inner = [lie_bracket_of(mesh, fields[i - 2], fields[i - 1]) for i in range(3)]
        terms = [lie_bracket_of(mesh, v, u) for v, u in zip(fields, inner, strict=True)]
        errors.append(abs(sum(terms)).max() / abs(terms[0]).max())
    assert last_order(errors) == pytest.approx(1, abs=0.1)


def test_affine_fields_in_the_plane_have_exact_brackets():
    """Away from the boundary, ``[d/dx, (x - y) d/dx + x d/dy] = d/dx + d/dy``."""
    errors = []
    for n in (8, 16, 32):
        mesh = square(n)
        x, y, _ = (centres := mesh.vertices[mesh.faces].mean(axis=1)).T
        constant = np.broadcast_to([1.0, 0, 0], centres.shape)
        linear = np.stack([x - y, x, 0 * x], axis=1)
        inner = ~mesh.is_boundary_vertex[mesh.faces].any(axis=1)
        errors.append(abs(lie_bracket_of(mesh, constant, linear) - [1, 1, 0])[inner].max())
        close(lie_bracket_of(mesh, constant, 3 * constant), 0, n)
    assert last_order(errors) > 0.9


def test_brackets_of_rotations_are_rotations():
    """``[R_x, R_y] = -R_z`` by Eq. 10: minus the rotation about the cross product of the axes."""
    errors, weak = [], []
    for mesh in SPHERES:
        r_x, r_y, r_z = (rotation_field(mesh, axis) for axis in np.eye(3))
        found = lie_bracket_of(mesh, r_x, r_y)
        assert relative_error(mesh, found, r_z) > 1.9
        errors.append(relative_error(mesh, found, -r_z))
        error = ((found + r_z) * rotated_field(mesh, 0.0)).sum(axis=1)
        weak.append(abs(op.face_areas(mesh) @ error))
    assert errors[-1] < 0.05
    assert last_order(errors) == pytest.approx(0.5, abs=0.05)
    assert last_order(weak) == pytest.approx(2, abs=0.1)


def rotated_field(mesh, angle):
    """Return a field without symmetry on the sphere, rotated by an angle about the x axis."""
    turn = Rotation.from_rotvec([angle, 0, 0]).as_matrix()
    points = mesh.vertices[mesh.faces].mean(axis=1) @ turn
    x, y, z = points.T
    field = np.stack([np.sin(2 * y), np.cos(x + z), 1 + x**2], axis=1)
    return tangent(mesh, np.cross(points, field) @ turn.T)


@pytest.mark.parametrize("t", [0.25, -0.25, 1.0])
def test_pushforward_rotates_fields_with_the_sphere(t):
    """``exp(-t ad_v)`` rotates a field with the sphere by t, and ``exp(t ad_v)`` by -t."""
    errors = []
    for mesh in SPHERES:
        spin, field = rotation_field(mesh, [1, 0, 0]), rotated_field(mesh, 0.0)
        pushed = pushforward(mesh, spin, field, t)
        errors.append(relative_error(mesh, pushed, rotated_field(mesh, t)))
        printed = pushforward(mesh, spin, field, -t)
        assert relative_error(mesh, printed, rotated_field(mesh, -t)) < 2 * errors[-1]
        assert relative_error(mesh, printed, rotated_field(mesh, t)) > 1.5 * abs(t)
    assert errors[-1] < 0.05 * abs(t)
    assert last_order(errors) > 0.5


def test_pushforward_has_order_one():
    """On a torus rotated about its axis by half a radian, the pushforward has order 1."""
    errors = []
    for mesh in TORI[:3]:
        spin = exact.face_field(mesh, lambda u, v: 1.0, lambda u, v: 0 * u)
        answer = exact.face_field(
            mesh, lambda u, v: np.cos(u - 0.5 - v), lambda u, v: np.sin(u - 0.5 + v)
        )
        field = exact.face_field(mesh, lambda u, v: np.cos(u - v), lambda u, v: np.sin(u + v))
        errors.append(relative_error(mesh, pushforward(mesh, spin, field, 0.5), answer))
    assert last_order(errors) == pytest.approx(1, abs=0.05)


def test_pullback_undoes_the_pushforward(mesh):
    v, u = wavy_field(mesh, 1), wavy_field(mesh, 2)
    pushed = pushforward(mesh, v, u, 0.3)
    close(pushforward(mesh, v, pushed, -0.3), u, abs(pushed).max())
    close(pushforward(mesh, v, pushforward(mesh, v, u, 0.1), 0.2), pushed, abs(pushed).max())
    close(pushforward(mesh, v, u, 0.0), u, abs(u).max())
    close(pushforward(mesh, v, v, 0.2), v, abs(v).max())


def test_pushforward_starts_with_the_bracket():
    """At t = 0, ``d/dt exp(-t ad_v) u = -[v, u]``."""
    mesh = SURFACES["torus"]
    v, u, t = wavy_field(mesh, 1), wavy_field(mesh, 2), 1e-5
    slope = (pushforward(mesh, v, u, t) - pushforward(mesh, v, u, -t)) / (2 * t)
    np.testing.assert_allclose(slope, -lie_bracket_of(mesh, v, u), atol=1e-5 * abs(slope).max())


@pytest.mark.parametrize(
    ("call", "error", "named"),
    [
        (lambda m, v: lie_bracket_of(m, v, v[1:]), ParameterError, ("u", "(3, 3)")),
        (lambda m, v: pushforward(m, v + np.nan, v, 1.0), ParameterError, ("v",)),
        (lambda m, v: pushforward(m, v, v, np.inf), AdvectionError, ()),
        (lambda m, v: pushforward(m, v, wavy_field(m, 2), 1e9), AdvectionError, ()),
    ],
)
def test_invalid_input_is_refused(call, error, named):
    mesh = SURFACES["tetrahedron"]
    with raises(error, *named):
        call(mesh, wavy_field(mesh, 1))


RNG = np.random.default_rng(0)
RANDOM = Matrix(sparse.random_array((40, 40), density=0.2, rng=RNG, data_sampler=RNG.normal))
X = np.random.default_rng(1).normal(size=40)


@pytest.mark.parametrize("t", [0.0, 1e-9, 0.3, -0.3, 4.0])
def test_exponential_equals_dense_exponential_of_scipy(t):
    expected = expm(t * RANDOM.toarray()) @ X
    near(exponential_action(RANDOM, X, t), expected, 1e-12 * abs(expected).max())


def test_exponentials_of_special_matrices_are_exact():
    """Exponentials are exact for a rotation by 100 rad (25 steps), nilpotent and zero matrices."""
    turn = Matrix(np.array([[0.0, -1.0], [1.0, 0.0]]))
    found = exponential_action(turn, np.array([1.0, 0.0]), 100.0)
    near(found, [np.cos(100), np.sin(100)], 1e-13)
    shift = Matrix(np.diag([1.0, 2.0, 3.0], 1))
    expected = expm(shift.toarray()) @ np.ones(4)
    np.testing.assert_allclose(exponential_action(shift, np.ones(4), 1.0), expected, rtol=1e-15)
    assert not exponential_action(RANDOM, np.zeros(40), 3.0).any()
    np.testing.assert_array_equal(exponential_action(Matrix((40, 40)), X, 5.0), X)


def test_exponential_scales_with_tiny_and_huge_vectors():
    expected = exponential_action(RANDOM, X, 1.0)
    for scale in (1e-300, 1e300):
        found = exponential_action(RANDOM, scale * X, 1.0) / scale
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-10)


def test_exponential_of_invalid_values_is_not_finite():
    invalid = [(RANDOM, np.where(np.arange(40) == 3, bad, 1.0), 3.0) for bad in (np.nan, np.inf)]
    with np.errstate(invalid="ignore", over="ignore"):
        for given in (*invalid, (Matrix(np.eye(2)), np.ones(2), 1e4)):
            assert not np.isfinite(exponential_action(*given)).all()


@pytest.mark.parametrize(
    ("scale", "t"), [(1.0, np.nan), (1.0, np.inf), (np.nan, 1.0), (np.inf, 1.0), (1e30, 1.0)]
)
def test_exponential_over_too_long_times_is_refused(scale, t):
    with raises(AdvectionError):
        exponential_action(Matrix(np.array([[scale, 1.0], [1.0, 0.0]])), np.ones(2), t)
