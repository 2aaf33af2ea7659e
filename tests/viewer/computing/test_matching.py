"""A run of a match: it is what `abfm.match` does, follows changes, and keeps its best field."""

import itertools
import os
import signal
from dataclasses import MISSING, fields, replace

import numpy as np
import pytest

import abfm
from abfm import AbfmError
from abfm_viewer.computing.evaluation import Evaluators, Functions
from abfm_viewer.computing.iterates import IteratePicture
from abfm_viewer.computing.matching import Matching, ProblemSpec, _History
from abfm_viewer.computing.run import Process, Run, RunState
from abfm_viewer.document.document import Channel
from tests.messages import check_message, raises
from tests.shapes import icosphere, tetrahedron
from tests.viewer.sessions import ENDLESS, PAIR, QUICK, SPHERE, problem, until


@pytest.fixture(scope="module")
def functions():
    functions = Functions(SPHERE)
    yield Evaluators(functions, functions)
    functions.retire()


class Matched(Matching):
    """A match whose result is taken by `ended`."""

    def __init__(self):
        self.run = Run(Process())
        super().__init__(self.run)

    def begin(self, problem, functions, field=None):
        self.left = None
        self.start(problem, functions, lambda *left: setattr(self, "left", left), field)

    def ended(self):
        """The result, the record and the problem that a run leaves, which ends of itself."""
        assert self.run.wait(60)
        self.run.collect()
        return self.left

    def cancelled(self):
        self.run.cancel()
        return self.ended()

    def killed(self):
        until(lambda: self.run.process._worker.pid)
        os.kill(self.run.process._worker.pid, signal.SIGKILL)
        left = self.ended()
        assert self.run.failed
        return left

    @property
    def rows(self):
        return len(self.record.stages) if self.record else 0


@pytest.fixture
def matching():
    matching = Matched()
    yield matching
    matching.run.close()


@pytest.fixture
def running(matching, functions):
    """One with a run that goes on until it is told otherwise, and has made some steps."""
    matching.begin(problem(ENDLESS), functions)
    until(lambda: matching.rows > 3)
    return matching


def same_run(matching, mesh, parameters):
    """Check that a match of a mesh is that of `abfm.match`, bit for bit."""
    functions = Functions(mesh)
    evaluators = Evaluators(functions, functions)
    matching.begin(ProblemSpec(mesh, (PAIR,), parameters, ""), evaluators)
    matching.run.wait(60)
    newest = matching.snapshot.iteration.iteration
    result, record, _ = matching.ended()
    # text, which finer meshes evaluate anew
    expected = abfm.match(abfm.Problem(mesh, [PAIR.source], [PAIR.target], parameters))
    functions.retire()
    assert (matching.running, matching.run.state) == (False, RunState.ENDED)
    assert result.mesh is mesh
    for name in ("velocity", "advected", "energy_history", "stages"):
        np.testing.assert_array_equal(getattr(result, name), getattr(expected, name))
    np.testing.assert_array_equal(record.energies, expected.energy_history)
    np.testing.assert_array_equal(record.stages, expected.stages)
    assert (record.restarts, len(record.sigmas)) == ((), len(record.stages))
    assert record.sigmas[0] == expected.path[0].sigma
    assert (result.verdict, result.stop_reason) == (expected.verdict, expected.stop_reason)
    assert newest == len(record.energies) - 1


def carries(match, functions):
    """Check that a field carries the source to what it says."""
    flow = abfm.Flow(SPHERE, match.velocity, ENDLESS.tau)
    carried = flow.push(functions.evaluate(PAIR.source), ENDLESS.tau)
    np.testing.assert_allclose(carried, match.advected[:, 0], atol=1e-5)


def test_it_finds_what_match_finds_also_on_another_mesh_prepared_or_not(matching):
    assert (matching.snapshot, matching.record) == (None, None)
    same_run(matching, SPHERE, QUICK)
    mesh = icosphere(2)
    matching.prepare(mesh, None)  # what fails while meshes are made ahead stops no match
    matching.prepare(mesh, QUICK.with_values(levels=2))
    same_run(matching, mesh, QUICK.with_values(levels=2))


def test_a_run_that_waits_for_coarser_meshes_tells_of_them(matching, functions):
    told = []
    tell = matching.run._set_step
    matching.run._set_step = lambda step: (told.append(step), tell(step))
    sphere = abfm.TriangleMesh(1.1 * SPHERE.vertices, SPHERE.faces)  # of which none are made yet
    matching.prepare(sphere, QUICK.with_values(levels=2))
    matching.begin(replace(problem(QUICK.with_values(levels=2)), mesh=sphere), functions)
    matching.ended()
    tasks = [step.task for step in told if step]
    assert tasks.count("making coarser meshes") == 2  # ahead, and when the match takes them
    assert told[-1] is None


def test_a_mask_and_weights_reach_match_and_what_is_wrong_is_told_in_the_same_words(
    matching, functions
):
    masked = replace(problem(), mask="expression:where(x > 0, 1, 0)")
    matching.begin(replace(masked, channels=(replace(PAIR, weight=2.0),)), functions)
    result, *_ = matching.ended()
    np.testing.assert_array_equal(result.mask, functions.evaluate(masked.mask))
    assert result.weights.tolist() == [2.0]
    negative = replace(problem(), mask="expression:0 * x - 1")
    matching.begin(negative, functions)
    matching.ended()
    source, target, mask = map(functions.evaluate, (PAIR.source, PAIR.target, negative.mask))
    with pytest.raises(AbfmError) as error:
        abfm.match(SPHERE, source, target, QUICK, mask=mask)
    assert (matching.run.failed, matching.run.reason) == (True, str(error.value))


def test_a_start_that_is_too_fast_is_replaced_by_none(matching, functions):
    wild = np.zeros((1, len(SPHERE.faces), 3))
    wild[:, :, 0] = 1e6
    matching.begin(problem(), functions, wild)
    first, record, _ = matching.ended()
    assert (matching.run.failed, record.energies[0, 1]) == (False, 0)
    matching.begin(problem(), functions, first.start_for(replace(QUICK, tau=1e-20)))
    second, *_ = matching.ended()
    assert not matching.run.failed
    np.testing.assert_array_equal(second.velocity, first.velocity)


def test_the_record_is_the_same_object_until_there_is_more_of_it(running):
    running.run.pause()
    until(lambda: running.record is running.record)
    running.run.resume()
    before = running.record
    until(lambda: running.rows > len(before.stages))
    assert running.record is not before
    # some come with a picture: these are shown
    until(lambda: running.snapshot.shown.iteration > 0)
    assert running.snapshot.shown.view.picture is not None
    until(lambda: running.snapshot.iteration.view.picture is None)
    assert running.snapshot.shown.iteration <= running.snapshot.iteration.iteration


def test_the_fields_of_an_iterate_come_when_they_are_asked_for_and_are_known_for_a_while(
    running, functions
):
    running.run.pause()
    shown = running.snapshot.shown
    again = replace(shown, view=replace(shown.view, picture=None))
    carries(shown, functions)
    running.cancelled()
    for _ in range(2):
        running.begin(problem(), functions)
        running.ended()
    assert shown.velocity is shown.velocity  # kept once it was there
    with raises(AbfmError):
        _ = again.velocity


def test_a_cancelled_run_ends_with_the_best_field(running):
    running.run.pause()
    result, record, solved = running.cancelled()
    assert (running.run.failed, result.stop_reason) == (False, "cancelled")
    assert len(result.energy_history) == len(record.stages)
    totals = record.energies[:, 0]
    assert totals[-1] == totals.min() < totals[0]
    assert solved.parameters == ENDLESS
    assert (running.snapshot, running.record) == (None, None)


def test_a_run_that_is_cancelled_while_it_starts_ends_after_its_first_evaluation(
    matching, functions
):
    matching.begin(problem(ENDLESS), functions)
    result, record, _ = matching.cancelled()
    assert result.stop_reason == "cancelled"
    assert len(record.stages) >= 1


def test_a_run_follows_another_problem_from_the_field_that_was_there(running):
    until(lambda: running.rows > 40)
    changed = problem(replace(ENDLESS, beta=1e-4))
    running.follow_problem(changed, dragging=True)
    assert running.problem is changed
    until(lambda: running.snapshot.problem is changed)
    first = running.snapshot
    assert first.shown.iteration <= first.iteration.iteration
    until(lambda: running.rows > 60)
    result, run, _ = running.cancelled()
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

    until(lambda: change() or len(running.record.restarts) > 4)
    until(lambda: running.snapshot.problem is running.problem)
    _, run, _ = running.cancelled()
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
    result, _, solved = running.ended()
    assert (solved.mesh, result.stop_reason) == (SPHERE, "cancelled")
    assert running.problem.parameters == result.parameters == ENDLESS


def test_a_restart_that_cannot_be_solved_keeps_the_result_so_far(running):
    unknown = Channel("gaussian:vertex=100000,width=0.1", PAIR.target)
    running.follow_problem(problem(ENDLESS, unknown))
    result, *_ = running.ended()
    assert running.run.failed
    assert "100000" in running.run.reason
    assert result.stop_reason == "cancelled"


def test_a_killed_process_leaves_a_field_that_was_asked_for(running, functions):
    """The next run has another process."""
    found, _ = running.unfinished(running.snapshot, functions)
    result, record, _ = running.killed()
    check_message(running.run.reason)
    np.testing.assert_array_equal(result.velocity, found.velocity)
    assert len(record.stages) >= len(found.energy_history)
    running.begin(problem(ENDLESS), functions)
    until(lambda: running.rows > 0)
    result, *_ = running.killed()
    assert result is None  # that of an earlier run is not this one's


@pytest.fixture
def keeping(running):
    """One with a run of which a field came over though nobody asked."""
    until(lambda: running._best)
    return running


def test_a_killed_process_leaves_the_field_that_came_over(keeping, functions):
    kept = keeping._best
    result, record, _ = keeping.killed()
    assert result.velocity.any()
    assert result.residual <= kept.shown.residual
    carries(result, functions)
    assert len(record.stages) > kept.iteration.iteration


def test_a_run_that_is_killed_after_a_change_leaves_what_was_found_since_or_before(keeping):
    changed = problem(replace(ENDLESS, beta=1e-4))
    keeping.follow_problem(changed)
    until(lambda: keeping.snapshot.problem is changed)
    assert keeping._best is None
    result, *_ = keeping.killed()
    assert result.velocity.any()


def iterate(**given):
    """An iterate with what is given."""
    names = (field.name for field in fields(abfm.matching.Iteration) if field.default is MISSING)
    numbers = {"energy": 6.0, "regularity": 1.0, "mismatch_energy": 5.0, "residual": 0.4}
    known = dict.fromkeys(names, 0) | numbers | {"sigma": 0.1, "shares": {}}
    return abfm.matching.Iteration(**(known | given))


def test_a_new_attempt_replaces_no_better_field(matching):
    """On the screen, in copies and where the process is killed: the best one so far stays."""
    matching._next, matching._since_restart = None, 0
    first, second = problem(), problem()
    matching._present = first

    def post(number, residual, picture="picture", of=first, field=None):
        view = IteratePicture(None, picture, field)
        matching._post(of, iterate(iteration=number, residual=residual, view=view))
        return matching.snapshot.iteration.iteration, matching.snapshot.shown.iteration

    assert post(0, 1.4) == (0, 0)
    assert post(1, 0.04) == (1, 1)
    assert post(2, 1.3) == (2, 1)
    assert post(3, 0.02, picture=None) == (3, 1)
    assert post(4, 0.03) == (4, 4)
    for number, residual, of, best in (
        (4, 0.04, first, 4),
        (1, 0.05, first, 4),
        (3, 0.02, first, 3),
        (9, 0.01, second, 3),  # of another problem
    ):
        assert post(number, residual, of=of, field="field") == (4, 4)
        assert matching._best.shown.iteration == best
    assert post(5, 0.9, of=second) == (5, 5)


def test_a_run_of_several_terms_has_a_curve_for_each():
    history = _History()
    history.add(iterate(shares={"closeness": 5.0}))
    assert list(history.record(0.1, QUICK).curves) == ["energy", "smoothness", "closeness"]
    history.begin()  # landmarks are set while it runs
    history.add(iterate(shares={"closeness": 3.0, "landmarks": 2.0}))
    curves = history.record(0.1, QUICK).curves
    assert {name: list(values) for name, values in curves.items()} == {
        "energy": [6, 6],
        "smoothness": [1, 1],
        "closeness": [5, 3],
        "landmarks": [0, 2],
    }
    assert list(history.record(0.1, QUICK).left) == [0.4, 0.4]
    assert list(history.record(0.1, QUICK).sigmas) == [0.1, 0.1]
