"""Signals that no smooth flow matches: sigma is raised to what flow lines leave."""

from functools import cache

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

import abfm
import abfm.matching.solving.solve
from abfm.calculus.operators import vertex_areas
from abfm.calculus.vector_fields import to_frame
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solvability import narrowest
from abfm.matching.solving.descent import confirmation
from abfm.matching.solving.schedule import gradual, search
from abfm.matching.solving.solve import Solver
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import PAPER, Parameters
from tests.core.fields import bump, wavy_field
from tests.core.surfaces import renumbered
from tests.shapes import icosphere

SPHERE = icosphere(3)
TURN = np.array([[np.cos(0.2), -np.sin(0.2), 0], [np.sin(0.2), np.cos(0.2), 0], [0, 0, 1]])


def waves(points, seed):
    """Twelve waves in random directions, two to five radians per unit of length."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(12, 3))
    directions *= rng.uniform(2, 5, 12)[:, None] / np.linalg.norm(directions, axis=1)[:, None]
    return np.sin(points @ directions.T + rng.uniform(0, 6, 12)).sum(axis=1)


def signals(scale=1.0):
    """Waves, and the same ones turned, plus as many others of their own."""
    own = waves(SPHERE.vertices, 2)
    return scale * waves(SPHERE.vertices, 1), scale * (waves(SPHERE.vertices @ TURN, 1) + own)


def gaussians():
    return bump(SPHERE, [0, 0, 1], 0.15), bump(SPHERE, [0, 0.7, 0.7], 0.15)


@cache
def solved(scale=1.0, unit="relative"):
    p = Parameters() if unit == "relative" else Parameters(sigma=0.02, sigma_unit="absolute")
    solver = Solver(MatchingEnergy(SPHERE, *signals(scale), p), None)
    solver.run()
    return solver


def asked(mesh, f, g, field=0.0):
    """What flow lines of a field (F, 3) say, or of no motion at all."""
    energy, field = MatchingEnergy(mesh, f, g), np.zeros((1, len(mesh.faces), 3)) + field
    x = to_frame(energy.mesh, field / mesh.length_scale)
    return confirmation(energy, energy.objective(0.2).evaluate(x), 0.2)


def test_of_no_motion_the_difference_is_left_and_neither_scales_nor_order_matter():
    f, g = signals()
    energy, found = MatchingEnergy(SPHERE, f, g), asked(SPHERE, f, g)
    areas = vertex_areas(energy.mesh)
    size = max(np.sqrt(areas @ (h - areas @ h) ** 2) for h in (f, g))
    assert_allclose(found.mismatch, energy.relative_mismatch(energy.functions.source), rtol=1e-9)
    assert_allclose(found.left, np.sqrt(areas @ (f - g) ** 2) / size, rtol=1e-9)
    assert_allclose(found.energy, 0.5 * (found.left / 0.2) ** 2, rtol=1e-9)
    expected = energy.objective(0.2).evaluate(np.zeros(energy.shape)).energy
    assert_allclose(found.energy, expected, rtol=1e-9)
    field = 0.3 * wavy_field(SPHERE, 0)
    expected = asked(SPHERE, f, g, field)
    for scale in (1e-3, 7.0):
        assert_allclose(asked(SPHERE, scale * f, scale * g, field), expected, rtol=1e-9)
    mesh, vertices, faces = renumbered(SPHERE, 1)
    there = asked(mesh, f[vertices], g[vertices], field[faces])
    assert_allclose(there, expected, rtol=1e-4)  # steps of flow lines begin at other corners


def test_signals_that_smooth_flows_do_not_match_raise_a_relative_sigma_to_what_is_left():
    solver = solved()
    assert 0.1 < solver.unmatched < 0.5
    sigmas = [stage.sigma for stage in solver.record.schedule]
    assert max(sigmas) == 27 * sigmas[0]
    at = sigmas.index(solver.unmatched)
    assert solver.record.schedule[at].last
    for sigma in sigmas[at:]:  # thirds of it, as the closing stages have
        steps = np.log(solver.unmatched / sigma) / np.log(3)
        assert_allclose(steps, round(steps), atol=1e-9)
        assert sigma > 0.999 * Parameters().last_sigma / 3**4
    assert solver.record.schedule[-1].sigma == solver.unmatched
    assert_allclose(solved(4.0).unmatched, solved().unmatched, rtol=1e-12)
    solver = solved(unit="absolute")
    assert np.isnan(solver.unmatched)
    assert solver.energy.parameters.last_sigma in [stage.sigma for stage in solver.record.schedule]


def test_the_verdict_tells_a_raised_sigma_and_what_flow_lines_confirm_keeps_its_course(monkeypatch):
    match, found = (abfm.match(SPHERE, *given) for given in (signals(), gaussians()))
    assert f"sigma raised to {solved().unmatched:.2g}" in match.verdict.reason
    assert "raised" not in found.verdict.reason
    monkeypatch.setattr(abfm.matching.solving.schedule, "gradual", lambda p, levels, clustered: [])
    before = abfm.match(SPHERE, *gaussians())
    assert_array_equal(found.velocity, before.velocity)
    assert_array_equal(found.energy_history, before.energy_history)


def test_functions_that_the_mesh_does_not_resolve_are_not_judged():
    narrow, wide = (bump(SPHERE, [0, 0, 1], width) for width in (0.03, 0.3))
    spans = [narrowest(FunctionTerm(SPHERE, f, wide)) for f in (narrow, wide)]
    assert spans[0] < abfm.matching.solving.solve._RESOLVED < spans[1]


def test_the_gradual_way_is_the_second_one_from_a_larger_sigma_on():
    p = Parameters()
    far, near = search(p, 1)[1].stages
    way = gradual(p, 1)
    assert (way[0].reach, way[-1]) == (far.reach, near)
    sigmas = [stage.sigma for stage in way[1:]]
    assert sigmas == sorted(sigmas, reverse=True)
    assert way[0].sigma == sigmas[0] > far.sigma
    for changes in (PAPER, {"stage_iterations": 5}, {"cooling_stages": 1}):
        assert gradual(Parameters(**changes), 1) == []
