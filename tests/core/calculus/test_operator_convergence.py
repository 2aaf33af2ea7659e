"""Orders of convergence of the operators under refinement, against exact derivatives and spectra.

A gradient that is constant on each face has order 1, averaged to the vertices of a smoothly varying
mesh order 2; so do divergence, curl, the Laplacian in the weak sense, and every eigenvalue.
Icospheres have irregular vertices and kinks along the edges of all their coarser levels, where
pointwise errors fall more slowly.
"""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import eigsh

from abfm.calculus import operators as op
from abfm.calculus.vector_fields import directional_derivative, to_ambient, to_frame
from tests.core import torus_calculus as exact
from tests.core.fields import tangent
from tests.core.surfaces import last_order, relative_error
from tests.shapes import icosphere, square

TORI = exact.refined(4)
SPHERES = [icosphere(level) for level in (2, 3, 4)]


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
    return (
        -np.sin(u) * np.sin(v)
        + np.cos(u + v)
        - exact.MINOR * np.sin(v) / exact.ring(v) * np.sin(u + v)
    )


def exact_curl(points):
    u, v = exact.angles(points)
    r, ring = exact.MINOR, exact.ring(v)
    circulation = ring**2 * np.cos(u) * np.cos(v) - 2 * r * ring * np.sin(v) ** 2 * np.cos(u)
    return (r**2 * np.cos(u + v) - circulation) / (r * ring)


def test_gradient_has_order_one_on_faces():
    errors = []
    for mesh in TORI:
        values = to_ambient(mesh, (op.gradient(mesh) @ function(mesh)).reshape(-1, 2))
        errors.append(
            relative_error(mesh, values, exact_gradient(mesh.vertices[mesh.faces].mean(axis=1)))
        )
    assert last_order(errors) == pytest.approx(1, abs=0.02)


def test_averaged_gradient_has_order_two():
    errors = []
    for mesh in TORI:
        values = op.averaging(mesh) @ to_ambient(
            mesh, (op.gradient(mesh) @ function(mesh)).reshape(-1, 2)
        )
        errors.append(abs(values - exact_gradient(mesh.vertices)).max())
    assert last_order(errors) == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize(
    ("operator", "answer"),
    [(op.divergence, exact_divergence), (op.curl, exact_curl)],
    ids=["divergence", "curl"],
)
def test_divergence_and_curl_have_order_two(operator, answer):
    errors = []
    for mesh in TORI:
        values = operator(mesh) @ to_frame(mesh, field(mesh)).ravel()
        errors.append(abs(values - answer(mesh.vertices)).max())
    assert last_order(errors) == pytest.approx(2, abs=0.05)


def test_directional_derivative_has_order_two():
    errors = []
    for mesh in TORI:
        values = directional_derivative(mesh, to_frame(mesh, field(mesh))) @ function(mesh)
        u, v = exact.angles(mesh.vertices)
        answer = -np.cos(u) * np.sin(v) * np.sin(u) * np.sin(v) + np.sin(u + v) * np.cos(
            u
        ) * np.cos(v)
        errors.append(abs(values - answer).max())
    assert last_order(errors) == pytest.approx(2, abs=0.05)


def test_directional_derivative_on_the_sphere_has_order_one_and_a_half():
    errors = []
    for mesh in [*SPHERES, icosphere(5)]:
        centres = mesh.vertices[mesh.faces].mean(axis=1)
        v = tangent(
            mesh,
            np.stack([np.sin(2 * centres[:, 1]), centres[:, 2], np.cos(centres[:, 0])], axis=1),
        )
        x, y, z = mesh.vertices.T
        w = np.stack([np.sin(2 * y), z, np.cos(x)], axis=1)
        w -= (w * mesh.vertices).sum(axis=1)[:, None] * mesh.vertices
        slope = np.stack([y * z, x * z, x * y], axis=1)
        values = directional_derivative(mesh, to_frame(mesh, v)) @ (x * y * z)
        errors.append(relative_error(mesh, values, (w * slope).sum(axis=1)))
    assert last_order(errors) > 1.5


def test_laplacian_has_order_two_in_the_weak_sense():
    """``int |grad f|^2`` for a spherical harmonic of eigenvalue 6: ``6 int (x y)^2 = 8 pi / 5``."""
    errors = []
    for mesh in SPHERES:
        f = mesh.vertices[:, 0] * mesh.vertices[:, 1]
        errors.append(abs(f @ (op.cotangent_laplacian(mesh) @ f) - 8 * np.pi / 5))
    assert last_order(errors) == pytest.approx(2, abs=0.05)


def lowest(stiffness, mass, count):
    """Lowest eigenvalues, ascending, of a symmetric pencil; ``mass`` is a diagonal."""
    matrices = (sparse.csc_array(stiffness), sparse.csc_array(sparse.diags_array(mass)))
    # with room for multiplicities, of which a start by chance may else miss one
    room = {"v0": np.random.default_rng(0).normal(size=len(mass)), "ncv": 4 * count}
    stiffness, mass = matrices
    found = eigsh(stiffness, count, mass, sigma=-1.0, return_eigenvectors=False, **room)
    return np.sort(found)


def hodge_parts(mesh):
    """Stiffness and mass of both parts: of edge functions, curl-free, and of vertex functions."""
    (a, b), mass = op.hodge_gradients(mesh), op.field_mass(mesh)
    yield a.T @ mass @ a, op.edge_areas(mesh)
    yield b.T @ mass @ b, op.vertex_areas(mesh)[~mesh.is_boundary_vertex]


@pytest.mark.parametrize("part", [0, 1], ids=["curl-free", "divergence-free"])
def test_hodge_eigenvalues_of_the_unit_sphere(part):
    """2, 6, 12 with multiplicities 3, 5, 7 in both parts, of order 2."""
    answer = np.repeat([2, 6, 12], [3, 5, 7])
    errors = []
    for mesh in SPHERES:
        values = lowest(*list(hodge_parts(mesh))[part], 16)
        assert values[0] == pytest.approx(0, abs=1e-9)
        errors.append(abs(values[1:] - answer))
    assert errors[-1].max() < 0.05
    assert (last_order(errors) > 1.8).all()
    assert last_order([error.max() for error in errors]) == pytest.approx(2, abs=0.05)


def test_hodge_eigenvalues_are_those_of_fields():
    """The lowest thirteen of the vector problem: both triples of 2, both quintuples of 6."""
    mesh = SPHERES[1]
    values = lowest(op.hodge_laplacian(mesh), np.repeat(op.face_areas(mesh), 2), 16)
    np.testing.assert_allclose(values, np.repeat([2, 6], [6, 10]), rtol=6e-3)


def test_hodge_eigenvalues_of_the_unit_square():
    """``v . n = 0``: pi^2 twice and 2 pi^2 of ``cos cos``, 2 pi^2 of turned ``sin sin``."""
    errors = []
    for n in (8, 16, 32):
        curl_free, divergence_free = (lowest(*part, 4) for part in hodge_parts(square(n)))
        found = np.array([*curl_free[1:], divergence_free[0]]) / np.pi**2
        errors.append(abs(found - [1, 1, 2, 2]))
    assert last_order(errors) == pytest.approx(2, abs=0.05)


def test_fields_of_the_unit_square_leave_the_boundary_alone():
    """The lowest field has the eigenvalue pi^2 and no flux through the sides."""
    flux = []
    for n in (8, 16, 32):
        mesh = square(n)
        matrices = (
            sparse.csc_array(op.hodge_laplacian(mesh)),
            sparse.csc_array(op.field_mass(mesh)),
        )
        values, fields = eigsh(
            matrices[0], 1, matrices[1], sigma=-1.0, v0=np.ones(2 * len(mesh.faces))
        )
        v = to_ambient(mesh, fields[:, 0].reshape(-1, 2))
        at_side = mesh.edge_faces[mesh.is_boundary_edge, 0]
        along_y = (
            abs(np.diff(mesh.vertices[mesh.edges[mesh.is_boundary_edge]], axis=1)[:, 0, 1]) > 1e-9
        )
        normal = np.where(along_y, v[at_side, 0], v[at_side, 1])
        flux.append(abs(normal).max() / abs(v).max())
    assert values[0] == pytest.approx(np.pi**2, rel=2e-3)
    assert last_order(flux) > 0.9
