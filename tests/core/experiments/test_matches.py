"""Figures 1, 3, 7 and 8: matches, and the shared parts of all figures."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from abfm import Match, Parameters, Problem, match
from abfm.calculus.geodesics import geodesic_distance
from abfm.calculus.operators import gradient, vertex_areas
from abfm.calculus.vector_fields import to_ambient
from abfm.errors import MeshError, ParameterError
from abfm.experiments.figure_07 import smoothness, spread_gap
from abfm.experiments.figure_08 import derivative_rms
from abfm.experiments.scripts import Measure, affordable_iterations, verification_measures
from abfm.functions import function
from abfm.io.sheets import Streaks
from tests.core.experiments.small import ran, run, stated, values
from tests.messages import check_message, raises
from tests.shapes import ellipsoid, icosphere, open_cylinder, tetrahedron, torus


class TestFigures1And3:
    @pytest.fixture(params=[1, 3])
    def default_figure(self, request):
        return ran(request.param)

    def test_source_and_target_have_equal_mass(self, default_figure):
        problem = default_figure[0].problem
        f, g = problem.source[:, 0], problem.target[:, 0]
        areas = vertex_areas(problem.mesh)
        assert areas @ f == pytest.approx(areas @ g, rel=1e-3)
        distances = geodesic_distance(problem.mesh, [int(f.argmax())])
        assert distances[g.argmax()] > 0.8 * distances.max()

    def test_values_move_while_the_blend_fades(self, default_figure):
        example, findings = default_figure
        assert measured(findings, "mismatch at tau") < 0.2  # coarse mesh and few iterations
        methods = ("advection", "optimal transport", "linear blend")
        high = [measured(findings, f"{way}: largest value shown") for way in methods]
        spread = [measured(findings, f"{way}: spread of the mass") for way in methods]
        assert min(high[:2]) > high[2]
        assert max(spread[:2]) < spread[2]
        assert high[0] > 0.8
        assert high[2] <= 0.5
        assert measured(findings, "folded faces") < 0.2
        cooled = example.problem.parameters.paper.cooling_stages > 1
        last = "drift of the mass at tau" + (", with the last" if cooled else "")
        assert measured(findings, "largest drift of the mass") > measured(findings, last)

    def test_measures_have_bounds_and_claims(self, default_figure):
        entries = [measure.to_dict() for measure in default_figure[1].measures]
        assert json.loads(json.dumps(entries)) == entries
        mismatch = entries[0]
        assert mismatch["bound"] == 0.05
        assert mismatch["pass"] == mismatch["reproduces"] == (mismatch["value"] <= 0.05)

    def test_sheet_has_the_frames_of_the_paper(self, default_figure):
        example, findings = default_figure
        first, *methods = findings.sheet.rows
        assert [panel.frame for panel in first] == ["source", "target", "field", "result"]
        assert isinstance(first[2].paint, Streaks)
        np.testing.assert_array_equal(first[0].paint.values, example.problem.source[:, 0])
        np.testing.assert_array_equal(first[1].paint.values, example.problem.target[:, 0])
        assert [len(row) for row in methods] == [5, 5, 5]
        assert len({tuple(panel.label.split(",")[1] for panel in row) for row in methods}) == 1

    @pytest.mark.parametrize(
        "mesh", [torus(24, 12), tetrahedron(), ellipsoid(3, 2.0, 1.0, 0.7), open_cylinder(16, 12)]
    )
    @pytest.mark.parametrize("figure", [1, 3])
    def test_other_meshes_are_matched(self, figure, mesh):
        example, findings = run(figure, mesh)
        f, g = example.problem.source[:, 0], example.problem.target[:, 0]
        areas = vertex_areas(mesh)
        start = np.sqrt(areas @ (f - g) ** 2 / (areas @ g**2))
        assert measured(findings, "mismatch at tau") < 0.7 * start


def measured(findings, name):
    [value] = [measure.value for measure in findings.measures if measure.name.startswith(name)]
    return value


class TestFigure7:
    """The match is close, and measures of smoothness have known values for simple paths."""

    mesh = torus(12, 8)
    x, y = function(mesh, "coordinate:x"), function(mesh, "coordinate:y")

    def test_match_follows_a_smooth_path(self):
        mismatch, by_flow_lines, _, folded, length, step, turn, rise = values(ran(7)[1]).values()
        assert mismatch < 0.1
        assert mismatch < by_flow_lines < 1
        assert folded < 0.05
        assert 1 < length < 1.5
        assert 1 < step < 2
        assert turn < 0.5
        assert rise < 1.5

    def test_straight_paths_are_smoother_than_bent_ones(self):
        path = np.array([self.x + t * (self.y - self.x) for t in np.linspace(0, 1, 6)])
        length, step, turn, rise = (m.value for m in smoothness(self.mesh, path, self.y))
        assert (length, step, rise) == pytest.approx((1, 1, 1))
        assert turn < 1e-12
        # a path that reverses changes its velocity by two steps
        path = np.array([1, 2, 3, 2, 1])[:, None] * self.x
        turn = smoothness(self.mesh, path, self.x)[2]
        assert turn.value == pytest.approx(2)
        assert not turn.reproduces

    def test_spread_gap_is_invariant_and_selects_the_sign(self):
        mesh = ellipsoid(2, 1, 1, 1)
        x, y = function(mesh, "coordinate:x"), function(mesh, "coordinate:y")
        assert spread_gap(mesh, x, y) < 0.01
        # the order of equal values may change
        assert spread_gap(mesh, x, x + 0.5) == pytest.approx(0.5, rel=1e-3)
        mesh = ellipsoid(3, 1, 0.8, 0.6)
        problem = stated(7, mesh).problem
        source, target = problem.source[:, 0], problem.target[:, 0]
        assert spread_gap(mesh, source, target) <= 1.02 * spread_gap(mesh, source, -target)
        np.testing.assert_allclose(np.abs(target), np.abs(function(mesh, "eigenfunction:8")))


class TestFigure8:
    def test_match_recovers_the_hidden_field(self):
        along, share, rate_error, field_error, largest, mismatch, *verification = values(
            ran(8)[1]
        ).values()
        assert along < 0.1
        assert 0.1 < share < 1
        assert rate_error < min(0.1, field_error)
        assert max(largest, mismatch) < 0.02
        assert max(verification) < 0.1
        example = stated(8, torus(24, 12))
        assert np.abs(example.problem.target - example.problem.source).max() > 0.3
        assert example.flow is None

    def test_motion_along_level_lines_changes_nothing(self):
        mesh = torus(24, 12)
        f = mesh.vertices[:, 2]
        slope = to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))
        normals = np.cross(*np.moveaxis(np.diff(mesh.vertices[mesh.faces], axis=1), 1, 0))
        assert derivative_rms(mesh, np.cross(normals, slope), f[None]) < 1e-12
        assert derivative_rms(mesh, slope, f[None]) > 0.1


@pytest.mark.parametrize("figure", [4, 7, 8])
def test_figures_accept_a_mesh_with_boundary(figure):
    assert run(figure, open_cylinder(24, 12))[1].measures


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_measure_that_is_not_finite_is_refused(value):
    with raises(MeshError, "length, m", value):
        Measure("length, m", value)


def test_fine_meshes_have_fewer_iterations():
    counts = [affordable_iterations(icosphere(level), 300) for level in (2, 5, 6)]
    assert counts[0] == 300
    assert 60 < counts[1] < 300
    assert counts[2] == 60


SPHERE = icosphere(2)


@pytest.fixture(scope="module")
def found():
    x, y, _ = SPHERE.vertices.T
    return match(SPHERE, x, y, Parameters.of(iterations=3))


def test_measures_equal_the_verification(found, monkeypatch):
    verification = found.verify()
    measures, notes, missing = verification_measures(found)
    expected = [verification.flow_lines, verification.subdivided, verification.folded]
    assert [measure.value for measure in measures] == expected
    check_message(notes[0], f"along flow lines: {verification.flow_lines:.2g}")
    assert missing == ""
    verification = replace(verification, subdivided=np.inf)
    monkeypatch.setattr(Match, "verify", lambda self: verification)
    measures, _, missing = verification_measures(found)
    assert [measure.value for measure in measures] == [verification.flow_lines, verification.folded]
    assert "overflows" in missing


def test_failed_verification_is_noted(found, monkeypatch):
    def refuse(self):
        raise ParameterError("too fast")

    monkeypatch.setattr(Match, "verify", refuse)
    measures, notes, missing = verification_measures(found)
    assert (measures, notes) == ([], ())
    check_message(missing, "too fast")


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_zero_field_preserves_the_residual(found, share):
    target = found.source * (1 + share)
    problem = Problem(SPHERE, found.source, target, found.parameters)
    still = replace(found, problem=problem, fine_velocity=0 * found.velocity)
    assert verification_measures(still)[0][0].value == pytest.approx(share / (1 + share), abs=1e-9)
