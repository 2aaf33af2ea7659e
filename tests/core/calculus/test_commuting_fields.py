"""Smoothest commuting fields: known answers, convergence, optimality, invariances."""

import numpy as np
import pytest
from scipy import linalg
from scipy.spatial.transform import Rotation

from abfm.calculus import operators as op
from abfm.calculus.vector_fields import (
    commuting_fields,
    lie_bracket,
    lie_bracket_of,
    relative_bracket,
    to_ambient,
    to_frame,
)
from abfm.errors import ParameterError
from tests.core import torus_calculus as exact
from tests.core.fields import rotation_field, tangent, wavy_field
from tests.core.surfaces import SURFACES, last_order, moved, norm, relative_error, renumbered
from tests.shapes import disc, ellipsoid, icosphere, torus

TORI = exact.refined(3, 16)


def du(mesh):
    """Rotation about the axis."""
    return exact.face_field(mesh, lambda u, v: 1.0, lambda u, v: 0 * u)


def up_to_scale(mesh, found, answer):
    """Relative error of a field that is known up to a factor."""
    found, answer = found / norm(mesh, found), answer / norm(mesh, answer)
    return min(relative_error(mesh, sign * found, answer) for sign in (1, -1))


def roughness(mesh, u):
    """Hodge energy times area over the squared norm."""
    c = to_frame(mesh, u).ravel()
    return (
        op.face_areas(mesh).sum()
        * (c @ (op.hodge_laplacian(mesh) @ c))
        / (c @ (op.field_mass(mesh) @ c))
    )


def test_rotation_of_a_torus_commutes_with_the_harmonic_field_around_the_tube():
    errors, brackets = [], []
    for mesh in TORI:
        v = du(mesh)
        (u,) = commuting_fields(mesh, v)
        answer = exact.face_field(mesh, lambda u, v: 0 * u, lambda u, v: 1 / exact.ring(v))
        errors.append(up_to_scale(mesh, u, answer))
        brackets.append(relative_bracket(mesh, v, u))
    assert errors[-1] < 0.06
    assert last_order(errors) > 0.75
    assert last_order(brackets) > 0.85


def test_rotation_of_a_sphere_commutes_with_the_gradient_along_its_axis():
    """Both are conformal; the others orthogonal to the rotation do not commute with it."""
    errors, brackets = [], []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        v = rotation_field(mesh, [0, 0, 1])
        found = commuting_fields(mesh, v, 2)
        errors.append(
            up_to_scale(mesh, found[0], tangent(mesh, np.tile([0.0, 0, 1], (len(mesh.faces), 1))))
        )
        brackets.append(relative_bracket(mesh, v, found[0]))
        others = commuting_fields(mesh, v, 5, weight=0)
        assert max(relative_bracket(mesh, v, u) for u in others) > 10 * brackets[-1]
    assert errors[-1] < 0.05
    assert last_order(brackets) > 0.4  # icospheres: see test_lie_bracket


def test_smoother_fields_that_do_not_commute_are_passed_over():
    """On a flat spheroid the smoothest fields turn about, or point along, horizontal axes."""
    mesh = ellipsoid(3, 1.2, 1.2, 0.6)
    v = rotation_field(mesh, [0, 0, 1])
    (smoothest,), (u,) = commuting_fields(mesh, v, weight=0), commuting_fields(mesh, v)
    assert roughness(mesh, smoothest) < 0.9 * roughness(mesh, u)
    assert relative_bracket(mesh, v, u) < 0.2 * relative_bracket(mesh, v, smoothest)
    around = op.face_areas(mesh) @ (u * rotation_field(mesh, [0, 0, 1])).sum(axis=1)
    assert abs(around) < 1e-9 * norm(mesh, u) * norm(mesh, v)


def test_multiples_of_a_field_by_functions_of_its_stream_function_commute():
    """``[v, h(f) v] = 0`` for the turned gradient ``v`` of ``f``: where nothing else commutes."""
    brackets = []
    for level in (2, 3):
        mesh = ellipsoid(level, 1.0, 0.7, 1.6)
        f = mesh.vertices[:, 2] * np.exp(0.2 * mesh.vertices[:, 0])
        v = to_ambient(mesh, (op.rotation(mesh) @ (op.gradient(mesh) @ f)).reshape(-1, 2))
        (u,) = commuting_fields(mesh, v, weight=1000)
        aligned = abs((u * v).sum(axis=1)) @ op.face_areas(mesh)
        speeds = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) @ op.face_areas(mesh)
        brackets.append(relative_bracket(mesh, v, u))
    assert aligned > 0.95 * speeds
    assert last_order(brackets) > 0.4


@pytest.fixture(params=["ellipsoid", "torus", "genus two", "square", "cylinder"])
def mesh(request):
    return SURFACES[request.param]


def dense(mesh, v, weight):
    """Lowest field by a dense eigenproblem on an orthonormal basis of the complement of ``v``."""
    mass = op.field_mass(mesh).toarray()
    c = to_frame(mesh, v)
    mean_square = (c.ravel() @ mass @ c.ravel()) / op.face_areas(mesh).sum()
    ad = lie_bracket(mesh, c).toarray()
    energy = op.hodge_laplacian(mesh).toarray() + weight / mean_square * ad.T @ mass @ ad
    basis = linalg.null_space((mass @ c.ravel())[None])
    values, vectors = linalg.eigh(basis.T @ energy @ basis, basis.T @ mass @ basis)
    return values, basis @ vectors


def test_agrees_with_a_dense_eigensolver(mesh):
    v = wavy_field(mesh, 1)
    values, vectors = dense(mesh, v, 7.0)
    found = commuting_fields(mesh, v, 2, weight=7.0)
    c = to_frame(mesh, v)
    mean_square = norm(mesh, v) ** 2 / op.face_areas(mesh).sum()
    for value, u in zip(values, found, strict=False):
        w = to_frame(mesh, u).ravel()
        bracket = norm(mesh, lie_bracket_of(mesh, v, u)) ** 2
        energy = w @ (op.hodge_laplacian(mesh) @ w) + 7.0 / mean_square * bracket
        assert energy / norm(mesh, u) ** 2 == pytest.approx(value, rel=1e-7)
        assert abs(w @ (op.field_mass(mesh) @ c.ravel())) < 1e-8 * norm(mesh, u) * norm(mesh, v)
        assert norm(mesh, u) == pytest.approx(norm(mesh, v), rel=1e-9)
    if values[1] > 1.01 * values[0]:
        lowest = to_frame(mesh, found[0]).ravel() / norm(mesh, found[0])
        assert abs(lowest @ (op.field_mass(mesh) @ vectors[:, 0])) == pytest.approx(1, abs=1e-6)


def test_turns_scales_and_is_renumbered_along_with_the_mesh():
    mesh = ellipsoid(2, 1.0, 0.7, 1.6)
    v = wavy_field(mesh, 1)
    (u,) = commuting_fields(mesh, v)
    turn = Rotation.from_euler("xyz", [0.3, -1.2, 2.0]).as_matrix()
    largest = abs(u).max()

    def close(actual, expected):
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-6 * largest)

    close(commuting_fields(moved(mesh, turn), v @ turn.T)[0], u @ turn.T)
    close(commuting_fields(moved(mesh, np.eye(3), 8.0), 8 * v)[0] / 8, u)
    close(commuting_fields(mesh, 1e-4 * v)[0] * 1e4, u)
    other, _, faces = renumbered(mesh, 3)
    close(commuting_fields(other, v[faces])[0], u[faces])
    np.testing.assert_array_equal(commuting_fields(mesh, v)[0], u)


def test_a_normal_part_does_not_matter():
    mesh = ellipsoid(2, 1.0, 0.7, 1.6)
    v = wavy_field(mesh, 1)
    tilted = v + 3 * op.face_normals(mesh)
    np.testing.assert_allclose(commuting_fields(mesh, tilted), commuting_fields(mesh, v), atol=1e-6)
    assert relative_bracket(mesh, tilted, v + tilted) < 1e-12


def test_a_larger_weight_gives_a_smaller_bracket_and_a_rougher_field():
    mesh = torus(24, 12)
    v = wavy_field(mesh, 2)
    found = [commuting_fields(mesh, v, weight=weight)[0] for weight in (0, 1, 10, 100)]
    brackets, roughnesses = (
        [measure(u) for u in found]
        for measure in (lambda u: relative_bracket(mesh, v, u), lambda u: roughness(mesh, u))
    )
    assert (np.diff(brackets) < 0).all()
    assert (np.diff(roughnesses) > 0).all()


@pytest.mark.parametrize(
    ("v", "options", "said"),
    [
        (np.zeros((24, 3)), {}, "zero"),
        (np.ones((23, 3)), {}, "expected"),
        (np.full((24, 3), np.nan), {}, "finite"),
        (np.ones((24, 3)), {"count": 0}, "1 to 24"),
        (np.ones((24, 3)), {"count": 25}, "1 to 24"),
        (np.ones((24, 3)), {"weight": -1.0}, "at least 0"),
        (np.ones((24, 3)), {"weight": float("nan")}, "at least 0"),
    ],
)
def test_bad_input_is_refused_in_words(v, options, said):
    with pytest.raises(ParameterError, match=said):
        commuting_fields(disc(2), v, **options)


def test_a_field_of_zero_has_no_relative_bracket():
    mesh = disc(2)
    with pytest.raises(ParameterError, match="zero"):
        relative_bracket(mesh, wavy_field(mesh, 1), np.zeros((len(mesh.faces), 3)))
