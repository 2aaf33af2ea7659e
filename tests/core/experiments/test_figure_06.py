"""Figure 6: carried fields against turned ones, and what holds on any mesh."""

import numpy as np
import pytest

from abfm.calculus.vector_fields import lie_bracket_of
from abfm.experiments.figure_06 import known_cases
from tests.core.experiments.small import ran, run
from tests.shapes import ellipsoid, open_cylinder


def values(findings, *words):
    return [m.value for m in findings.measures if all(word in m.name for word in words)]


@pytest.mark.parametrize("name", ["sphere", "torus, about the axis", "torus, around the tube"])
def test_carried_fields_converge_to_the_exact_ones(name):
    _, own = ran(6)
    assert min(values(own, name, "order")) > 0.75
    short, shown = (
        values(own, name, "error at t = 0.125")[0],
        values(own, name, "error at t = 0.25")[0],
    )
    assert short < shown < 0.4
    assert all(m.reproduces for m in own.measures if "transports" in m.claim)


def test_the_printed_sign_carries_the_other_way():
    _, own = ran(6)
    printed = [m for m in own.measures if "printed sign" in m.name]
    assert len(printed) == 6
    assert all(m.reproduces is False and m.value > 0.5 for m in printed)


@pytest.fixture(
    scope="module", params=["sphere", "torus, about the axis", "torus, around the tube"]
)
def levels(request):
    """The cases of one of the experiment's own surfaces, coarse to fine."""
    (levels,) = [levels for levels in known_cases((1, 2)) if levels[0].name == request.param]
    return levels


def test_exact_answers_begin_with_the_field_and_come_back_after_a_full_turn(levels):
    case = levels[0]
    np.testing.assert_array_equal(case.exact(0.0), case.u)
    np.testing.assert_allclose(case.exact(2.0), case.u, atol=1e-12)
    assert abs(case.exact(1.0) - case.u).max() > 0.1 * abs(case.u).max()


def test_exact_answers_solve_the_equation_of_the_pushforward(levels):
    """``d/dt u = -[v, u]``: on the torus in the angles, where ``v`` is constant and the
    components move along.
    """
    errors = []
    for case in levels:
        rate = (case.exact(1e-4) - case.exact(-1e-4)) / 2e-4
        bracket = lie_bracket_of(case.mesh, case.v, case.u)
        errors.append(np.linalg.norm(rate + bracket) / np.linalg.norm(rate))
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.3


@pytest.mark.parametrize(
    "mesh", [ellipsoid(3, 1.0, 0.7, 1.6), open_cylinder(24, 12)], ids=["ellipsoid", "cylinder"]
)
def test_on_any_mesh_carried_fields_derive_carried_functions(mesh):
    example, findings = run(6, mesh)
    for t in ("0.125", "0.25"):
        ours, printed = values(findings, "D_w", f"t = {t},")
        assert ours < 0.5 * printed
        (same,) = values(findings, "along itself", f"t = {t}")
        assert same < 1e-9
    (row,) = findings.sheet.rows
    assert [panel.frame for panel in row] == ["field", "source", "result", "result"]
    assert example.flow.velocity.shape == (1, len(mesh.faces), 3)
