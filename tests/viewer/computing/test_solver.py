"""The solver: a run is what `abfm.match` does, can be held, ended and changed, and leaves what it
found, though it matches in a process that may be killed.
"""

import itertools
import os
import signal
import threading
import time
from concurrent.futures import wait
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import abfm
from abfm import AbfmError
from abfm.workers import worker as worker_module
from abfm_viewer.computing import solver as solver_module
from abfm_viewer.computing.evaluation import Evaluators, Functions
from abfm_viewer.computing.match_apart import IteratePicture, MatchApart
from abfm_viewer.computing.solver import (
    FIRST_KEEP_SECONDS,
    ProblemSpec,
    RunHistory,
    RunState,
    Snapshot,
    Solver,
)
from abfm_viewer.document.document import Channel
from tests.messages import check_message, raises
from tests.shapes import icosphere, tetrahedron
from tests.viewer.sessions import ENDLESS, PAIR, QUICK, SPHERE, problem, until


@pytest.fixture(scope="module")
def functions():
    functions = Functions(SPHERE)
    yield Evaluators(functions, functions)
    functions.retire()


@pytest.fixture
def solver():
    solver = Solver()
    yield solver
    solver.close()


@pytest.fixture
def running(solver, functions, monkeypatch):
    """One with a run that goes on until it is told otherwise, and has made some steps; no field
    comes over that nobody asked for.
    """
    monkeypatch.setattr(solver_module, "FIRST_KEEP_SECONDS", 1e9)
    solver.start(problem(ENDLESS), functions)
    until(lambda: rows(solver) > 3)
    return solver


def rows(solver):
    return len(solver.run.stages) if solver.run else 0


def ended(solver):
    """The result and the run that a solver leaves, which ends of itself."""
    solver.wait(60)
    result, run, _ = solver.collect()
    return result, run


def cancelled(solver):
    solver.cancel()
    return ended(solver)


def killed(solver):
    until(lambda: not process_of(solver).has_ended)  # that of an earlier run may have
    os.kill(process_of(solver).pid, signal.SIGKILL)
    left = ended(solver)
    assert solver.failed
    return left


def process_of(solver):
    return solver._apart._worker._connection.process


def same_run(solver, mesh, parameters):
    """Check that a match of a mesh is that of `abfm.match`, bit for bit."""
    functions = Functions(mesh)
    evaluators = Evaluators(functions, functions)
    solver.start(ProblemSpec(mesh, (PAIR,), parameters, ""), evaluators)
    solver.wait(60)
    newest = solver.snapshot.iteration.iteration
    result, run = ended(solver)
    # text, which finer meshes evaluate anew
    expected = abfm.match(abfm.Problem(mesh, [PAIR.source], [PAIR.target], parameters))
    functions.retire()
    assert (solver.running, solver.state, run.restarts) == (False, RunState.ENDED, ())
    assert result.mesh is mesh
    for name in ("velocity", "advected", "energy_history", "stages"):
        np.testing.assert_array_equal(getattr(result, name), getattr(expected, name))
    np.testing.assert_array_equal(run.energies, expected.energy_history)
    np.testing.assert_array_equal(run.stages, expected.stages)
    assert (result.verdict, result.stop_reason) == (expected.verdict, expected.stop_reason)
    assert newest == len(run.energies) - 1


def carries(match, functions):
    """Check that a field carries the source to what it says."""
    flow = abfm.Flow(SPHERE, match.velocity, ENDLESS.tau)
    carried = flow.push(functions.evaluate(PAIR.source), ENDLESS.tau)
    np.testing.assert_allclose(carried, match.advected[:, 0], atol=1e-5)


def test_it_finds_what_match_finds_also_on_another_mesh_prepared_or_not(solver):
    same_run(solver, SPHERE, QUICK)
    mesh = icosphere(2)
    solver.prepare(mesh, None)  # what fails while meshes are made ahead stops no match
    solver.prepare(mesh, QUICK.with_values(levels=2))
    same_run(solver, mesh, QUICK.with_values(levels=2))


def test_a_run_that_waits_for_coarser_meshes_tells_of_them(solver, functions):
    told = []
    tell = solver._at
    solver._at = lambda step: (told.append(step), tell(step))
    sphere = abfm.TriangleMesh(1.1 * SPHERE.vertices, SPHERE.faces)  # of which none are made yet
    solver.prepare(sphere, QUICK.with_values(levels=2))
    solver.start(replace(problem(QUICK.with_values(levels=2)), mesh=sphere), functions)
    ended(solver)
    tasks = [step.task for step in told if step]
    assert tasks.count("making coarser meshes") == 2  # ahead, and when the match takes them
    assert told[-1] is None


def test_a_mask_and_weights_reach_match_and_what_is_wrong_is_told_in_the_same_words(
    solver, functions
):
    masked = replace(problem(), mask="expression:where(x > 0, 1, 0)")
    solver.start(replace(masked, channels=(replace(PAIR, weight=2.0),)), functions)
    result, _ = ended(solver)
    assert not solver.failed
    np.testing.assert_array_equal(result.mask, functions.evaluate(masked.mask))
    assert result.weights.tolist() == [2.0]
    negative = replace(problem(), mask="expression:0 * x - 1")
    solver.start(negative, functions)
    ended(solver)
    source, target, mask = map(functions.evaluate, (PAIR.source, PAIR.target, negative.mask))
    with pytest.raises(AbfmError) as error:
        abfm.match(SPHERE, source, target, QUICK, mask=mask)
    assert (solver.failed, solver.reason) == (True, str(error.value))


def test_an_error_inside_match_is_one_line(solver, functions, monkeypatch, capsys):
    def broken(*_):
        raise RuntimeError("boom\nand more")

    monkeypatch.setattr(MatchApart, "match", broken)
    solver.start(problem(), functions)
    assert ended(solver) == (None, None)
    assert (solver.failed, solver.reason) == (True, "RuntimeError: boom and more")
    assert "Traceback" in capsys.readouterr().err  # for the developer


def test_a_start_that_is_too_fast_is_replaced_by_none(solver, functions):
    wild = np.zeros((1, len(SPHERE.faces), 3))
    wild[:, :, 0] = 1e6
    solver.start(problem(), functions, wild)
    first, run = ended(solver)
    assert (solver.failed, run.energies[0, 1]) == (False, 0)
    solver.start(problem(), functions, first.start_for(replace(QUICK, tau=1e-20)))
    second, _ = ended(solver)
    assert not solver.failed
    np.testing.assert_array_equal(second.velocity, first.velocity)


def test_before_any_run_nothing_is_finished(solver):
    assert (solver.running, solver.paused, solver.finished) == (False, False, False)
    assert (solver.snapshot, solver.run, solver.collect()) == (None, None, None)
    solver.cancel()  # nothing to cancel, pause or resume
    solver.pause()
    solver.resume()


def test_the_run_is_the_same_object_until_there_is_more_of_it(running):
    running.pause()
    until(lambda: running.run is running.run)
    running.resume()
    before = running.run
    until(lambda: rows(running) > len(before.stages))
    assert running.run is not before
    until(lambda: running.snapshot.shown.iteration > 0)  # some come with a picture: these are shown
    assert running.snapshot.shown.look.picture is not None
    until(lambda: running.snapshot.iteration.look.picture is None)
    assert running.snapshot.shown.iteration <= running.snapshot.iteration.iteration


def test_the_fields_of_an_iterate_come_when_they_are_asked_for_and_are_known_for_a_while(
    running, functions
):
    running.pause()
    shown = running.snapshot.shown
    again = replace(shown, look=replace(shown.look, picture=None))
    carries(shown, functions)
    cancelled(running)
    for _ in range(2):
        running.start(problem(), functions)
        ended(running)
    assert shown.velocity is shown.velocity  # kept once it was there
    with raises(AbfmError):
        _ = again.velocity


def test_a_paused_run_stands_still_goes_on_and_ends_with_the_best_field_when_cancelled(running):
    def stands_still():
        count = rows(running)
        time.sleep(0.2)
        return rows(running) == count

    running.pause()
    assert (running.paused, running.running) == (True, True)
    until(stands_still)  # when the evaluation under way has ended
    assert stands_still()
    count = rows(running)
    running.resume()
    assert not running.paused
    until(lambda: rows(running) > count + 3)
    running.pause()
    running.cancel()
    running.wait(60)
    result, run, solved = running.collect()
    assert (running.finished, running.failed, running.reason) == (True, False, "cancelled")
    assert result.stop_reason == "cancelled"
    assert len(result.energy_history) == len(run.stages)
    totals = run.energies[:, 0]
    assert totals[-1] == totals.min() < totals[0]
    assert solved.parameters == ENDLESS
    assert running.collect() is None


@pytest.mark.parametrize("paused", [False, True])
def test_a_run_that_is_cancelled_while_it_starts_ends_after_its_first_evaluation(
    solver, functions, paused
):
    solver.start(problem(ENDLESS), functions)
    if paused:
        solver.pause()
    result, run = cancelled(solver)
    assert result.stop_reason == "cancelled"
    assert len(run.stages) >= 1


def test_a_run_follows_another_problem_from_the_field_that_was_there(running):
    until(lambda: rows(running) > 40)
    changed = problem(replace(ENDLESS, beta=1e-4))
    running.follow_problem(changed, dragging=True)
    assert running.problem is changed
    until(lambda: running.snapshot.problem is changed)
    first = running.snapshot
    assert first.shown.iteration <= first.iteration.iteration
    until(lambda: rows(running) > 60)
    result, run = cancelled(running)
    [restart] = run.restarts
    assert 40 < restart < len(run.energies) == len(run.stages)
    regularity = run.energies[:, 1]
    assert regularity[0] == 0
    # the field goes on
    assert regularity[restart] == pytest.approx(regularity[restart - 1], rel=0.1)
    assert result.parameters == changed.parameters


def test_restarts_in_a_row_leave_each_problem_some_iterations(running):
    numbers = itertools.count()

    def change():
        sigma = 1e-3 * (1 + next(numbers) / 1000)
        running.follow_problem(problem(replace(ENDLESS, sigma=sigma)))

    until(lambda: change() or len(running.run.restarts) > 4)
    until(lambda: running.snapshot.problem is running.problem)
    _, run = cancelled(running)
    restarts = np.array([0, *run.restarts])
    assert np.diff(restarts).min() >= 3


@pytest.mark.parametrize("follow", [True, False])
def test_another_mesh_ends_the_run_and_after_that_nothing_restarts(running, follow):
    running.follow = follow
    if not follow:
        running.follow_problem(problem(replace(ENDLESS, beta=1e-3)))
        assert running.problem.parameters == ENDLESS
    running.follow_problem(replace(problem(ENDLESS), mesh=tetrahedron()), dragging=False)
    running.follow_problem(problem(QUICK))
    running.wait(60)
    result, _, solved = running.collect()
    assert (solved.mesh, running.reason) == (SPHERE, "cancelled")
    assert running.problem.parameters == result.parameters == ENDLESS


def test_after_close_nothing_restarts_though_it_waits_less_than_an_evaluation_takes(
    solver, functions, monkeypatch
):
    begun, go_on, solved = threading.Event(), threading.Event(), []

    def slowly(self, problem, *given):
        solved.append(problem.parameters)
        begun.set()
        go_on.wait(30)
        return match(self, problem, *given)

    match = MatchApart.match
    monkeypatch.setattr(MatchApart, "match", slowly)
    solver.start(problem(ENDLESS), functions)
    begun.wait(30)
    solver.follow_problem(problem(QUICK))
    solver.close(0.01)
    assert not solver.running
    go_on.set()
    wait([solver._working], 30)
    assert solved == [ENDLESS]


def test_a_restart_that_cannot_be_solved_keeps_the_result_so_far(running):
    unknown = Channel("gaussian:vertex=100000,width=0.1", PAIR.target)
    running.follow_problem(problem(ENDLESS, unknown))
    result, _ = ended(running)
    assert (running.failed, "\n" in running.reason) == (True, False)
    assert "100000" in running.reason
    assert result.stop_reason == "cancelled"


def test_a_process_that_is_killed_fails_its_run_and_the_next_run_has_another(running, functions):
    shown = running.snapshot.shown
    found, _ = running.unfinished(running.snapshot, functions)
    result, run = killed(running)
    check_message(running.reason)
    np.testing.assert_array_equal(result.velocity, found.velocity)  # what was asked for is kept
    assert len(run.stages) >= len(found.energy_history)
    running.start(problem(ENDLESS), functions)
    result, _ = killed(running)
    assert result is None  # that of an earlier run is not this one's
    same_run(running, SPHERE, QUICK)
    with raises(AbfmError):
        _ = replace(shown.look, field=None).velocity


@pytest.fixture
def keeping(solver, functions, monkeypatch):
    """One with a run of which a field came over early though nobody asked."""
    monkeypatch.setattr(solver_module, "FIRST_KEEP_SECONDS", 0.2)
    solver.start(problem(ENDLESS), functions)
    until(lambda: solver._course.best)
    return solver


def test_a_killed_process_leaves_the_field_that_came_over(keeping, functions):
    solver = keeping
    course, kept = solver._course, solver._course.best
    result, run = killed(solver)
    assert "\n" not in solver.reason
    assert result.velocity.any()
    if course.best is kept:  # else another one came just before
        np.testing.assert_array_equal(result.velocity, kept.shown.velocity)
    carries(result, functions)
    assert len(run.stages) > kept.iteration.iteration


def test_a_run_that_is_killed_after_a_change_leaves_what_was_found_since_or_before(keeping):
    changed = problem(replace(ENDLESS, beta=1e-4))
    keeping.follow_problem(changed)
    until(lambda: keeping.snapshot.problem is changed)
    result, _ = killed(keeping)
    assert result.velocity.any()


def test_a_process_that_does_not_start_fails_the_run(functions, monkeypatch):
    monkeypatch.setattr(worker_module, "MODULE", "abfm.workers.nothing")
    monkeypatch.setattr(MatchApart, "_spare", [])
    solver = Solver()
    solver.start(problem(), functions)
    ended(solver)
    assert solver.failed
    solver.close()


def test_closing_ends_a_match_and_its_process_at_once(running):
    process = process_of(running)
    running.close(seconds=0)
    assert process.has_ended
    wait([running._working], 10)
    assert running._working.done()


def test_a_process_that_is_idle_is_left_to_the_next_solver(functions):
    pids = []
    for _ in range(2):
        solver = Solver()
        same_run(solver, SPHERE, QUICK)
        pids.append(process_of(solver).pid)
        solver.close()
        Solver().close()  # which has had none
    assert pids[0] == pids[1]


PROBLEM = problem(ENDLESS)


@pytest.fixture
def clock(monkeypatch):
    """Goes on when it is told."""
    clock = SimpleNamespace(seconds=0.0, perf_counter=lambda: clock.seconds)
    monkeypatch.setattr(solver_module, "clock", clock)
    return clock


class Iterate:
    """Whose field takes a while."""

    def __init__(self, clock, iteration, seconds, is_known=True, residual=None):
        self.clock, self.iteration, self.seconds = clock, iteration, seconds
        self.is_known = is_known
        self.residual = 1 / (1 + iteration) if residual is None else residual

    @property
    def velocity(self):
        self.clock.seconds += self.seconds
        if not self.is_known:
            raise AbfmError("ended")
        return "field"


def snapshot(iterate, of=PROBLEM):
    return Snapshot(of, iterate, iterate)


def begun(vertices, problem=PROBLEM):
    course = RunHistory(vertices)
    course.begin(problem)
    return course


@pytest.mark.parametrize(
    ("vertices", "seconds"), [(10_000, 0.007), (40_000, 0.033), (160_000, 0.15), (500, 2.0)]
)
def test_fetching_takes_a_fiftieth_of_the_time_but_for_one_field(clock, vertices, seconds):
    course, spent, moments, iteration = begun(vertices), 0.0, [], 0
    while clock.seconds < 200:
        clock.seconds += 0.01
        iteration += 1
        before = clock.seconds
        course.fetch(snapshot(Iterate(clock, iteration, seconds)))
        if clock.seconds > before:
            spent += seconds
            moments.append(before)
            assert spent <= 0.021 * clock.seconds + (seconds if seconds > 1 else 0)
    assert moments[0] >= FIRST_KEEP_SECONDS
    waits = [later - sooner for sooner, later in pairwise(moments)]
    assert all(later > sooner - 0.05 for sooner, later in pairwise(waits))
    if seconds < 0.1:
        assert moments[0] < FIRST_KEEP_SECONDS + 0.1
        assert max(waits) < solver_module._WAIT_SECONDS_MAX + 0.1


def test_the_best_of_the_present_solve_is_kept(clock):
    course = begun(10)
    first, second = (snapshot(Iterate(clock, number, 0)) for number in (4, 7))
    course.keep(second)
    course.keep(first)
    assert course.best is second
    other = replace(PROBLEM)
    course.begin(other)
    assert course.best is None
    course.keep(second)
    assert course.best is None
    third = snapshot(Iterate(clock, 1, 0), other)
    course.keep(third)
    assert course.best is third


def test_a_start_is_no_field_and_a_process_that_ended_has_none(clock):
    course, start, later = begun(10), Iterate(clock, 0, 0), Iterate(clock, 5, 0.01)
    clock.seconds = 3 * FIRST_KEEP_SECONDS
    for newest, shown in (
        (start, start),
        (later, start),  # nothing that moves was shown yet
        (later, Iterate(clock, 5, 0, is_known=False)),
        (SimpleNamespace(iteration=6), later),  # not yet time for the next one
    ):
        course.fetch(Snapshot(PROBLEM, newest, shown))
        assert course.best is None
    clock.seconds += 100
    course.fetch(snapshot(later))
    assert course.best is not None


def test_a_new_attempt_replaces_no_better_field(solver):
    """On the screen, in copies and where the process is killed: the best one so far stays."""
    solver._under_way, solver._next, solver._since_restart = threading.Event(), None, 0
    solver._course.begin(PROBLEM)

    def post(number, residual, picture="picture", problem=PROBLEM):
        rest = dict.fromkeys(("energy", "regularity", "mismatch_energy", "stage", "reach"), 0.0)
        now = SimpleNamespace(iteration=number, residual=residual, vertices=1, shares={}, **rest)
        now.look = IteratePicture(None, picture)
        solver._post(problem, now)
        return solver.snapshot.iteration.iteration, solver.snapshot.shown.iteration

    assert post(0, 1.4) == (0, 0)
    assert post(1, 0.04) == (1, 1)
    assert post(2, 1.3) == (2, 1)
    assert post(3, 0.02, picture=None) == (3, 1)
    assert post(4, 0.03) == (4, 4)
    assert post(5, 0.9, problem=replace(PROBLEM)) == (5, 5)  # of another problem


def test_a_run_of_several_terms_has_a_curve_for_each():
    course = begun(10)
    now = SimpleNamespace(energy=6.0, regularity=1.0, mismatch_energy=5.0, residual=0.4)
    now.stage, now.vertices, now.reach, now.shares = 0, 10, 0.0, {"closeness": 5.0}
    course.add(now)
    assert list(course.run(0.1, QUICK).curves) == ["energy", "smoothness", "closeness"]
    course.begin(replace(PROBLEM))  # landmarks are set while it runs
    now.shares = {"closeness": 3.0, "landmarks": 2.0}
    course.add(now)
    curves = course.run(0.1, QUICK).curves
    assert {name: list(values) for name, values in curves.items()} == {
        "energy": [6, 6],
        "smoothness": [1, 1],
        "closeness": [5, 3],
        "landmarks": [0, 2],
    }
    assert list(course.run(0.1, QUICK).left) == [0.4, 0.4]
