"""The solver's thread."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import abfm
from abfm.numerics.own_process import is_factored_apart
from abfm_viewer.computing import picture_pace
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.problem import Problem, State
from abfm_viewer.computing.solver import Solver
from abfm_viewer.document.document import Channel
from tests.viewer.sessions import ENDLESS, PAIR, QUICK, SPHERE, problem, until


@pytest.fixture(scope="module")
def functions():
    functions = Functions(SPHERE)
    yield functions
    functions.close()


def started(functions: Functions, what: Problem, field=None) -> Solver:
    solver = Solver()
    solver.start(what, functions, field)
    return solver


def rows(solver: Solver) -> int:
    return len(solver.run.stages) if solver.run else 0


def ended(solver: Solver):
    """The result and the run that a solver leaves, which ends of itself."""
    solver.wait(30)
    result, run, _ = solver.collect()
    return result, run


def test_a_run_posts_every_iterate_and_ends_with_the_result_of_match(functions):
    solver = started(functions, problem())
    solver.wait(30)
    newest = solver.snapshot.iteration.iteration
    result, run = ended(solver)
    source, target = functions.evaluate(PAIR.source), functions.evaluate(PAIR.target)
    expected = abfm.match(SPHERE, source[:, None], target[:, None], QUICK)
    assert (solver.running, solver.state) == (False, State.ENDED)
    np.testing.assert_array_equal(result.velocity, expected.velocity)
    np.testing.assert_array_equal(run.energies, expected.energy_history)
    np.testing.assert_array_equal(run.stages, expected.stages)
    assert run.restarts == ()
    assert (run.has_course, set(run.vertices.tolist())) == (True, {len(SPHERE.vertices)})
    assert run.reaches[0] == QUICK.reach
    assert newest == len(run.energies) - 1


def test_large_systems_are_factored_apart_in_the_thread_of_a_run(functions, monkeypatch):
    """Else the window would stand still meanwhile: cholespy stops all threads."""
    asked = []

    def look(*_, **__):
        asked.extend(is_factored_apart(size) for size in (14_000, 15_000))
        raise abfm.FunctionError("seen enough")

    monkeypatch.setattr(abfm, "match", look)
    solver = started(functions, problem())
    ended(solver)
    assert (asked, solver.state) == ([False, True], State.FAILED)
    assert not is_factored_apart(10**9)


def test_the_run_is_the_same_object_until_there_is_more_of_it(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 2)
    solver.pause()
    until(lambda: solver.run is solver.run)
    solver.resume()
    before = solver.run
    until(lambda: rows(solver) > len(before.stages))
    assert solver.run is not before
    solver.close()


def test_a_paused_run_stands_still_and_goes_on(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 3)
    solver.pause()
    assert solver.paused
    time.sleep(0.2)  # the evaluation under way ends
    count = rows(solver)
    time.sleep(0.2)
    assert rows(solver) == count
    solver.resume()
    assert not solver.paused
    until(lambda: rows(solver) > count + 3)
    solver.cancel()
    ended(solver)


def test_cancel_keeps_the_best_field(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 10)
    solver.cancel()
    result, run = ended(solver)
    assert result.stop_reason == "cancelled"
    assert len(result.energy_history) == len(run.stages)
    totals = run.energies[:, 0]
    assert totals[-1] == totals.min() < totals[0]


@pytest.mark.parametrize("paused", [False, True])
def test_cancel_before_the_first_evaluation_ends_the_run_after_it(functions, paused):
    solver = started(functions, problem(ENDLESS))
    if paused:
        solver.pause()
    solver.cancel()
    result, run = ended(solver)
    assert not solver.running
    assert result.stop_reason == "cancelled"
    assert len(run.stages) >= 1


def test_a_paused_run_can_be_cancelled(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 3)
    solver.pause()
    solver.cancel()
    result, _ = ended(solver)
    assert not solver.running
    assert result.stop_reason == "cancelled"


def test_a_restart_goes_on_from_the_field_that_was_there(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 40)
    changed = problem(replace(ENDLESS, beta=1e-4))
    solver.follow_problem(changed)
    until(lambda: solver.snapshot.problem is changed and rows(solver) > 60)
    solver.cancel()
    result, run = ended(solver)
    [restart] = run.restarts
    assert 40 < restart < len(run.energies) == len(run.stages)
    regularity = run.energies[:, 1]
    assert regularity[0] == 0
    assert regularity[restart] == pytest.approx(regularity[restart - 1], rel=0.1)  # the field goes on
    assert result.parameters == changed.parameters


def test_restarts_in_a_row_leave_each_problem_some_iterations(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 0)
    for number in range(40):
        solver.follow_problem(problem(replace(ENDLESS, sigma=1e-3 * (1 + number / 100))))
        time.sleep(0.01)
    until(lambda: solver.snapshot.problem is solver.problem)
    solver.cancel()
    _, run = ended(solver)
    restarts = np.array([0, *run.restarts])
    assert len(restarts) > 2
    assert np.diff(restarts).min() >= 3


def test_after_cancel_nothing_restarts(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 3)
    solver.cancel()
    solver.follow_problem(problem(QUICK))
    result, _ = ended(solver)
    assert solver.problem.parameters == result.parameters == ENDLESS


def test_after_close_nothing_restarts_though_it_waits_less_than_an_evaluation_takes(functions, monkeypatch):
    begun, go_on, solved = threading.Event(), threading.Event(), []

    def slowly(*arguments, **named):
        solved.append(arguments[3])
        begun.set()
        go_on.wait(30)
        return match(*arguments, **named)

    match = abfm.match
    monkeypatch.setattr(abfm, "match", slowly)
    solver = started(functions, problem(ENDLESS))
    begun.wait(30)
    solver.follow_problem(problem(QUICK))
    solver.close(0.01)
    assert not solver.running
    go_on.set()
    solver._thread.join(30)
    assert solved == [ENDLESS]


def test_a_restart_that_cannot_be_solved_keeps_the_result_so_far(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 10)
    solver.follow_problem(problem(ENDLESS, Channel("gaussian:vertex=100000,width=0.1", PAIR.target)))
    result, _ = ended(solver)
    assert solver.failed
    assert "100000" in solver.reason
    assert "\n" not in solver.reason
    assert result.stop_reason == "cancelled"


def test_an_error_inside_match_is_one_line(functions, monkeypatch, capsys):
    def broken(*args, **kwargs):
        raise RuntimeError("boom\nand more")

    monkeypatch.setattr(abfm, "match", broken)
    solver = started(functions, problem())
    result, run = ended(solver)
    assert (solver.failed, solver.reason) == (True, "RuntimeError: boom and more")
    assert (result, run) == (None, None)
    assert "Traceback" in capsys.readouterr().err  # for the developer


def test_a_start_that_is_too_fast_is_replaced_by_none(functions):
    wild = np.zeros((1, len(SPHERE.faces), 3))
    wild[:, :, 0] = 1e6
    solver = started(functions, problem(), wild)
    _, run = ended(solver)
    assert not solver.failed
    assert run.energies[0, 1] == 0


def test_a_mask_and_weights_reach_match(functions):
    masked = replace(problem(), mask="expression:where(x > 0, 1, 0)", channels=(replace(PAIR, weight=2.0),))
    solver = started(functions, masked)
    result, _ = ended(solver)
    assert not solver.failed
    np.testing.assert_array_equal(result.mask, functions.evaluate(masked.mask))
    assert result.weights.tolist() == [2.0]


def test_a_field_that_is_too_fast_for_other_parameters_is_no_start(functions):
    first, _ = ended(started(functions, problem()))
    second = started(functions, problem(), first.start_for(replace(QUICK, tau=1e-20)))
    result, _ = ended(second)
    assert not second.failed
    np.testing.assert_array_equal(result.velocity, first.velocity)


def test_pictures_are_made_in_the_solver_s_thread_and_at_their_pace(functions, monkeypatch):
    made, now = [], [0.0]

    def noted(iteration):
        made.append(threading.current_thread().name)
        return np.zeros((1, 1))

    monkeypatch.setattr(picture_pace, "clock", SimpleNamespace(perf_counter=lambda: now[0]))
    monkeypatch.setattr(abfm.Iteration, "advected", property(noted))
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 20)
    assert made == ["solver"]  # while no time goes by
    assert solver.snapshot.shown.iteration == 0
    now[0] = 1.0
    until(lambda: solver.snapshot.shown.iteration > 20)
    assert made == ["solver", "solver"]
    shown = solver.snapshot.shown
    solver.cancel()
    _, run = ended(solver)
    assert shown.iteration <= len(run.stages) - 1


def test_a_new_problem_is_shown_at_once(functions):
    solver = started(functions, problem(ENDLESS))
    until(lambda: rows(solver) > 10)
    changed = problem(replace(ENDLESS, beta=1e-4))
    solver.follow_problem(changed)
    until(lambda: solver.snapshot.problem is changed)
    first = solver.snapshot
    assert first.shown.iteration <= first.iteration.iteration < 10
    assert "advected" in vars(first.shown.look)
    assert "velocity" not in vars(first.shown.look)
    solver.cancel()
    ended(solver)
