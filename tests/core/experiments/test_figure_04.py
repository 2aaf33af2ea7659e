"""Figure 4: linear steps oscillate in the end, the exponential does not."""

from __future__ import annotations

import numpy as np
import pytest

from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.experiments import figure_04
from abfm.experiments.figure_04 import EXPERIMENT
from abfm.experiments.given_flow import stream_field
from abfm.flow.advection import advect
from abfm.flow.flow import Flow
from abfm.functions import function
from tests.shapes import ellipsoid, open_cylinder


@pytest.fixture(scope="module")
def values() -> dict[str, float]:
    findings = EXPERIMENT.run(EXPERIMENT.set_up(None, True), lambda text, share: None)
    return {measure.name: measure.value for measure in findings.measures}


def test_linear_steps_overshoot_where_the_exponential_does_not(values: dict[str, float]) -> None:
    what = "overshoot over the range of f"
    assert values[f"linear, t = tau: {what}"] > 5 * values[f"nonlinear, t = tau: {what}"]
    assert values[f"linear, one step, t = tau: {what}"] > 5 * values[f"nonlinear, t = tau: {what}"]


def test_more_linear_steps_come_closer_to_the_flow(values: dict[str, float]) -> None:
    ways = ("linear, one step", "linear", "linear, 4 times the steps")
    one, some, many = (values[f"{way}, t = tau: difference from flow lines, relative L2"] for way in ways)
    assert one > some > many


def test_linear_steps_are_those_of_the_library() -> None:
    mesh = ellipsoid(2, 1, 0.7, 0.5)
    field, f = stream_field(mesh, {2: 1.0, 3: 1.0}, 0.3), function(mesh, "eigenfunction:5")
    derivative = directional_derivative(mesh, to_frame(mesh, field))
    steps = len(figure_04._TIMES) - 1
    last = figure_04._linear_steps(derivative, f, 1 / steps, 1)[-1]
    flow = Flow(mesh, np.repeat(field[None], steps, axis=0), method="linearised")
    np.testing.assert_allclose(last, flow.push(f, 1.0), atol=1e-12)


def test_one_step_errs_by_the_square_of_the_time() -> None:
    mesh = ellipsoid(2, 1, 0.7, 0.5)
    field, f = stream_field(mesh, {2: 1.0, 3: 1.0}, 0.3), function(mesh, "eigenfunction:5")
    derivative = directional_derivative(mesh, to_frame(mesh, field))
    errors = [np.abs(f - t * (derivative @ f) - advect(mesh, field, f, t)).max() for t in (0.02, 0.01)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def test_highest_frequency() -> None:
    mesh = ellipsoid(1, 1, 0.7, 0.5)
    derivative = directional_derivative(mesh, to_frame(mesh, stream_field(mesh, {2: 1.0, 3: 1.0}, 0.3)))
    exact = np.abs(np.linalg.eigvals(derivative.toarray())).max()
    assert figure_04._fastest(derivative) == pytest.approx(exact, rel=0.1)


def test_variation_of_a_linear_function_is_its_slope_times_the_area() -> None:
    mesh = open_cylinder(30, 5)
    assert figure_04._variation(mesh, 3 * mesh.vertices[:, 2]) == pytest.approx(3 * mesh.length_scale**2)


def test_on_another_mesh_with_a_boundary() -> None:
    mesh = open_cylinder(24, 12)
    findings = EXPERIMENT.run(EXPERIMENT.set_up(mesh, True), lambda text, share: None)
    assert all(np.isfinite(measure.to_dict()["value"]) for measure in findings.measures)
