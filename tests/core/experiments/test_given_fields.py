"""Smooth fields on any mesh, and figures 2, 4, 5 and 6: advection by given fields."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.calculus import operators as op
from abfm.calculus import vector_fields as vf
from abfm.calculus.eigenbasis import eigenbasis
from abfm.errors import MeshError
from abfm.experiments import figure_05, figure_06
from abfm.experiments.fields import (
    advected_values,
    departure_points,
    root_mean_square,
    stream_field,
)
from abfm.experiments.figure_02 import FUNCTION, MAP, differences
from abfm.experiments.scripts import loop_subdivided
from abfm.flow.flow import Flow, advect
from abfm.functions import function
from abfm.io.sheets import Streaks
from abfm.mesh import TriangleMesh
from abfm.mesh.shapes import five_limbs
from tests.core.experiments.small import ran, run, stated, value, values
from tests.core.surfaces import SURFACES, edge_divergence, last_order, norm
from tests.messages import raises
from tests.shapes import ellipsoid, open_cylinder, tetrahedron, torus

MODES = {2: 1.0, 3: -0.5}
ANY = pytest.mark.parametrize(
    "mesh", [ellipsoid(3, 1.0, 0.7, 1.6), open_cylinder(24, 12)], ids=["ellipsoid", "cylinder"]
)


@pytest.mark.parametrize("mesh", [ellipsoid(2, 1, 0.7, 0.5), torus(24, 12), open_cylinder(20, 10)])
def test_stream_field_is_divergence_free_and_tangent(mesh):
    field = stream_field(mesh, MODES, 0.3)
    assert root_mean_square(mesh, field) == pytest.approx(0.3 * mesh.length_scale)
    coefficients = np.einsum("fx,fkx->fk", field, op.face_frames(mesh))
    divergence = edge_divergence(mesh) @ coefficients.ravel()
    assert np.abs(divergence).max() < 1e-9 * np.abs(field).max() / mesh.length_scale
    faces = mesh.edge_faces[mesh.is_boundary_edge, 0]  # on a cylinder: circles about z
    assert np.abs(field[faces, 2]).max(initial=0) < 1e-9


def test_flow_lines_are_level_lines_of_stream_function():
    mesh = ellipsoid(2, 1, 0.7, 0.5)
    stream = eigenbasis(mesh.normalized(), 4)[1][:, [2, 3]] @ [1.0, -0.5]
    places = departure_points(mesh, stream_field(mesh, MODES, 0.3), np.array([0.3, 1.0]))
    assert np.linalg.norm(places[1] - mesh.vertices, axis=1).mean() > 0.1 * mesh.length_scale
    assert_allclose(advected_values(mesh, places, stream), np.stack([stream, stream]), atol=1e-9)


def test_meshes_of_figures_are_valid():
    body, eight = five_limbs(500), loop_subdivided("eight.off", 1)
    assert (len(body.vertices), body.genus, body.is_closed) == (500, 0, True)
    assert (len(eight.faces), eight.genus, eight.is_closed) == (4 * 634, 2, True)
    lengths = np.linalg.norm(np.subtract(*body.vertices[body.edges.T]), axis=1)
    assert lengths.max() < 6 * lengths.min()
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    with raises(MeshError):
        stream_field(TriangleMesh(corners, [[0, 1, 2], [0, 2, 3]]), {2: 1.0}, 0.1)


class TestFigure2:
    def test_differences_grow_in_time_and_converge(self):
        found = values(ran(2)[1])
        quarter, half, full = (x for name, x in found.items() if name.startswith("advected"))
        assert 0 < quarter < half < full < 0.3
        orders = [value for name, value in found.items() if name.startswith("order")]
        assert len(orders) == 2
        assert min(orders) > 1
        coarse, fine = (value for name, value in found.items() if "exact solution" in name)
        assert fine < coarse / 2.5

    def test_zero_field_has_no_difference(self):
        mesh = torus(12, 8)
        flow = Flow(mesh, np.zeros((len(mesh.faces), 3)))
        still = differences(flow, function(mesh, "coordinate:x"), np.array([0.5, 1.0]))
        assert max(np.abs(still[what]).max() for what in (FUNCTION, MAP)) < 1e-12
        mesh = open_cylinder(24, 12)
        example, findings = run(2, mesh)
        assert example.problem.mesh is mesh
        lines = findings.sheet.rows[0][-1].lines
        assert all(line.shape[1] == 3 and len(line) > 1 for line in lines)


class TestFigure4:
    """For long times the linear steps oscillate, whereas the exponential does not."""

    def test_linear_steps_overshoot_and_converge(self):
        found = values(ran(4)[1])
        over = {name: x for name, x in found.items() if "t = tau: overshoot over the range" in name}
        one, linear, smooth = (
            over[f"{method}, t = tau: overshoot over the range of f"]
            for method in ("linear, one step", "linear", "nonlinear")
        )
        assert min(one, linear) > 5 * smooth
        one, some, many = (
            found[f"{method}, t = tau: difference from flow lines, relative L2"]
            for method in ("linear, one step", "linear", "linear, 4 times the steps")
        )
        assert one > some > many

    def test_linear_steps_equal_linearised_flow(self):
        example, findings = run(4, ellipsoid(2, 1, 0.7, 0.5))
        flow, steps, f = example.flow, steps_taken(findings), example.problem.source[:, 0]
        mesh, velocity = flow.mesh, np.repeat(flow.velocity, steps, axis=0)
        last = Flow(mesh, velocity, flow.tau, "linearised").push(f)
        panels = [panel for row in findings.sheet.rows for panel in row]
        [shown] = [panel.paint for panel in panels if panel.label == "linear, t = τ"]
        assert_allclose(shown.values, np.clip(last, f.min(), f.max()), atol=1e-9)
        by_lines = advected_values(
            mesh, departure_points(mesh, flow.velocity[0], np.array([flow.tau])), f
        )[0]
        difference, overshoot, excess = (
            x for name, x in values(findings).items() if name.startswith("linear, t = tau: ")
        )
        off = op.l2_norm(mesh, last - by_lines) / op.l2_norm(mesh, by_lines)
        assert difference == pytest.approx(off, rel=1e-6)
        overshoot_of_last = max(last.max() - f.max(), f.min() - last.min()) / (f.max() - f.min())
        assert overshoot == pytest.approx(overshoot_of_last, rel=1e-6)
        assert excess == pytest.approx(variation(mesh, last) / variation(mesh, by_lines) - 1, 1e-6)

    def test_error_of_one_step_is_quadratic_in_time(self):
        mesh = ellipsoid(2, 1, 0.7, 0.5)
        field, f = stream_field(mesh, {2: 1.0, 3: 1.0}, 0.3), function(mesh, "eigenfunction:5")
        slope = vf.directional_derivative(mesh, vf.to_frame(mesh, field)) @ f
        errors = [np.abs(f - t * slope - advect(mesh, field, f, t)).max() for t in (0.02, 0.01)]
        assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)

    def test_number_of_steps_bounds_oscillations(self):
        """A step h grows frequency w by ``sqrt(1 + (h w)^2)``, all steps by at most a million."""
        mesh = ellipsoid(3, 1, 0.7, 0.5)
        uneven = TriangleMesh(mesh.vertices * (0.02 + mesh.vertices[:, :1] ** 2) ** 0.5, mesh.faces)
        example, findings = run(4, uneven)
        derivative = vf.directional_derivative(
            uneven, vf.to_frame(uneven, example.flow.velocity[0])
        )
        exact = np.abs(np.linalg.eigvals(derivative.toarray())).max()
        steps = steps_taken(findings)
        assert steps > 40  # at least one step between two times is always taken
        assert np.sqrt(2 * np.log(1e6) * steps) == pytest.approx(example.flow.tau * exact, rel=0.1)


def steps_taken(findings):
    found = re.search(r"the linear method takes ([\d,]+) steps", findings.setting)
    return int(found[1].replace(",", ""))


def variation(mesh, f):
    """Return the integral of the gradient's norm, with the gradient of each face from two edges."""
    corners, heights = mesh.vertices[mesh.faces], f[mesh.faces]
    edges, rises = corners[:, 1:] - corners[:, :1], heights[:, 1:] - heights[:, :1]
    pairs = zip(edges, rises, strict=True)
    gradient_field = np.stack([np.linalg.pinv(edge) @ rise for edge, rise in pairs])
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    return float(areas @ np.linalg.norm(gradient_field, axis=1))


class TestFigure5:
    """The smoothest commuting field, compared with exact solutions and on any mesh."""

    @pytest.mark.parametrize("name", ["surface of revolution", "torus"])
    def test_result_agrees_with_exact_solution(self, name):
        findings = ran(5)[1]
        [error] = [m for m in findings.measures if name in m.name and "L2 error against" in m.name]
        assert error.value < 0.1
        assert error.reproduces is True
        assert value(findings, name, "order of the error against the exact u") > 0.3
        assert value(findings, name, "order of the bracket") > 0.8
        assert value(findings, name, "bracket norm relative") < 0.15 * value(
            findings, name, "median"
        )
        assert value(findings, name, "exchanged") < 0.02

    def test_exact_solution_is_gradient_of_eigenfunction(self):
        eigenvalue_errors, field_errors = [], []
        for case in figure_05.known_cases((1, 2))[0]:
            mesh = case.mesh
            eigenvalues, functions = eigenbasis(mesh, 16)
            errors = abs(eigenvalues * op.face_areas(mesh).sum() / case.roughness - 1)
            gradient_field = op.gradient(mesh) @ functions[:, errors.argmin()]
            eigenvalue_errors.append(errors.min())
            fields = [vf.to_ambient(mesh, gradient_field.reshape(-1, 2)), case.u]
            u, exact = (field / norm(mesh, field) for field in fields)
            field_errors.append(min(norm(mesh, u - exact), norm(mesh, u + exact)))
        assert last_order(eigenvalue_errors) > 1.5
        assert eigenvalue_errors[-1] < 0.02
        assert last_order(field_errors) > 0.8
        assert field_errors[-1] < 0.1

    def test_exact_solution_on_the_torus_is_harmonic(self):
        errors = [
            norm(c.mesh, c.u - vf.helmholtz_hodge(c.mesh, c.u)[2]) / norm(c.mesh, c.u)
            for c in figure_05.known_cases((1, 2))[1]
        ]
        assert errors[-1] < 0.05
        assert last_order(errors) > 0.9

    @ANY
    def test_any_mesh_has_commuting_fields(self, mesh):
        example, findings = run(5, mesh)
        [v] = example.flow.velocity
        coefficients = np.einsum("fx,fkx->fk", v, op.face_frames(mesh)).ravel()
        along = (op.divergence(mesh) @ coefficients)[~mesh.is_boundary_vertex]
        assert abs(along).max() < 1e-8 * abs(v).max() / mesh.length_scale
        assert value(findings, "bracket norm relative") < value(findings, "median")
        (row,) = findings.sheet.rows
        assert [panel.frame for panel in row] == ["field", "result"]
        assert all(isinstance(panel.paint, Streaks) for panel in row)

    def test_example_is_valid_and_a_triangle_is_refused(self):
        example, _ = ran(5)
        problem = example.problem
        assert example.flow.velocity.shape == (1, len(problem.mesh.faces), 3)
        target, source = problem.target[:, 0], problem.source[:, 0]
        areas = op.vertex_areas(problem.mesh)  # the field has no divergence
        assert areas @ target == pytest.approx(areas @ source, rel=0.02)
        assert abs(target - source).max() > 0.5
        with pytest.raises(MeshError):
            stated(5, SURFACES["triangle"])
        assert stated(5, tetrahedron()).flow is not None


class TestFigure6:
    """Pushed fields, compared with exact solutions, and identities on any mesh."""

    names = ("sphere", "torus, about the axis", "torus, around the tube")

    @pytest.mark.parametrize("name", names)
    def test_pushed_fields_converge_to_exact_fields(self, name):
        _, findings = ran(6)
        found = [m for m in findings.measures if name in m.name]
        assert min(m.value for m in found if "order" in m.name) > 0.75
        errors = {m.name: m.value for m in found if "error" in m.name}
        short, shown = (errors[f"{name}: relative L2 error at t = {t}"] for t in (0.125, 0.25))
        assert short < shown < 0.4
        assert all(m.reproduces for m in found if "transports" in m.claim)

    def test_printed_sign_pushes_backwards(self):
        printed = [m for m in ran(6)[1].measures if "printed sign" in m.name]
        assert len(printed) == 6
        assert all(m.reproduces is False and m.value > 0.5 for m in printed)

    @pytest.mark.parametrize("index", range(3), ids=names)
    def test_exact_fields_solve_the_pushforward_equation(self, index):
        """The exact fields satisfy ``d/dt u = -[v, u]`` and are periodic in time."""
        levels = figure_06.known_cases((1, 2))[index]
        case = levels[0]
        assert_array_equal(case.exact(0.0), case.u)
        assert_allclose(case.exact(2.0), case.u, atol=1e-12)
        assert abs(case.exact(1.0) - case.u).max() > 0.1 * abs(case.u).max()
        errors = []
        for case in levels:
            rate = (case.exact(1e-4) - case.exact(-1e-4)) / 2e-4
            bracket = vf.lie_bracket_of(case.mesh, case.v, case.u)
            errors.append(np.linalg.norm(rate + bracket) / np.linalg.norm(rate))
        assert errors[1] < min(0.6 * errors[0], 0.3)

    @ANY
    def test_pushed_fields_differentiate_advected_functions(self, mesh):
        """Pushed fields commute with advection twice as well as fields of the sign in the paper."""
        example, findings = run(6, mesh)
        for t in ("0.125", "0.25"):
            ours, printed = (
                x for name, x in values(findings).items() if "D_w" in name and f"t = {t}," in name
            )
            assert ours < 0.5 * printed
            assert value(findings, "along itself", f"t = {t}") < 1e-9
        (row,) = findings.sheet.rows
        assert [panel.frame for panel in row] == ["field", "source", "result", "result"]
        assert example.flow.velocity.shape == (1, len(mesh.faces), 3)
