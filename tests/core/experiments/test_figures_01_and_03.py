"""Figures 1 and 3: one Gaussian becomes two."""

from __future__ import annotations

import json

import numpy as np
import pytest

from abfm.calculus.geodesics import geodesic_distance
from abfm.calculus.operators import vertex_areas
from abfm.sheets import Streaks
from tests.core.experiments.small import ran, run
from tests.shapes import ellipsoid, open_cylinder, tetrahedron, torus


@pytest.fixture(params=[1, 3])
def own(request):
    return ran(request.param)


def measured(findings, name):
    [value] = [measure.value for measure in findings.measures if measure.name.startswith(name)]
    return value


def test_the_source_has_the_targets_mass_at_the_other_end_of_the_surface(own):
    problem = own[0].problem
    f, g = problem.source[:, 0], problem.target[:, 0]
    areas = vertex_areas(problem.mesh)
    assert areas @ f == pytest.approx(areas @ g, rel=1e-3)
    distances = geodesic_distance(problem.mesh, [int(f.argmax())])
    assert distances[g.argmax()] > 0.8 * distances.max()


def test_most_of_the_way_is_gone_and_values_move_while_the_blend_fades(own):
    example, findings = own
    assert measured(findings, "mismatch at tau") < 0.2  # coarse, and not until the end
    high, spread = "largest value shown", "spread of the mass"
    for moving in ("advection", "optimal transport"):
        assert measured(findings, f"{moving}: {high}") > measured(findings, f"linear blend: {high}")
        assert measured(findings, f"{moving}: {spread}") < measured(
            findings, f"linear blend: {spread}"
        )
    assert measured(findings, f"linear blend: {high}") <= 0.5
    assert measured(findings, f"advection: {high}") > 0.8
    assert measured(findings, "folded faces") < 0.2
    last = "drift of the mass at tau" + (
        ", with the last" if example.problem.parameters.cooling_stages > 1 else ""
    )
    assert measured(findings, "largest drift of the mass") > measured(findings, last)


def test_measures_say_of_themselves_whether_they_keep_bounds_and_claims(own):
    _, findings = own
    entries = [measure.to_dict() for measure in findings.measures]
    assert json.loads(json.dumps(entries)) == entries
    mismatch = entries[0]
    assert mismatch["bound"] == 0.05
    assert mismatch["pass"] == mismatch["reproduces"] == (mismatch["value"] <= 0.05)


def test_the_sheet_has_the_paper_s_frames_and_the_same_times_for_every_way(own):
    example, findings = own
    first, *ways = findings.sheet.rows
    assert [panel.frame for panel in first] == ["source", "target", "field", "result"]
    assert isinstance(first[2].paint, Streaks)
    np.testing.assert_array_equal(first[0].paint.values, example.problem.source[:, 0])
    np.testing.assert_array_equal(first[1].paint.values, example.problem.target[:, 0])
    assert [len(row) for row in ways] == [5, 5, 5]
    assert len({tuple(panel.label.split(",")[1] for panel in row) for row in ways}) == 1


@pytest.mark.parametrize(
    "mesh", [torus(24, 12), tetrahedron(), ellipsoid(3, 2.0, 1.0, 0.7), open_cylinder(16, 12)]
)
@pytest.mark.parametrize("figure", [1, 3])
def test_other_meshes_do(figure, mesh):
    example, findings = run(figure, mesh)
    f, g = example.problem.source[:, 0], example.problem.target[:, 0]
    areas = vertex_areas(mesh)
    assert measured(findings, "mismatch at tau") < 0.7 * np.sqrt(
        areas @ (f - g) ** 2 / (areas @ g**2)
    )
