"""Figure 4: linear steps oscillate in the end, the exponential does not."""

from __future__ import annotations

import re

import numpy as np
import pytest

from abfm.calculus.operators import l2_norm
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.experiments import Example, Findings
from abfm.experiments.fields import carried, feet, stream_field
from abfm.flow.flow import Flow, advect
from abfm.functions import function
from abfm.mesh import TriangleMesh
from abfm.sheets import Panel, Values
from tests.core.experiments.small import ran, run, values
from tests.shapes import ellipsoid, open_cylinder


def test_linear_steps_overshoot_where_the_exponential_does_not() -> None:
    found = values(ran(4)[1])
    what = "overshoot over the range of f"
    assert found[f"linear, t = tau: {what}"] > 5 * found[f"nonlinear, t = tau: {what}"]
    assert found[f"linear, one step, t = tau: {what}"] > 5 * found[f"nonlinear, t = tau: {what}"]


def test_more_linear_steps_come_closer_to_the_flow() -> None:
    found = values(ran(4)[1])
    ways = ("linear, one step", "linear", "linear, 4 times the steps")
    one, some, many = (
        found[f"{way}, t = tau: difference from flow lines, relative L2"] for way in ways
    )
    assert one > some > many


@pytest.fixture(scope="module")
def on_an_ellipsoid() -> tuple[Example, Findings]:
    return run(4, ellipsoid(2, 1, 0.7, 0.5))


def steps_taken(findings: Findings) -> int:
    found = re.search(r"the linear way takes ([\d,]+) steps", findings.setting)
    assert found is not None
    return int(found[1].replace(",", ""))


def test_linear_steps_are_those_of_the_library(on_an_ellipsoid: tuple[Example, Findings]) -> None:
    example, findings = on_an_ellipsoid
    flow, steps, f = example.flow, steps_taken(findings), example.problem.source[:, 0]
    assert flow is not None
    mesh, velocity = flow.mesh, np.repeat(flow.velocity, steps, axis=0)
    last = Flow(mesh, velocity, flow.tau, "linearised").push(f)
    [shown] = [
        panel for row in findings.sheet.rows for panel in row if panel.label == "linear, t = τ"
    ]
    assert isinstance(shown, Panel)
    assert isinstance(shown.paint, Values)
    np.testing.assert_allclose(shown.paint.values, np.clip(last, f.min(), f.max()), atol=1e-9)
    walked = carried(mesh, feet(mesh, flow.velocity[0], np.array([flow.tau])), f)[0]
    [difference, overshoot, excess] = [
        measure.value
        for measure in findings.measures
        if measure.name.startswith("linear, t = tau: ")
    ]
    assert difference == pytest.approx(
        l2_norm(mesh, last - walked) / l2_norm(mesh, walked), rel=1e-6
    )
    beyond = max(last.max() - f.max(), f.min() - last.min()) / (f.max() - f.min())
    assert overshoot == pytest.approx(beyond, rel=1e-6)
    assert excess == pytest.approx(variation(mesh, last) / variation(mesh, walked) - 1, rel=1e-6)


def variation(mesh: TriangleMesh, f: np.ndarray) -> float:
    """Integral of the slope of a function: from each face's plane over the plane of two of its
    edges.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    edges = np.stack([b - a, c - a], axis=1)
    rises = np.stack([f[mesh.faces[:, k]] - f[mesh.faces[:, 0]] for k in (1, 2)], axis=1)
    slopes = np.stack(
        [np.linalg.pinv(edge) @ rise for edge, rise in zip(edges, rises, strict=True)]
    )
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return float(areas @ np.linalg.norm(slopes, axis=1))


def test_one_step_errs_by_the_square_of_the_time() -> None:
    mesh = ellipsoid(2, 1, 0.7, 0.5)
    field, f = stream_field(mesh, {2: 1.0, 3: 1.0}, 0.3), function(mesh, "eigenfunction:5")
    derivative = directional_derivative(mesh, to_frame(mesh, field))
    errors = [
        np.abs(f - t * (derivative @ f) - advect(mesh, field, f, t)).max() for t in (0.02, 0.01)
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def test_there_are_as_many_linear_steps_as_the_fastest_oscillation_allows() -> None:
    """Steps of length h make one of frequency w larger by ``sqrt(1 + (h w)^2)`` each, and until
    tau by a million.
    """
    mesh = ellipsoid(3, 1, 0.7, 0.5)
    uneven = TriangleMesh(mesh.vertices * (0.02 + mesh.vertices[:, :1] ** 2) ** 0.5, mesh.faces)
    example, findings = run(4, uneven)
    assert example.flow is not None
    derivative = directional_derivative(uneven, to_frame(uneven, example.flow.velocity[0]))
    exact = np.abs(np.linalg.eigvals(derivative.toarray())).max()
    steps = steps_taken(findings)
    assert steps > 40  # and not as few as there can be, one between any two of the times
    assert np.sqrt(2 * np.log(1e6) * steps) == pytest.approx(example.flow.tau * exact, rel=0.1)


def test_on_another_mesh_with_a_boundary() -> None:
    assert run(4, open_cylinder(24, 12))[1].measures
