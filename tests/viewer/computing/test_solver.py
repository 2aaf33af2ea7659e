"""The solver as the session knows it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.problem import Problem
from abfm_viewer.computing.solver import Solver
from tests.shapes import tetrahedron
from tests.viewer.sessions import ENDLESS, SPHERE, problem, until


@pytest.fixture
def solver():
    functions = Functions(SPHERE)
    solver = Solver()
    solver.start(problem(ENDLESS), functions, None)
    until(lambda: solver.snapshot)
    yield solver
    solver.close()
    functions.close()


def ended(solver: Solver):
    left = []
    until(lambda: (found := solver.collect()) and left.append(found) is None)
    return left[0]


def test_before_any_run_nothing_is_finished():
    solver = Solver()
    assert not (solver.running)
    assert not (solver.paused)
    assert not (solver.finished)
    assert (solver.snapshot, solver.run, solver.collect()) == (None, None, None)
    solver.cancel()  # nothing to cancel, pause or resume
    solver.pause()
    solver.resume()


def test_what_a_run_leaves_is_collected_once(solver):
    until(lambda: len(solver.run.stages) > 5)
    solver.cancel()
    result, run, solved = ended(solver)
    assert (solver.finished, solver.failed, solver.reason) == (True, False, "cancelled")
    assert len(run.stages) == len(result.energy_history)
    assert solved.parameters == ENDLESS
    assert solver.collect() is None


def test_pause_and_resume(solver):
    solver.pause()
    assert solver.paused
    assert solver.running
    solver.resume()
    assert not solver.paused


def test_a_changed_problem_restarts_the_run(solver):
    solver.follow_problem(problem(replace(ENDLESS, beta=1e-3)), dragging=True)
    assert solver.problem.parameters.beta == 1e-3
    until(lambda: solver.run.restarts)


def test_another_alpha_waits_until_the_mouse_lets_go(solver):
    changed = problem(replace(ENDLESS, alpha=0.5))
    solver.follow_problem(changed, dragging=True)
    assert solver.problem.parameters.alpha == ENDLESS.alpha
    solver.follow_problem(changed, dragging=False)
    assert solver.problem is changed


def test_a_run_that_does_not_follow_stays_as_it_is(solver):
    solver.follow = False
    solver.follow_problem(problem(replace(ENDLESS, beta=1e-3)), dragging=False)
    assert solver.problem.parameters == ENDLESS


@pytest.mark.parametrize("follow", [True, False])
def test_another_mesh_ends_the_run(solver, follow):
    solver.follow = follow
    before = problem(ENDLESS)
    solver.follow_problem(Problem(tetrahedron(), before.channels, ENDLESS, ""), dragging=False)
    _, _, solved = ended(solver)
    assert solved.mesh is SPHERE
    assert solver.reason == "cancelled"
