"""The Lie bracket of fields and transport by its exponential: Eq. 11 as printed, exact brackets,
rotations.

On smoothly varying meshes the bracket has order 1, as the derivative of values that are constant on
faces; what it does to functions has order 2. Icospheres have kinks along the edges of all their
coarser levels, where averages err more: there the bracket has order 1/2 in L2, 0 in the maximum
norm, and 2 when it is tested against a smooth field.
"""

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial.transform import Rotation

from abfm.calculus import operators as op
from abfm.calculus.vector_fields import (
    directional_derivative,
    lie_bracket,
    lie_bracket_of,
    pushforward,
    to_frame,
)
from abfm.errors import AdvectionError, ParameterError
from tests.core import torus_calculus as exact
from tests.core.fields import rotation_field, tangent, wavy_field
from tests.core.surfaces import SURFACES, last_order, relative_error
from tests.shapes import icosphere, square

TORI = exact.refined(4)
SPHERES = [icosphere(level) for level in (2, 3, 4)]


def close(actual, expected, scale=1.0):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-11 * scale)


def largest_bracket(mesh):
    """Bound on the bracket of two wavy fields, of maximum norm ``length_scale``."""
    return abs(op.gradient(mesh)).max() * mesh.length_scale**2


def printed_bracket(mesh, v):
    """Eq. 11 as printed: (3F, 3F), on fields in space, components one after the other."""
    corners = mesh.vertices[mesh.faces]
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    hats = np.cross(op.face_normals(mesh)[:, None], opposite) / (
        2 * op.face_areas(mesh)[:, None, None]
    )
    entries = (np.repeat(np.arange(len(mesh.faces)), 3), mesh.faces.ravel())
    on_faces = [
        sparse.csr_array((hats[:, :, x].ravel(), entries)) @ op.averaging(mesh) for x in range(3)
    ]
    derivative = sum(sparse.diags_array(v[:, x]) @ on_faces[x] for x in range(3))
    dual = [[sparse.diags_array(on_faces[x] @ v[:, k]) for x in range(3)] for k in range(3)]
    return sparse.block_diag([derivative] * 3) - sparse.block_array(dual)


def test_bracket_is_the_printed_operator_on_tangent_planes(mesh):
    v, u = wavy_field(mesh, 1), wavy_field(mesh, 2)
    printed = (printed_bracket(mesh, v) @ u.T.ravel()).reshape(3, -1).T
    close(lie_bracket_of(mesh, v, u), tangent(mesh, printed), largest_bracket(mesh))


def test_bracket_is_its_matrix(mesh):
    v, u = wavy_field(mesh, 1), wavy_field(mesh, 2)
    expected = lie_bracket(mesh, to_frame(mesh, v)) @ to_frame(mesh, u).ravel()
    close(to_frame(mesh, lie_bracket_of(mesh, v, u)).ravel(), expected, largest_bracket(mesh))


def test_bracket_is_bilinear_and_antisymmetric(mesh):
    v, u, w = (wavy_field(mesh, seed) for seed in range(3))
    vu, vw = lie_bracket_of(mesh, v, u), lie_bracket_of(mesh, v, w)
    scale = largest_bracket(mesh)
    close(lie_bracket_of(mesh, v, 2 * u - 3 * w), 2 * vu - 3 * vw, scale)
    close(lie_bracket_of(mesh, u, v), -vu, scale)
    close(lie_bracket_of(mesh, v, v), 0, scale)


def first(mesh):
    """``sin v d/du + d/dv``."""
    return exact.face_field(mesh, lambda u, v: np.sin(v), lambda u, v: 1.0)


def second(mesh):
    """``cos u d/dv``."""
    return exact.face_field(mesh, lambda u, v: 0 * u, lambda u, v: np.cos(u))


def third(mesh):
    """``cos(u - v) d/du + sin v d/dv``."""
    return exact.face_field(mesh, lambda u, v: np.cos(u - v), lambda u, v: np.sin(v))


def test_bracket_has_order_one():
    """``[first, second] = -cos u cos v d/du - sin v sin u d/dv``, also in the maximum norm."""
    errors, largest = [], []
    for mesh in TORI:
        answer = exact.face_field(
            mesh, lambda u, v: -np.cos(u) * np.cos(v), lambda u, v: -np.sin(v) * np.sin(u)
        )
        found = lie_bracket_of(mesh, first(mesh), second(mesh))
        errors.append(relative_error(mesh, found, answer))
        largest.append(abs(found - answer).max())
    assert last_order(errors) == pytest.approx(1, abs=0.05)
    assert last_order(largest) == pytest.approx(1, abs=0.1)


def test_derivative_by_the_bracket_is_the_commutator():
    """Eq. 10, ``D_[v,u] f = D_v D_u f - D_u D_v f``, has order 2 in the maximum norm."""
    errors = []
    for mesh in TORI:
        v, u = first(mesh), second(mesh)
        f = np.sin(mesh.vertices @ [2.0, 1.0, 0.5] + 0.3)
        of_v, of_u = (directional_derivative(mesh, to_frame(mesh, w)) for w in (v, u))
        commutator = of_v @ (of_u @ f) - of_u @ (of_v @ f)
        by_bracket = directional_derivative(mesh, to_frame(mesh, lie_bracket_of(mesh, v, u))) @ f
        errors.append(abs(by_bracket - commutator).max() / abs(commutator).max())
    assert last_order(errors) == pytest.approx(2, abs=0.1)


def test_jacobi_identity_has_order_one():
    errors = []
    for mesh in TORI[:3]:
        fields = [first(mesh), second(mesh), third(mesh)]
        terms = [
            lie_bracket_of(mesh, fields[i], lie_bracket_of(mesh, fields[i - 2], fields[i - 1]))
            for i in range(3)
        ]
        errors.append(abs(sum(terms)).max() / abs(terms[0]).max())
    assert last_order(errors) == pytest.approx(1, abs=0.1)


def test_brackets_of_affine_fields_in_the_plane():
    """``[d/dx, (x - y) d/dx + x d/dy] = d/dx + d/dy`` away from one-sided averages."""
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


def test_rotations_of_the_sphere():
    """``[R_x, R_y] = -R_z`` by Eq. 10: minus the cross product of the axes."""
    errors, weak = [], []
    for mesh in SPHERES:
        r_x, r_y, r_z = (rotation_field(mesh, axis) for axis in np.eye(3))
        found = lie_bracket_of(mesh, r_x, r_y)
        assert relative_error(mesh, found, r_z) > 1.9
        errors.append(relative_error(mesh, found, -r_z))
        weak.append(abs(op.face_areas(mesh) @ ((found + r_z) * turned(mesh, 0.0)).sum(axis=1)))
    assert errors[-1] < 0.05
    assert last_order(errors) == pytest.approx(0.5, abs=0.05)
    assert last_order(weak) == pytest.approx(2, abs=0.1)


def turned(mesh, angle):
    """A field without symmetry on the sphere, turned by an angle about the x axis."""
    turn = Rotation.from_rotvec([angle, 0, 0]).as_matrix()
    points = mesh.vertices[mesh.faces].mean(axis=1) @ turn
    field = np.stack(
        [np.sin(2 * points[:, 1]), np.cos(points[:, 0] + points[:, 2]), 1 + points[:, 0] ** 2],
        axis=1,
    )
    return tangent(mesh, np.cross(points, field) @ turn.T)


@pytest.mark.parametrize("t", [0.25, -0.25, 1.0])
def test_pushforward_turns_a_field_along_with_the_sphere(t):
    """Only with the minus sign: ``exp(t ad_v)``, the pushforward for ``-t``, turns it back."""
    errors = []
    for mesh in SPHERES:
        spin, field = rotation_field(mesh, [1, 0, 0]), turned(mesh, 0.0)
        errors.append(relative_error(mesh, pushforward(mesh, spin, field, t), turned(mesh, t)))
        printed = pushforward(mesh, spin, field, -t)
        assert relative_error(mesh, printed, turned(mesh, -t)) < 2 * errors[-1]
        assert relative_error(mesh, printed, turned(mesh, t)) > 1.5 * abs(t)
    assert errors[-1] < 0.05 * abs(t)
    assert last_order(errors) > 0.5


def test_pushforward_of_rotations_turns_the_axis():
    """The rotation about y, carried by that about x, is the one about the turned axis."""
    errors = []
    for mesh in SPHERES:
        axis = Rotation.from_rotvec([0.25, 0, 0]).apply([0, 1, 0])
        spin, field = rotation_field(mesh, [1, 0, 0]), rotation_field(mesh, [0, 1, 0])
        errors.append(
            relative_error(mesh, pushforward(mesh, spin, field, 0.25), rotation_field(mesh, axis))
        )
        wrong = relative_error(
            mesh, pushforward(mesh, spin, field, -0.25), rotation_field(mesh, axis)
        )
        assert wrong == pytest.approx(2 * np.sin(0.25), abs=0.01)
    assert errors[-1] < 0.015
    assert last_order(errors) > 0.5


def test_pushforward_has_order_one():
    """Turning a torus about its axis by half a radian."""
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
    carried = pushforward(mesh, v, u, 0.3)
    close(pushforward(mesh, v, carried, -0.3), u, abs(carried).max())
    close(pushforward(mesh, v, pushforward(mesh, v, u, 0.1), 0.2), carried, abs(carried).max())
    close(pushforward(mesh, v, u, 0.0), u, abs(u).max())


def test_a_field_is_carried_to_itself_by_its_own_flow(mesh):
    v = wavy_field(mesh, 1)
    close(pushforward(mesh, v, v, 0.2), v, abs(v).max())


def test_pushforward_starts_with_the_bracket():
    """``d/dt exp(-t ad_v) u = -[v, u]`` at 0."""
    mesh = SURFACES["torus"]
    v, u, t = wavy_field(mesh, 1), wavy_field(mesh, 2), 1e-5
    slope = (pushforward(mesh, v, u, t) - pushforward(mesh, v, u, -t)) / (2 * t)
    np.testing.assert_allclose(slope, -lie_bracket_of(mesh, v, u), atol=1e-5 * abs(slope).max())


def test_bad_input_is_refused_in_words():
    mesh = SURFACES["tetrahedron"]
    v = np.zeros((4, 3))
    with pytest.raises(ParameterError, match=r"u has shape \(3, 3\); expected \(4, 3\)"):
        lie_bracket_of(mesh, v, v[1:])
    with pytest.raises(ParameterError, match="v has values that are not finite"):
        pushforward(mesh, v + np.nan, v, 1.0)
    with pytest.raises(AdvectionError, match="shorten the time"):
        pushforward(mesh, v, v, np.inf)
    with pytest.raises(AdvectionError, match="shorten the time"):
        pushforward(mesh, wavy_field(mesh, 1), wavy_field(mesh, 2), 1e9)
