"""Operators, compared with identities, libigl, SciPy, and exact derivatives and spectra."""

import igl
import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

from abfm.calculus import operators as op
from abfm.calculus.vector_fields import directional_derivative, to_ambient, to_frame
from tests.core import surfaces
from tests.core.calculus import torus_calculus as exact
from tests.core.fields import tangent
from tests.core.verification import near
from tests.shapes import icosphere, open_cylinder, square, torus

TORI = exact.refined(4)
SPHERES = [icosphere(level) for level in (2, 3, 4)]


def random_field(mesh, seed=0):
    return np.random.default_rng(seed).normal(size=2 * len(mesh.faces))


def in_space(mesh, coefficients):
    return to_ambient(mesh, coefficients.reshape(-1, 2))


def close(actual, expected, scale=None):
    expected = np.asarray(expected)
    largest = abs(expected).max(initial=0) if scale is None else scale
    near(actual, expected, 1e-12 * max(largest, 1e-300))


def relative_size(matrix, *factors):
    """Return the largest entry of a matrix product, relative to that of the absolute values."""
    bound = abs(factors[0])
    for factor in factors[1:]:
        bound = bound @ abs(factor)
    return abs(matrix).max() / bound.max() if 0 not in matrix.shape else 0.0


def test_frames_are_right_handed_and_rotate_by_90_degrees(mesh):
    frames, normals = op.face_frames(mesh), op.face_normals(mesh)
    close(np.einsum("fkx,flx->fkl", frames, frames), np.tile(np.eye(2), (len(frames), 1, 1)))
    close(np.cross(frames[:, 0], frames[:, 1]), normals)
    sides = np.diff(mesh.vertices[mesh.faces], axis=1)
    close(np.einsum("fsx,fx->fs", sides, normals), np.zeros((len(sides), 2)), abs(sides).max())
    v, J = random_field(mesh), op.rotation(mesh)
    close(J @ (J @ v), -v)
    close(in_space(mesh, J @ v), np.cross(op.face_normals(mesh), in_space(mesh, v)))


def test_gradients_of_linear_functions_are_exact(mesh):
    slope = np.array([0.3, -2.0, 1.1])
    exact = slope - (op.face_normals(mesh) @ slope)[:, None] * op.face_normals(mesh)
    f = mesh.vertices @ slope + 5
    close(in_space(mesh, op.gradient(mesh) @ f), exact, 10)
    close(in_space(mesh, op.edge_gradient(mesh) @ f[mesh.edges].mean(axis=1)), exact, 10)


def test_libigl_agrees(mesh):
    assert (op.adjacency(mesh) != igl.adjacency_matrix(mesh.faces)).nnz == 0
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    f = surfaces.random_function(mesh)
    close(op.cotangent_laplacian(mesh).toarray(), -igl.cotmatrix(vertices, faces).toarray())
    close(in_space(mesh, op.gradient(mesh) @ f), (igl.grad(vertices, faces) @ f).reshape(3, -1).T)
    close(op.face_areas(mesh), igl.doublearea(vertices, faces) / 2)
    masses = igl.massmatrix(vertices, faces, igl.MASSMATRIX_TYPE_BARYCENTRIC)
    close(op.vertex_areas(mesh), masses.diagonal())
    edges = (np.array(mesh.edges), mesh.face_edges.T.ravel())
    close(op.edge_areas(mesh), igl.crouzeix_raviart_massmatrix(vertices, faces, *edges).diagonal())
    stiffness = op.edge_gradient(mesh).T @ op.field_mass(mesh) @ op.edge_gradient(mesh)
    close(stiffness.toarray(), igl.crouzeix_raviart_cotmatrix(vertices, faces, *edges).toarray())


def test_averaging_preserves_constants(mesh):
    average, ones = op.averaging(mesh), np.ones(len(mesh.vertices))
    close(average @ np.ones(len(mesh.faces)), ones)
    h = np.random.default_rng(1).normal(size=len(mesh.faces))
    for f in (ones, surfaces.random_function(mesh)):
        at_vertices = (op.vertex_areas(mesh) * f) @ (average @ h)
        at_faces = (op.face_areas(mesh) * f[mesh.faces].mean(axis=1)) @ h
        assert at_vertices == pytest.approx(at_faces, abs=1e-12)


def test_divergence_and_curl_are_adjoint_to_the_gradients(mesh):
    """``<f, div v> = -<grad f, v>`` and ``<f, curl v> = -<J grad f, v>``."""
    v, f, mass = random_field(mesh), surfaces.random_function(mesh), op.field_mass(mesh)
    h = np.random.default_rng(1).normal(size=len(mesh.edges))
    slope, edge_slope = op.gradient(mesh) @ f, op.edge_gradient(mesh) @ h
    f_mass, h_mass = op.vertex_areas(mesh) * f, op.edge_areas(mesh) * h
    for weighted, operator, gradient in (
        (f_mass, op.divergence(mesh), slope),
        (f_mass, op.curl(mesh), op.rotation(mesh) @ slope),
        (h_mass, surfaces.edge_divergence(mesh), edge_slope),
    ):
        size = np.linalg.norm(mass @ gradient) * np.linalg.norm(v)
        assert weighted @ (operator @ v) == pytest.approx(-gradient @ (mass @ v), abs=1e-12 * size)


def test_gradients_have_no_curl(mesh):
    """Gradients have no curl; rotated ones no divergence, if functions are 0 on the boundary."""
    inner = ~mesh.is_boundary_vertex
    gradient, turned = op.gradient(mesh), op.rotation(mesh) @ op.gradient(mesh)
    for operator, field in ((op.curl(mesh), gradient), (op.divergence(mesh), turned)):
        assert relative_size((operator @ field)[inner], operator, field) < 1e-13
    at_edges = surfaces.edge_divergence(mesh)
    assert relative_size((at_edges @ turned)[:, inner], at_edges, turned) < 1e-13


def test_ranges_of_hodge_gradients_are_orthogonal(mesh):
    a, b = op.hodge_gradients(mesh)
    mass = op.field_mass(mesh)
    assert relative_size(a.T @ mass @ b, a.T, mass, b) < 1e-13


@pytest.mark.parametrize("name", surfaces.SURFACES)
def test_dimension_of_harmonic_fields_is_number_of_loops(name):
    mesh = surfaces.SURFACES[name]
    laplacian = op.hodge_laplacian(mesh).toarray()
    close(laplacian, laplacian.T)
    values = eigh(laplacian, op.field_mass(mesh).toarray(), eigvals_only=True)
    assert values.min() > -1e-11 * values.max()
    assert (values < 1e-9 * values.max()).sum() == surfaces.LOOPS.get(name, 0)


@pytest.mark.parametrize("mesh", [SPHERES[0], torus(9, 6), square(5), open_cylinder(8, 3)])
def test_hodge_spectrum_combines_two_scalar_spectra(mesh):
    scalar = [eigh(form.toarray(), np.diag(m), eigvals_only=True) for form, m in hodge_parts(mesh)]
    mass = op.field_mass(mesh).toarray()
    fields = eigh(op.hodge_laplacian(mesh).toarray(), mass, eigvals_only=True)
    found, expected = (
        np.sort(values[values > 1e-9 * values.max()]) for values in (fields, np.concatenate(scalar))
    )
    close(found, expected)


def test_function_norm_is_the_integral(mesh):
    """The squared norm is ``int w f^2 + beta w |grad f|^2`` for a weight w.

    The weight of a face is the smallest weight of its corners.
    """
    f, w = surfaces.random_function(mesh), np.random.default_rng(1).random(len(mesh.vertices))
    squared_slope = ((op.gradient(mesh) @ f).reshape(-1, 2) ** 2).sum(axis=1)
    for weight, at_vertices, at_faces in ((None, 1.0, 1.0), (w, w, w[mesh.faces].min(axis=1))):
        expected = (at_vertices * op.vertex_areas(mesh) * f**2).sum()
        expected += 0.3 * (at_faces * op.face_areas(mesh) * squared_slope).sum()
        assert f @ (op.function_norm_matrix(mesh, 0.3, weight) @ f) == pytest.approx(expected)
    w[::5] = 0
    matrix = op.function_norm_matrix(mesh, 0.3, w)
    assert abs(matrix[w == 0]).max() == abs(matrix[:, w == 0]).max() == 0


def test_vector_norm_is_the_integral(mesh):
    """The squared norm is ``int |v|^2 + alpha (div v)^2 + alpha (curl v)^2``.

    Divergences are integrated over edges, and curls over inner vertices.
    """
    v, inner = random_field(mesh), ~mesh.is_boundary_vertex
    expected = v @ (op.field_mass(mesh) @ v)
    expected += 0.3 * (op.edge_areas(mesh) * (surfaces.edge_divergence(mesh) @ v) ** 2).sum()
    expected += 0.3 * (op.vertex_areas(mesh) * (op.curl(mesh) @ v) ** 2)[inner].sum()
    assert v @ (op.vector_norm_matrix(mesh, 0.3) @ v) == pytest.approx(expected)


def test_l2_norm_uses_channels_and_masks():
    mesh = square(4)
    f = np.tile([3.0, 4.0], (len(mesh.vertices), 1))
    assert op.l2_norm(mesh, f[:, 0]) == pytest.approx(3)
    assert op.l2_norm(mesh, f) == pytest.approx(5)
    left = mesh.vertices[:, 0] < 0.5
    root = np.sqrt(op.vertex_areas(mesh)[left].sum())
    assert op.l2_norm(mesh, f, left) == pytest.approx(5 * root)


def test_operators_are_built_once():
    mesh = square(3)
    some = (op.gradient, op.edge_gradient, op.averaging, op.divergence, op.curl)
    for build in (*some, op.cotangent_laplacian, op.hodge_laplacian):
        assert build(mesh) is build(mesh)


def function(mesh):
    u, v = exact.angles(mesh.vertices)
    return np.cos(u) * np.sin(v)


def exact_gradient(points):
    return exact.vectors(
        points,
        lambda u, v: -np.sin(u) * np.sin(v) / exact.ring(v) ** 2,
        lambda u, v: np.cos(u) * np.cos(v) / exact.MINOR**2,
    )


def field(mesh):
    return exact.face_field(mesh, lambda u, v: np.cos(u) * np.sin(v), lambda u, v: np.sin(u + v))


def exact_divergence(points):
    u, v = exact.angles(points)
    of_ring = exact.MINOR * np.sin(v) / exact.ring(v) * np.sin(u + v)
    return -np.sin(u) * np.sin(v) + np.cos(u + v) - of_ring


def exact_curl(points):
    u, v = exact.angles(points)
    r, ring = exact.MINOR, exact.ring(v)
    circulation = ring**2 * np.cos(u) * np.cos(v) - 2 * r * ring * np.sin(v) ** 2 * np.cos(u)
    return (r**2 * np.cos(u + v) - circulation) / (r * ring)


def exact_derivative(points):
    u, v = exact.angles(points)
    along_u = -np.sin(u) * np.sin(v) * np.cos(u) * np.sin(v)
    return along_u + np.cos(u) * np.cos(v) * np.sin(u + v)


def slopes(mesh):
    return in_space(mesh, op.gradient(mesh) @ function(mesh))


def test_gradient_has_order_one_on_faces():
    errors = [
        surfaces.relative_error(m, slopes(m), exact_gradient(m.vertices[m.faces].mean(axis=1)))
        for m in TORI
    ]
    assert surfaces.last_order(errors) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("values", "answer"),
    [
        (lambda m: op.averaging(m) @ slopes(m), exact_gradient),
        (lambda m: op.divergence(m) @ to_frame(m, field(m)).ravel(), exact_divergence),
        (lambda m: op.curl(m) @ to_frame(m, field(m)).ravel(), exact_curl),
        (
            lambda m: directional_derivative(m, to_frame(m, field(m))) @ function(m),
            exact_derivative,
        ),
    ],
    ids=["averaged gradient", "divergence", "curl", "derivative"],
)
def test_vertex_values_have_order_two(values, answer):
    errors = [abs(values(mesh) - answer(mesh.vertices)).max() for mesh in TORI]
    assert surfaces.last_order(errors) == pytest.approx(2, abs=0.05)


def test_derivative_on_the_sphere_has_order_1_5():
    """The order of the derivative's error is between 1.5 and 2, as icospheres have kinks."""

    def field_at(points):
        x, y, z = points.T
        return np.stack([np.sin(2 * y), z, np.cos(x)], axis=1)

    errors = []
    for mesh in [*SPHERES, icosphere(5)]:
        v = tangent(mesh, field_at(mesh.vertices[mesh.faces].mean(axis=1)))
        x, y, z = mesh.vertices.T
        w = field_at(mesh.vertices)
        w -= (w * mesh.vertices).sum(axis=1)[:, None] * mesh.vertices
        slope = np.stack([y * z, x * z, x * y], axis=1)
        values = directional_derivative(mesh, to_frame(mesh, v)) @ (x * y * z)
        errors.append(surfaces.relative_error(mesh, values, (w * slope).sum(axis=1)))
    assert surfaces.last_order(errors) > 1.5


def lowest(stiffness, mass, count):
    """Return the lowest eigenvalues, ascending, of a symmetric pencil with a diagonal ``mass``."""
    # a large Krylov space, as a random start vector may otherwise miss one of equal eigenvalues
    options = {"v0": np.random.default_rng(0).normal(size=len(mass)), "ncv": 4 * count}
    pencil = sparse.csc_array(stiffness), count, sparse.csc_array(sparse.diags_array(mass))
    return np.sort(eigsh(*pencil, sigma=-1.0, return_eigenvectors=False, **options))


def hodge_parts(mesh):
    """Yield stiffness and mass of edge functions (curl-free) and of vertex functions."""
    (a, b), mass = op.hodge_gradients(mesh), op.field_mass(mesh)
    yield a.T @ mass @ a, op.edge_areas(mesh)
    yield b.T @ mass @ b, op.vertex_areas(mesh)[~mesh.is_boundary_vertex]


@pytest.mark.parametrize("part", [0, 1], ids=["curl-free", "divergence-free"])
def test_hodge_eigenvalues_of_the_unit_sphere_converge(part):
    """Both Hodge parts have eigenvalues 2, 6, 12 of multiplicity 3, 5, 7, with order 2."""
    answer = np.repeat([2, 6, 12], [3, 5, 7])
    errors = []
    for mesh in SPHERES:
        values = lowest(*list(hodge_parts(mesh))[part], 16)
        assert values[0] == pytest.approx(0, abs=1e-9)
        errors.append(abs(values[1:] - answer))
    assert errors[-1].max() < 0.05
    assert (surfaces.last_order(errors) > 1.8).all()
    assert surfaces.last_order([error.max() for error in errors]) == pytest.approx(2, abs=0.05)


def test_hodge_eigenvalues_of_the_unit_square_converge():
    """Fields tangent to the sides have the eigenvalues pi^2, pi^2, 2 pi^2, 2 pi^2, with order 2."""
    errors = []
    for n in (8, 16, 32):
        curl_free, divergence_free = (lowest(*part, 4) for part in hodge_parts(square(n)))
        found = np.array([*curl_free[1:], divergence_free[0]]) / np.pi**2
        errors.append(abs(found - [1, 1, 2, 2]))
    assert surfaces.last_order(errors) == pytest.approx(2, abs=0.05)


def test_lowest_field_of_the_square_has_no_boundary_flux():
    """The field of the lowest eigenvalue, pi^2, has a boundary flux that converges to 0."""
    flux = []
    for n in (8, 16, 32):
        mesh = square(n)
        energy, mass = (sparse.csc_array(m(mesh)) for m in (op.hodge_laplacian, op.field_mass))
        values, fields = eigsh(energy, 1, mass, sigma=-1.0, v0=np.ones(2 * len(mesh.faces)))
        v = in_space(mesh, fields[:, 0])
        at_side = mesh.edge_faces[mesh.is_boundary_edge, 0]
        sides = mesh.vertices[mesh.edges[mesh.is_boundary_edge]]
        along_y = abs(np.diff(sides, axis=1)[:, 0, 1]) > 1e-9
        normal = np.where(along_y, v[at_side, 0], v[at_side, 1])
        flux.append(abs(normal).max() / abs(v).max())
    assert values[0] == pytest.approx(np.pi**2, rel=2e-3)
    assert surfaces.last_order(flux) > 0.9
