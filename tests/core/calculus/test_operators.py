"""Identities, kernels, invariances, boundaries of the operators; libigl and SciPy as oracles."""

import igl
import numpy as np
import pytest
from scipy.linalg import eigh

from abfm.calculus import operators as op
from abfm.calculus.vector_fields import to_ambient, to_frame
from tests.core.surfaces import (
    CLOSED,
    LOOPS,
    SURFACES,
    WITH_BOUNDARY,
    edge_divergence,
    random_function,
)
from tests.shapes import open_cylinder, square, torus

MATRICES = {
    "gradient": op.gradient,
    "edge_gradient": op.edge_gradient,
    "averaging": op.averaging,
    "divergence": op.divergence,
    "curl": op.curl,
    "cotangent_laplacian": op.cotangent_laplacian,
    "hodge_laplacian": op.hodge_laplacian,
}


def random_field(mesh, seed=0):
    return np.random.default_rng(seed).normal(size=2 * len(mesh.faces))


def in_space(mesh, coefficients):
    return to_ambient(mesh, coefficients.reshape(-1, 2))


def close(actual, expected, scale=None):
    expected = np.asarray(expected)
    largest = abs(expected).max(initial=0) if scale is None else scale
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-12 * max(largest, 1e-300))


def relative_size(matrix, *factors):
    """Largest entry of a product over what rounding would leave of it if nothing cancelled."""
    bound = abs(factors[0])
    for factor in factors[1:]:
        bound = bound @ abs(factor)
    return abs(matrix).max() / bound.max() if 0 not in matrix.shape else 0.0


def test_every_mass_holds_the_whole_area(mesh):
    corners = mesh.vertices[mesh.faces]
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
    half = sides.sum(axis=1) / 2
    heron = np.sqrt(half * (half - sides[:, 0]) * (half - sides[:, 1]) * (half - sides[:, 2]))
    np.testing.assert_allclose(op.face_areas(mesh), heron, rtol=1e-10)
    for areas in (op.vertex_areas(mesh), op.edge_areas(mesh)):
        assert areas.min() > 0
        assert areas.sum() == pytest.approx(heron.sum(), rel=1e-10)


def test_frames_are_orthonormal_tangent_and_right_handed(mesh):
    frames, normals = op.face_frames(mesh), op.face_normals(mesh)
    close(
        np.einsum("fkx,flx->fkl", frames, frames), np.broadcast_to(np.eye(2), (len(frames), 2, 2))
    )
    close(np.cross(frames[:, 0], frames[:, 1]), normals)
    sides = np.diff(mesh.vertices[mesh.faces], axis=1)
    close(np.einsum("fsx,fx->fs", sides, normals), np.zeros((len(sides), 2)), abs(sides).max())


def test_gradients_of_linear_functions_are_exact(mesh):
    slope = np.array([0.3, -2.0, 1.1])
    exact = slope - (op.face_normals(mesh) @ slope)[:, None] * op.face_normals(mesh)
    f = mesh.vertices @ slope + 5
    close(in_space(mesh, op.gradient(mesh) @ f), exact, 10)
    close(in_space(mesh, op.edge_gradient(mesh) @ f[mesh.edges].mean(axis=1)), exact, 10)


def test_constants_have_no_gradient(mesh):
    ones = np.ones(max(len(mesh.vertices), len(mesh.edges)))
    for gradient in (op.gradient(mesh), op.edge_gradient(mesh)):
        close(
            gradient @ ones[: gradient.shape[1]], np.zeros(gradient.shape[0]), abs(gradient).max()
        )


def test_libigl_agrees(mesh):
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    f = random_function(mesh)
    close(op.cotangent_laplacian(mesh).toarray(), -igl.cotmatrix(vertices, faces).toarray())
    close(in_space(mesh, op.gradient(mesh) @ f), (igl.grad(vertices, faces) @ f).reshape(3, -1).T)
    masses = igl.massmatrix(vertices, faces, igl.MASSMATRIX_TYPE_BARYCENTRIC)
    close(op.vertex_areas(mesh), masses.diagonal())
    edges = (np.array(mesh.edges), mesh.face_edges.T.ravel())
    close(op.edge_areas(mesh), igl.crouzeix_raviart_massmatrix(vertices, faces, *edges).diagonal())
    stiffness = op.edge_gradient(mesh).T @ op.field_mass(mesh) @ op.edge_gradient(mesh)
    close(stiffness.toarray(), igl.crouzeix_raviart_cotmatrix(vertices, faces, *edges).toarray())


def test_rotation_turns_by_a_right_angle(mesh):
    v, J = random_field(mesh), op.rotation(mesh)
    close(J @ (J @ v), -v)
    close(in_space(mesh, J @ v), np.cross(op.face_normals(mesh), in_space(mesh, v)))


def test_averaging_keeps_constants_and_integrals(mesh):
    average, h = op.averaging(mesh), np.random.default_rng(0).normal(size=len(mesh.faces))
    close(average @ np.ones(len(mesh.faces)), np.ones(len(mesh.vertices)))
    assert op.vertex_areas(mesh) @ (average @ h) == pytest.approx(
        op.face_areas(mesh) @ h, abs=1e-12
    )


def test_averaging_is_the_adjoint_of_the_mean_over_corners(mesh):
    f, h = random_function(mesh), np.random.default_rng(1).normal(size=len(mesh.faces))
    at_vertices = (op.vertex_areas(mesh) * f) @ (op.averaging(mesh) @ h)
    assert at_vertices == pytest.approx(
        (op.face_areas(mesh) * f[mesh.faces].mean(axis=1)) @ h, abs=1e-12
    )


def test_divergence_and_curl_are_adjoint_to_the_gradients(mesh):
    """``<f, div v> = -<grad f, v>`` and ``<f, curl v> = -<J grad f, v>`` in the masses' inner
    products.
    """
    v, f = random_field(mesh), random_function(mesh)
    h = np.random.default_rng(1).normal(size=len(mesh.edges))
    mass = op.field_mass(mesh)
    slope, edge_slope = op.gradient(mesh) @ f, op.edge_gradient(mesh) @ h
    size = np.linalg.norm(mass @ slope) * np.linalg.norm(v)
    edge_size = np.linalg.norm(mass @ edge_slope) * np.linalg.norm(v)
    f_mass, h_mass = op.vertex_areas(mesh) * f, op.edge_areas(mesh) * h
    assert f_mass @ (op.divergence(mesh) @ v) == pytest.approx(
        -slope @ (mass @ v), abs=1e-12 * size
    )
    assert f_mass @ (op.curl(mesh) @ v) == pytest.approx(
        -(op.rotation(mesh) @ slope) @ (mass @ v), abs=1e-12 * size
    )
    assert h_mass @ (edge_divergence(mesh) @ v) == pytest.approx(
        -edge_slope @ (mass @ v), abs=1e-12 * edge_size
    )


def test_gradients_have_no_curl_and_turned_gradients_no_divergence(mesh):
    """Away from the boundary; at edges too, of functions that are zero on it."""
    inner = ~mesh.is_boundary_vertex
    gradient, turned = op.gradient(mesh), op.rotation(mesh) @ op.gradient(mesh)
    for operator, field in ((op.curl(mesh), gradient), (op.divergence(mesh), turned)):
        assert relative_size((operator @ field)[inner], operator, field) < 1e-13
    at_edges = edge_divergence(mesh)
    assert relative_size((at_edges @ turned)[:, inner], at_edges, turned) < 1e-13


def test_ranges_of_the_hodge_gradients_are_orthogonal(mesh):
    a, b = op.hodge_gradients(mesh)
    mass = op.field_mass(mesh)
    assert relative_size(a.T @ mass @ b, a.T, mass, b) < 1e-13


@pytest.mark.parametrize("name", SURFACES)
def test_harmonic_fields_count_the_loops(name):
    mesh = SURFACES[name]
    laplacian = op.hodge_laplacian(mesh).toarray()
    close(laplacian, laplacian.T)
    values = eigh(laplacian, op.field_mass(mesh).toarray(), eigvals_only=True)
    assert values.min() > -1e-11 * values.max()
    assert (values < 1e-9 * values.max()).sum() == LOOPS.get(name, 0)


@pytest.mark.parametrize(
    "make", [lambda: torus(9, 6), lambda: square(5), lambda: open_cylinder(8, 3)]
)
def test_hodge_spectrum_is_that_of_two_scalar_problems(make):
    mesh = make()
    mass = op.field_mass(mesh).toarray()
    masses = (op.edge_areas(mesh), op.vertex_areas(mesh)[~mesh.is_boundary_vertex])
    scalar = [
        eigh((basis.T @ mass @ basis), np.diag(areas), eigvals_only=True)
        for basis, areas in zip(op.hodge_gradients(mesh), masses, strict=True)
    ]
    fields = eigh(op.hodge_laplacian(mesh).toarray(), mass, eigvals_only=True)
    close(_without_zeros(fields), _without_zeros(np.concatenate(scalar)))


def _without_zeros(values):
    return np.sort(values[values > 1e-9 * values.max()])


@pytest.mark.parametrize("name", CLOSED)
def test_the_kernel_of_the_laplacian_is_the_constants(name):
    stiffness = op.cotangent_laplacian(SURFACES[name]).toarray()
    close(stiffness, stiffness.T)
    values = eigh(stiffness, eigvals_only=True)
    assert abs(values[0]) < 1e-12 * values[-1]
    assert values[1] > 1e-6 * values[-1]


@pytest.mark.parametrize("name", WITH_BOUNDARY)
def test_fields_count_as_ending_at_the_boundary(name):
    """Whatever crosses the boundary or runs along it, divergence and curl have total zero."""
    mesh = SURFACES[name]
    v = random_field(mesh)
    for operator in (op.divergence(mesh), op.curl(mesh)):
        assert op.vertex_areas(mesh) @ (operator @ v) == pytest.approx(
            0, abs=1e-12 * np.linalg.norm(v)
        )


def test_boundary_terms_are_flux_and_circulation():
    mesh = square(6)
    w = np.array([0.7, -0.2, 0.0])
    ends = mesh.vertices[mesh.edges[mesh.is_boundary_edge]]
    along = ends[:, 1] - ends[:, 0]
    outward = np.cross(along, [0, 0, 1])
    outward *= np.sign(((ends.mean(axis=1) - [0.5, 0.5, 0]) * outward).sum(axis=1))[:, None]
    counterclockwise = np.cross([0, 0, 1], outward)
    v = to_frame(mesh, np.broadcast_to(w, (len(mesh.faces), 3))).ravel()
    for operator, direction in ((op.divergence(mesh), outward), (op.curl(mesh), counterclockwise)):
        expected = np.zeros(len(mesh.vertices))
        np.add.at(expected, mesh.edges[mesh.is_boundary_edge], -0.5 * (direction @ w)[:, None])
        close(op.vertex_areas(mesh) * (operator @ v), expected)


def test_function_norm_is_the_integral(mesh):
    """``int w f^2 + beta w |grad f|^2``, with the least weight of its corners on every face."""
    f, w = random_function(mesh), np.random.default_rng(1).random(len(mesh.vertices))
    squared_slope = ((op.gradient(mesh) @ f).reshape(-1, 2) ** 2).sum(axis=1)
    for weight, at_vertices, at_faces in ((None, 1.0, 1.0), (w, w, w[mesh.faces].min(axis=1))):
        expected = (at_vertices * op.vertex_areas(mesh) * f**2).sum()
        expected += 0.3 * (at_faces * op.face_areas(mesh) * squared_slope).sum()
        assert f @ (op.function_norm_matrix(mesh, 0.3, weight) @ f) == pytest.approx(expected)


def test_values_without_weight_do_not_matter():
    mesh = SURFACES["torus"]
    weight = (mesh.vertices[:, 0] > 0).astype(float)
    matrix = op.function_norm_matrix(mesh, 0.3, weight)
    assert abs(matrix[weight == 0]).max() == 0
    assert abs(matrix[:, weight == 0]).max() == 0


def test_vector_norm_is_the_integral(mesh):
    """``int |v|^2 + alpha (div v)^2 + alpha (curl v)^2``, at edges and inner vertices."""
    v, inner = random_field(mesh), ~mesh.is_boundary_vertex
    expected = v @ (op.field_mass(mesh) @ v)
    expected += 0.3 * (op.edge_areas(mesh) * (edge_divergence(mesh) @ v) ** 2).sum()
    expected += 0.3 * (op.vertex_areas(mesh) * (op.curl(mesh) @ v) ** 2)[inner].sum()
    assert v @ (op.vector_norm_matrix(mesh, 0.3) @ v) == pytest.approx(expected)


def test_l2_norm_of_channels_and_masks():
    mesh = square(4)
    f = np.stack([np.full(len(mesh.vertices), 3.0), np.full(len(mesh.vertices), 4.0)], axis=1)
    assert op.l2_norm(mesh, f[:, 0]) == pytest.approx(3)
    assert op.l2_norm(mesh, f) == pytest.approx(5)
    left = mesh.vertices[:, 0] < 0.5
    assert op.l2_norm(mesh, f, left) == pytest.approx(
        5 * np.sqrt(op.vertex_areas(mesh)[left].sum())
    )


def test_operators_are_built_once():
    mesh = square(3)
    for build in MATRICES.values():
        assert build(mesh) is build(mesh)
