"""The solver's thread."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.worker import Worker
from abfm_viewer.document.document import Channel
from tests.viewer.sessions import ENDLESS, PAIR, QUICK, SPHERE, problem, until


@pytest.fixture(scope="module")
def functions():
    functions = Functions(SPHERE)
    yield functions
    functions.close()


def test_a_run_posts_every_iterate_and_ends_with_the_result_of_match(functions):
    worker = Worker(problem(), functions)
    worker.wait(30)
    source, target = functions.evaluate(PAIR.source), functions.evaluate(PAIR.target)
    expected = abfm.match(SPHERE, source[:, None], target[:, None], QUICK)
    assert (worker.running, worker.error) == (False, "")
    np.testing.assert_array_equal(worker.result.velocity, expected.velocity)
    run = worker.run()
    np.testing.assert_array_equal(run.energies, expected.energy_history)
    np.testing.assert_array_equal(run.stages, expected.stages)
    assert run.restarts == ()
    assert (run.has_course, set(run.vertices.tolist())) == (True, {len(SPHERE.vertices)})
    assert run.reaches[0] == QUICK.reach
    assert worker.snapshot.iteration.iteration == len(run.energies) - 1


def test_a_paused_run_stands_still_and_goes_on(functions):
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: worker.rows > 3)
    worker.pause()
    assert worker.paused
    time.sleep(0.2)  # the evaluation under way ends
    rows = worker.rows
    time.sleep(0.2)
    assert worker.rows == rows
    worker.resume()
    assert not worker.paused
    until(lambda: worker.rows > rows + 3)
    worker.cancel()
    worker.wait(30)


def test_cancel_keeps_the_best_field(functions):
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: worker.rows > 10)
    worker.cancel()
    worker.wait(30)
    assert worker.result.stop_reason == "cancelled"
    assert len(worker.result.energy_history) == worker.rows
    totals = worker.run().energies[:, 0]
    assert totals[-1] == totals.min() < totals[0]


@pytest.mark.parametrize("paused", [False, True])
def test_cancel_before_the_first_evaluation_ends_the_run_after_it(functions, paused):
    worker = Worker(problem(ENDLESS), functions)
    if paused:
        worker.pause()
    worker.cancel()
    worker.wait(30)
    assert not worker.running
    assert worker.result.stop_reason == "cancelled"
    assert worker.rows >= 1


def test_a_paused_run_can_be_cancelled(functions):
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: worker.rows > 3)
    worker.pause()
    worker.cancel()
    worker.wait(30)
    assert not worker.running
    assert worker.result.stop_reason == "cancelled"


def test_a_restart_goes_on_from_the_field_that_was_there(functions):
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: worker.rows > 40)
    changed = problem(replace(ENDLESS, beta=1e-4))
    worker.restart(changed)
    until(lambda: worker.snapshot.problem is changed and worker.rows > 60)
    worker.cancel()
    worker.wait(30)
    run = worker.run()
    [restart] = run.restarts
    assert 40 < restart < len(run.energies) == len(run.stages)
    regularity = run.energies[:, 1]
    assert regularity[0] == 0
    assert regularity[restart] == pytest.approx(regularity[restart - 1], rel=0.1)  # the field goes on
    assert worker.result.parameters == changed.parameters


def test_restarts_in_a_row_leave_each_problem_some_iterations(functions):
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: worker.rows > 0)
    for number in range(40):
        worker.restart(problem(replace(ENDLESS, sigma=1e-3 * (1 + number / 100))))
        time.sleep(0.01)
    until(lambda: worker.snapshot.problem is worker.problem)
    worker.cancel()
    worker.wait(30)
    restarts = np.array([0, *worker.run().restarts])
    assert len(restarts) > 2
    assert np.diff(restarts).min() >= 3


def test_after_cancel_nothing_restarts(functions):
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: worker.rows > 3)
    worker.cancel()
    worker.restart(problem(QUICK))
    worker.wait(30)
    assert worker.problem.parameters == worker.result.parameters == ENDLESS


def test_a_restart_that_cannot_be_solved_keeps_the_result_so_far(functions):
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: worker.rows > 10)
    worker.restart(problem(ENDLESS, Channel("gaussian:vertex=100000,width=0.1", PAIR.target)))
    worker.wait(30)
    assert "100000" in worker.error
    assert "\n" not in worker.error
    assert worker.result.stop_reason == "cancelled"


def test_an_error_inside_match_is_one_line(functions, monkeypatch, capsys):
    def broken(*args, **kwargs):
        raise RuntimeError("boom\nand more")

    monkeypatch.setattr(abfm, "match", broken)
    worker = Worker(problem(), functions)
    worker.wait(30)
    assert worker.error == "RuntimeError: boom and more"
    assert (worker.result, worker.rows) == (None, 0)
    assert "Traceback" in capsys.readouterr().err  # for the developer


def test_a_start_that_is_too_fast_is_replaced_by_none(functions):
    wild = np.zeros((1, len(SPHERE.faces), 3))
    wild[:, :, 0] = 1e6
    worker = Worker(problem(), functions, wild)
    worker.wait(30)
    assert worker.error == ""
    assert worker.run().energies[0, 1] == 0


def test_a_mask_and_weights_reach_match(functions):
    masked = replace(problem(), mask="expression:where(x > 0, 1, 0)", channels=(replace(PAIR, weight=2.0),))
    worker = Worker(masked, functions)
    worker.wait(30)
    assert worker.error == ""
    np.testing.assert_array_equal(worker.result.mask, functions.evaluate(masked.mask))
    assert worker.result.weights.tolist() == [2.0]


def test_a_field_that_is_too_fast_for_other_parameters_is_no_start(functions):
    first = Worker(problem(), functions)
    first.wait(30)
    start = first.result.start_for(replace(QUICK, tau=1e-20))
    second = Worker(problem(), functions, start)
    second.wait(30)
    assert second.error == ""
    np.testing.assert_array_equal(second.result.velocity, first.result.velocity)


def test_pictures_are_made_in_the_solver_s_thread_and_take_little_of_its_time(functions, monkeypatch):
    made: list[tuple[str, float]] = []

    def slowly(iteration):
        made.append((threading.current_thread().name, time.perf_counter()))
        time.sleep(0.01)
        return np.zeros((1, 1))

    monkeypatch.setattr(abfm.Iteration, "advected", property(slowly))
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: len(made) > 2)
    shown = worker.snapshot.shown
    worker.cancel()
    worker.wait(30)
    assert shown.iteration <= worker.snapshot.iteration.iteration
    assert {name for name, _ in made} == {"solver"}
    assert worker.rows > 3 * len(made)
    assert np.diff([moment for _, moment in made]).min() > 0.099  # ten times what a picture takes


def test_a_new_problem_is_shown_at_once(functions):
    worker = Worker(problem(ENDLESS), functions)
    until(lambda: worker.rows > 10)
    changed = problem(replace(ENDLESS, beta=1e-4))
    worker.restart(changed)
    until(lambda: worker.snapshot.problem is changed)
    first = worker.snapshot
    assert first.shown.iteration >= first.iteration.iteration - 1
    assert "advected" in vars(first.shown)
    assert "velocity" not in vars(first.shown)
    worker.cancel()
    worker.wait(30)
