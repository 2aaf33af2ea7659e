"""Frames, and fields as operators: exact identities, and the product rule in the limit."""

import numpy as np
import pytest
from scipy.sparse.linalg import expm_multiply

from abfm.calculus import operators as op
from abfm.calculus.vector_fields import (
    check_field,
    directional_derivative,
    dual_directional_derivative,
    face_directional_derivative,
    to_ambient,
    to_frame,
)
from abfm.errors import ParameterError
from tests.core import torus_calculus as exact
from tests.core.fields import rotation_field, tangent
from tests.core.surfaces import CLOSED, SURFACES, last_order, random_function, relative_error
from tests.shapes import icosphere


def random_frame_field(mesh, seed=0):
    return np.random.default_rng(seed).normal(size=(len(mesh.faces), 2))


def close(actual, expected, scale=1.0):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-12 * scale)


def test_frame_coefficients_are_the_tangent_vectors(mesh):
    field = np.random.default_rng(0).normal(size=(len(mesh.faces), 3))
    coefficients = to_frame(mesh, field)
    close(to_ambient(mesh, coefficients), tangent(mesh, field))
    close(np.linalg.norm(coefficients, axis=1), np.linalg.norm(tangent(mesh, field), axis=1))
    close(to_frame(mesh, op.face_normals(mesh)), 0)


def test_frames_take_several_fields_at_once(mesh):
    fields = np.random.default_rng(0).normal(size=(3, len(mesh.faces), 2))
    back = to_frame(mesh, to_ambient(mesh, fields))
    assert back.shape == fields.shape
    close(back, fields)


def test_derivative_is_its_definition(mesh):
    """At a vertex: the mean of ``<v, grad f>`` over the adjacent faces, weighted by their areas."""
    v, f = random_frame_field(mesh), random_function(mesh)
    on_faces = (to_ambient(mesh, v) * to_ambient(mesh, (op.gradient(mesh) @ f).reshape(-1, 2))).sum(
        axis=1
    )
    weighted, weight = np.zeros((2, len(mesh.vertices)))
    np.add.at(weighted, mesh.faces, (op.face_areas(mesh) * on_faces)[:, None])
    np.add.at(weight, mesh.faces, op.face_areas(mesh)[:, None])
    close(directional_derivative(mesh, v) @ f, weighted / weight, abs(on_faces).max())


def test_constants_have_no_derivative(mesh):
    derivative = directional_derivative(mesh, random_frame_field(mesh))
    close(derivative @ np.ones(len(mesh.vertices)), 0, abs(derivative).max())


def test_derivative_of_the_coordinates_is_the_averaged_field(mesh):
    v = random_frame_field(mesh)
    close(directional_derivative(mesh, v) @ mesh.vertices, op.averaging(mesh) @ to_ambient(mesh, v))


def test_derivative_is_linear_in_the_field(mesh):
    v, u = random_frame_field(mesh, 1), random_frame_field(mesh, 2)
    combined = directional_derivative(mesh, 2 * v - 3 * u)
    separate = 2 * directional_derivative(mesh, v) - 3 * directional_derivative(mesh, u)
    close((combined - separate).toarray(), 0, abs(combined).max())


def test_dual_exchanges_field_and_function(mesh):
    v, f = random_frame_field(mesh), random_function(mesh)
    expected = directional_derivative(mesh, v) @ f
    close(dual_directional_derivative(mesh, f) @ v.ravel(), expected, abs(expected).max())


def test_face_derivative_is_the_gradient_of_the_averaged_function(mesh):
    v, h = random_frame_field(mesh), np.random.default_rng(1).normal(size=len(mesh.faces))
    slope = (op.gradient(mesh) @ (op.averaging(mesh) @ h)).reshape(-1, 2)
    close(
        face_directional_derivative(mesh, v) @ h,
        (v * slope).sum(axis=1),
        abs(op.gradient(mesh)).max(),
    )


def test_symmetric_part_is_the_divergence(mesh):
    """``(G_V D_v + its transpose) / 2``: ``A^T G_F v / 12``, diagonal ``grad^T G_F v / 3``."""
    v = random_frame_field(mesh)
    matrix = (op.vertex_areas(mesh)[:, None] * directional_derivative(mesh, v)).toarray()
    symmetric = (matrix + matrix.T) / 2
    momentum = op.field_mass(mesh) @ v.ravel()
    expected = np.diag(op.gradient(mesh).T @ momentum / 3)
    start, end = mesh.edges.T
    expected[start, end] = expected[end, start] = op.edge_gradient(mesh).T @ momentum / 12
    close(symmetric, expected, abs(matrix).max())


@pytest.mark.parametrize("name", SURFACES)
def test_fields_without_divergence_keep_integral_and_norm(name):
    mesh = SURFACES[name]
    turned = op.hodge_gradients(mesh)[1]
    potential = np.random.default_rng(0).normal(size=turned.shape[1])
    v = (turned @ potential).reshape(-1, 2)
    areas, derivative = op.vertex_areas(mesh), directional_derivative(mesh, v)
    matrix = (areas[:, None] * derivative).toarray()
    close(matrix, -matrix.T, max(abs(matrix).max(), 1e-300))
    f = random_function(mesh)
    speed = max(abs(derivative).sum(axis=1).max(), 1.0)
    advected = expm_multiply(-derivative / speed, f)
    assert areas @ advected == pytest.approx(areas @ f, abs=1e-12)
    assert areas @ advected**2 == pytest.approx(areas @ f**2, rel=1e-12)


@pytest.mark.parametrize("name", CLOSED)
def test_integral_changes_by_the_divergence(name):
    """``int D_v f = -int f div v`` on a closed surface."""
    mesh = SURFACES[name]
    v, f, areas = random_frame_field(mesh), random_function(mesh), op.vertex_areas(mesh)
    change = areas @ (directional_derivative(mesh, v) @ f)
    assert change == pytest.approx(
        -(areas * f) @ (op.divergence(mesh) @ v.ravel()), abs=1e-12 * abs(f).sum()
    )


def test_product_rule_has_order_two():
    errors = []
    for mesh in exact.refined(4):
        v = exact.face_field(mesh, lambda u, v: np.cos(u) * np.sin(v), lambda u, v: np.sin(u + v))
        derivative = directional_derivative(mesh, to_frame(mesh, v))
        f, g = np.sin(mesh.vertices @ [2.0, 1.0, 0.5]), np.cos(mesh.vertices @ [1.0, -1.0, 2.0])
        errors.append(
            relative_error(mesh, derivative @ (f * g), f * (derivative @ g) + g * (derivative @ f))
        )
    assert last_order(errors) == pytest.approx(2, abs=0.05)


def test_rotation_of_the_sphere_turns_linear_functions():
    """``D_v z = (e_x cross p)_z = y`` for the rotation about x."""
    errors = []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        v = to_frame(mesh, rotation_field(mesh, [1, 0, 0]))
        errors.append(
            relative_error(
                mesh, directional_derivative(mesh, v) @ mesh.vertices[:, 2], mesh.vertices[:, 1]
            )
        )
    assert errors[-1] < 4e-3
    assert last_order(errors) > 1.5


@pytest.mark.parametrize(
    ("field", "words"),
    [
        (np.zeros((3, 3)), r"v has shape \(3, 3\); expected \(4, 3\)"),
        (np.zeros((4, 2)), r"expected \(4, 3\), a vector per face"),
        (np.full((4, 3), np.nan), "v has values that are not finite"),
    ],
)
def test_bad_fields_are_refused_in_words(field, words):
    with pytest.raises(ParameterError, match=words):
        check_field(SURFACES["tetrahedron"], field, "v")
