"""Figure 5: the smoothest commuting field, against known answers and on any mesh."""

import numpy as np
import pytest

from abfm.calculus import operators as op
from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.helmholtz_hodge import helmholtz_hodge
from abfm.calculus.vector_fields import to_ambient
from abfm.errors import MeshError
from abfm.experiments.figure_05 import known_cases
from abfm.sheets import Streaks
from tests.core.experiments.small import ran, run, stated
from tests.core.surfaces import SURFACES, last_order, norm
from tests.shapes import ellipsoid, open_cylinder, tetrahedron


def found(findings, *words):
    """The one measure with all these words in its name."""
    (measure,) = [m for m in findings.measures if all(word in m.name for word in words)]
    return measure


@pytest.mark.parametrize("name", ["surface of revolution", "torus"])
def test_the_known_answer_comes_out(name):
    _, own = ran(5)
    error = found(own, name, "L2 error against the exact")
    assert error.value < 0.1
    assert error.reproduces is True
    assert found(own, name, "order of that error").value > 0.3
    assert found(own, name, "order of the bracket").value > 0.8
    usual = found(own, name, "median").value
    assert found(own, name, "bracket norm relative").value < 0.15 * usual
    assert found(own, name, "exchanged").value < 0.02


def difference(mesh, u, exact):
    """Relative L2 difference of fields that are determined up to a factor."""
    u, exact = u / norm(mesh, u), exact / norm(mesh, exact)
    return min(norm(mesh, u - exact), norm(mesh, u + exact))


def test_the_exact_answer_on_the_surface_of_revolution_is_the_gradient_of_an_eigenfunction():
    """The one-dimensional problem's eigenvalue and slopes are those of a Laplacian on the mesh."""
    eigenvalue_errors, field_errors = [], []
    for case in known_cases((1, 2))[0]:
        values, functions = eigenbasis(case.mesh, 16)
        errors = abs(values * op.face_areas(case.mesh).sum() / case.roughness - 1)
        slopes = op.gradient(case.mesh) @ functions[:, errors.argmin()]
        eigenvalue_errors.append(errors.min())
        field_errors.append(
            difference(case.mesh, to_ambient(case.mesh, slopes.reshape(-1, 2)), case.u)
        )
    assert last_order(eigenvalue_errors) > 1.5
    assert eigenvalue_errors[-1] < 0.02
    assert last_order(field_errors) > 0.8
    assert field_errors[-1] < 0.1


def test_the_exact_answer_on_the_torus_is_harmonic():
    errors = [
        norm(case.mesh, case.u - helmholtz_hodge(case.mesh, case.u)[2]) / norm(case.mesh, case.u)
        for case in known_cases((1, 2))[1]
    ]
    assert errors[-1] < 0.05
    assert last_order(errors) > 0.9


@pytest.mark.parametrize(
    "mesh", [ellipsoid(3, 1.0, 0.7, 1.6), open_cylinder(24, 12)], ids=["ellipsoid", "cylinder"]
)
def test_any_mesh_has_a_field_that_stirs_it_and_one_that_commutes(mesh):
    example, findings = run(5, mesh)
    [v] = example.flow.velocity
    coefficients = np.einsum("fx,fkx->fk", v, op.face_frames(mesh)).ravel()
    along = (op.divergence(mesh) @ coefficients)[~mesh.is_boundary_vertex]
    assert abs(along).max() < 1e-8 * abs(v).max() / mesh.length_scale
    usual = found(findings, "median").value
    assert found(findings, "bracket norm relative").value < usual
    (row,) = findings.sheet.rows
    assert [panel.frame for panel in row] == ["field", "result"]
    assert all(isinstance(panel.paint, Streaks) for panel in row)


def test_setups_open_in_the_app():
    example, _ = ran(5)
    problem = example.problem
    assert example.flow.velocity.shape == (1, len(problem.mesh.faces), 3)
    carried, source = problem.target[:, 0], problem.source[:, 0]
    areas = op.vertex_areas(problem.mesh)
    assert areas @ carried == pytest.approx(areas @ source, rel=0.02)  # the field has no divergence
    assert abs(carried - source).max() > 0.5


def test_a_mesh_without_room_for_a_field_is_refused():
    with pytest.raises(MeshError):
        stated(5, SURFACES["triangle"])
    assert stated(5, tetrahedron()).flow is not None
