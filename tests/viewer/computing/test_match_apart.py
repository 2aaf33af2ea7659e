"""A solver whose matches run in a process of their own."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm import AbfmError, Parameters
from abfm_viewer.computing import keeping, match_apart
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.match_apart import MatchApart
from abfm_viewer.computing.problem import Problem
from abfm_viewer.computing.solver import Solver
from tests.shapes import icosphere
from tests.viewer.sessions import ENDLESS, PAIR, QUICK, SPHERE, problem, until


@pytest.fixture(scope="module")
def functions():
    functions = Functions(SPHERE)
    yield functions
    functions.close()


@pytest.fixture(scope="module")
def solver():
    solver = Solver()
    solver.work_apart()
    yield solver
    solver.close()


def rows(solver: Solver) -> int:
    return len(solver.run.stages) if solver.run else 0


def ended(solver: Solver):
    solver.wait(60)
    result, run, _ = solver.collect()
    return result, run


def same_run(solver: Solver, mesh: abfm.TriangleMesh, parameters: Parameters) -> None:
    """Checks that a match of a mesh is that of `abfm.match`, bit for bit."""
    functions = Functions(mesh)
    solver.start(Problem(mesh, (PAIR,), parameters, ""), functions)
    result, run = ended(solver)
    source, target = functions.evaluate(PAIR.source), functions.evaluate(PAIR.target)
    expected = abfm.match(mesh, source[:, None], target[:, None], parameters)
    functions.close()
    assert result.mesh is mesh
    np.testing.assert_array_equal(result.velocity, expected.velocity)
    np.testing.assert_array_equal(result.advected, expected.advected)
    np.testing.assert_array_equal(run.energies, expected.energy_history)
    assert (result.verdict, result.stop_reason) == (expected.verdict, expected.stop_reason)


def test_it_finds_what_match_finds_also_on_another_mesh(solver):
    same_run(solver, SPHERE, QUICK)
    same_run(solver, icosphere(2), replace(QUICK, levels=2))


def test_coarser_meshes_that_are_made_ahead_change_nothing(solver):
    mesh = icosphere(2)
    solver.prepare(mesh, replace(QUICK, levels=2))
    same_run(solver, mesh, replace(QUICK, levels=2))


def test_a_paused_run_stands_still_goes_on_and_ends_when_cancelled(solver, functions):
    solver.start(problem(ENDLESS), functions)
    until(lambda: rows(solver) > 3)
    solver.pause()
    time.sleep(0.3)
    count = rows(solver)
    time.sleep(0.2)
    assert rows(solver) == count
    solver.resume()
    until(lambda: rows(solver) > count + 3)
    solver.cancel()
    result, run = ended(solver)
    assert result.stop_reason == "cancelled"
    assert len(result.energy_history) == len(run.stages)


def test_a_run_that_is_cancelled_while_it_starts_ends_after_its_first_evaluation(solver, functions):
    solver.start(problem(ENDLESS), functions)
    solver.pause()
    solver.cancel()
    result, _ = ended(solver)
    assert result.stop_reason == "cancelled"


def test_a_run_follows_another_problem(solver, functions):
    solver.start(problem(ENDLESS), functions)
    until(lambda: rows(solver) > 3)
    changed = problem(replace(ENDLESS, beta=1e-4))
    solver.follow_problem(changed)
    until(lambda: solver.snapshot.problem is changed)
    assert solver.snapshot.shown.iteration <= solver.snapshot.iteration.iteration
    solver.cancel()
    _, run = ended(solver)
    assert len(run.restarts) == 1


def test_the_fields_of_an_iterate_come_when_they_are_asked_for(solver, functions):
    solver.start(problem(ENDLESS), functions)
    until(lambda: rows(solver) > 3)
    solver.pause()
    time.sleep(0.3)
    shown = solver.snapshot.shown
    carried = abfm.Flow(SPHERE, shown.velocity, ENDLESS.tau).push(functions.evaluate(PAIR.source), ENDLESS.tau)
    np.testing.assert_allclose(carried, shown.advected[:, 0], atol=1e-5)
    solver.cancel()
    ended(solver)
    solver.start(problem(), functions)
    ended(solver)
    assert shown.velocity is shown.velocity  # kept once it was there


def test_the_fields_of_a_run_that_is_over_are_not_known_any_more(solver, functions):
    solver.start(problem(ENDLESS), functions)
    until(lambda: rows(solver) > 3)
    shown = solver.snapshot.shown
    solver.cancel()
    ended(solver)
    for _ in range(2):
        solver.start(problem(), functions)
        ended(solver)
    with pytest.raises(AbfmError, match="not known any more"):
        _ = shown.velocity


def test_what_is_wrong_with_a_problem_is_told_in_the_same_words(solver, functions):
    negative = replace(problem(), mask="expression:0 * x - 1")
    solver.start(negative, functions)
    solver.wait(60)
    solver.collect()
    source, target, mask = map(functions.evaluate, (PAIR.source, PAIR.target, negative.mask))
    with pytest.raises(AbfmError) as error:
        abfm.match(SPHERE, source, target, QUICK, mask=mask)
    assert solver.failed
    assert solver.reason == str(error.value)


def test_a_process_that_is_killed_fails_its_run_and_the_next_run_has_another(solver, functions):
    solver.start(problem(ENDLESS), functions)
    until(lambda: rows(solver) > 3)
    shown = solver.snapshot.shown
    os.kill(solver._apart._connection._process._process.pid, signal.SIGKILL)
    solver.wait(60)
    solver.collect()
    assert solver.failed
    assert "match again" in solver.reason
    with pytest.raises(AbfmError, match="match again"):
        _ = shown.velocity
    same_run(solver, SPHERE, QUICK)


def test_a_killed_process_leaves_no_zombie_and_what_was_asked_for_of_its_run_is_kept(solver, functions):
    solver.start(problem(ENDLESS), functions)
    until(lambda: rows(solver) > 3)
    found, _ = solver.unfinished(solver.snapshot, functions)
    process = solver._apart._connection._process._process
    os.kill(process.pid, signal.SIGKILL)
    result, run = ended(solver)
    assert solver.failed
    np.testing.assert_array_equal(result.velocity, found.velocity)
    assert len(run.stages) >= len(found.energy_history)
    until(lambda: process.returncode is not None)  # which is known when it was waited for
    solver.start(problem(ENDLESS), functions)
    os.kill(solver._apart._connected()._process._process.pid, signal.SIGKILL)
    result, _ = ended(solver)
    assert result is None  # that of an earlier run is not this one's


def test_a_killed_process_leaves_the_field_that_came_over_early_though_nobody_asked(solver, functions, monkeypatch):
    monkeypatch.setattr(keeping, "FIRST", 0.2)
    solver.start(problem(ENDLESS), functions)
    until(lambda: solver._keeper.newest)
    kept = solver._keeper.newest
    os.kill(solver._apart._connection._process._process.pid, signal.SIGKILL)
    result, run = ended(solver)
    assert solver.failed
    assert "\n" not in solver.reason
    assert result.velocity.any()
    if solver._keeper.newest is kept:  # else another one came just before
        np.testing.assert_array_equal(result.velocity, kept.iteration.velocity)
    carried = abfm.Flow(SPHERE, result.velocity, ENDLESS.tau).push(functions.evaluate(PAIR.source), ENDLESS.tau)
    np.testing.assert_allclose(carried, result.advected[:, 0], atol=1e-5)
    assert len(run.stages) > kept.iteration.iteration


def test_a_run_that_is_killed_after_a_change_leaves_what_was_found_since_or_before(solver, functions, monkeypatch):
    monkeypatch.setattr(keeping, "FIRST", 0.1)
    solver.start(problem(ENDLESS), functions)
    until(lambda: solver._keeper.newest)
    changed = problem(replace(ENDLESS, beta=1e-4))
    solver.follow_problem(changed)
    until(lambda: solver.snapshot.problem is changed)
    os.kill(solver._apart._connection._process._process.pid, signal.SIGKILL)
    result, _ = ended(solver)
    assert solver.failed
    assert result.velocity.any()


def test_a_run_that_waits_for_coarser_meshes_tells_of_them(functions):
    solver, told = Solver(), []
    solver.work_apart()
    tell = solver._at
    solver._at = lambda step: (told.append(step), tell(step))
    solver.prepare(SPHERE, replace(QUICK, levels=2))
    solver.start(problem(replace(QUICK, levels=2)), functions)
    ended(solver)
    solver.close()
    tasks = [step.task for step in told if step]
    assert tasks.count("making coarser meshes") == 2  # ahead, and when the match takes them
    assert told[-1] is None


def test_a_match_is_of_its_mesh_though_another_one_is_prepared_meanwhile(functions):
    apart = MatchApart()
    connected, other = apart._connected, icosphere(2)

    def interrupted(mesh=None):
        connection = connected(mesh)
        if mesh is SPHERE:
            thread = threading.Thread(target=apart.prepare, args=(other, QUICK))
            thread.start()
            thread.join(0.5)
        return connection

    apart._connected = interrupted
    given = {"mask": None, "weights": [1.0], "start": None, "on_iteration": lambda _: None, "tell": lambda _: None}
    pair = [functions.evaluate(spec)[:, None] for spec in (PAIR.source, PAIR.target)]
    found = apart.match(SPHERE, *pair, QUICK, control=apart.control(), **given)
    assert len(found.advected) == len(SPHERE.vertices)
    apart.close()


def test_what_fails_while_meshes_are_made_ahead_stops_no_match(solver):
    mesh = icosphere(2)
    solver.prepare(mesh, None)
    same_run(solver, mesh, QUICK)


def test_closing_ends_the_process_and_what_waits_for_it(functions):
    solver = Solver()
    solver.work_apart()
    solver.start(problem(ENDLESS), functions)
    until(lambda: rows(solver) > 3)
    process = solver._apart._connection._process._process
    solver.close(seconds=0)
    assert process.poll() is not None
    solver._thread.join(10)
    assert not solver._thread.is_alive()


def test_a_process_that_does_not_start_fails_the_run(functions, monkeypatch):
    monkeypatch.setattr(match_apart, "MODULE", "abfm_viewer.computing.nothing")
    solver = Solver()
    solver._apart = MatchApart()
    solver.start(problem(), functions)
    solver.wait(60)
    solver.collect()
    assert solver.failed
    solver.close()
