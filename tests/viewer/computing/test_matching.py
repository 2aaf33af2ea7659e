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


class MatchingRun(Matching):
    """A match whose result is returned by `ended`."""

    def __init__(self):
        self.run = Run(Process())
        super().__init__(self.run)

    def begin(self, problem, functions, field=None):
        self.end = None
        self.start(problem, functions, lambda *end: setattr(self, "end", end), field)

    def ended(self):
        """Return the result, the record and the problem of a run, when it has ended."""
        assert self.run.wait(60)
        self.run.collect()
        return self.end

    def cancelled(self):
        self.run.cancel()
        return self.ended()

    def killed(self):
        until(lambda: self.run.process._worker.pid)
        os.kill(self.run.process._worker.pid, signal.SIGKILL)
        end = self.ended()
        assert self.run.failed
        return end

    @property
    def rows(self):
        return len(self.record.stages) if self.record else 0


@pytest.fixture
def matching():
    matching = MatchingRun()
    yield matching
    matching.run.close()


@pytest.fixture
def running(matching, functions):
    """Return a matching whose run does not end by itself, after some steps."""
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
    # texts, which are evaluated again on finer meshes
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


def check_advected(match, functions):
    flow = abfm.Flow(SPHERE, match.velocity, ENDLESS.tau)
    pushed = flow.push(functions.evaluate(PAIR.source), ENDLESS.tau)
    np.testing.assert_allclose(pushed, match.advected[:, 0], atol=1e-5)


def test_run_equals_match(matching):
    assert (matching.snapshot, matching.record) == (None, None)
    same_run(matching, SPHERE, QUICK)
    mesh = icosphere(2)
    matching.prepare(mesh, None)  # an error during preparation does not stop a match
    matching.prepare(mesh, QUICK.with_values(levels=2))
    same_run(matching, mesh, QUICK.with_values(levels=2))


def test_run_reports_preparation_of_coarser_meshes(matching, functions):
    steps = []
    set_step = matching.run._set_step
    matching.run._set_step = lambda step: (steps.append(step), set_step(step))
    sphere = abfm.TriangleMesh(1.1 * SPHERE.vertices, SPHERE.faces)  # without coarser meshes
    matching.prepare(sphere, QUICK.with_values(levels=2))
    matching.begin(replace(problem(QUICK.with_values(levels=2)), mesh=sphere), functions)
    matching.ended()
    tasks = [step.task for step in steps if step]
    assert tasks.count("making coarser meshes") == 2  # in advance, and for the match
    assert steps[-1] is None


def test_mask_weights_and_errors_equal_match(matching, functions):
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


def test_too_fast_start_is_ignored(matching, functions):
    wild = np.zeros((1, len(SPHERE.faces), 3))
    wild[:, :, 0] = 1e6
    matching.begin(problem(), functions, wild)
    first, record, _ = matching.ended()
    assert (matching.run.failed, record.energies[0, 1]) == (False, 0)
    matching.begin(problem(), functions, first.start_for(replace(QUICK, tau=1e-20)))
    second, *_ = matching.ended()
    assert not matching.run.failed
    np.testing.assert_array_equal(second.velocity, first.velocity)


def test_record_is_the_same_object_until_it_grows(running):
    running.run.pause()
    until(lambda: running.record is running.record)
    running.run.resume()
    before = running.record
    until(lambda: running.rows > len(before.stages))
    assert running.record is not before
    # only iterates with a picture are shown
    until(lambda: running.snapshot.shown.iteration > 0)
    assert running.snapshot.shown.view.picture is not None
    until(lambda: running.snapshot.iteration.view.picture is None)
    assert running.snapshot.shown.iteration <= running.snapshot.iteration.iteration


def test_fields_are_fetched_on_request(running, functions):
    running.run.pause()
    shown = running.snapshot.shown
    again = replace(shown, view=replace(shown.view, picture=None))
    check_advected(shown, functions)
    running.cancelled()
    for _ in range(2):
        running.begin(problem(), functions)
        running.ended()
    assert shown.velocity is shown.velocity  # the field is stored after the first request
    with raises(AbfmError):
        _ = again.velocity


def test_cancel_keeps_best_field(running):
    running.run.pause()
    result, record, solved = running.cancelled()
    assert (running.run.failed, result.stop_reason) == (False, "cancelled")
    assert len(result.energy_history) == len(record.stages)
    totals = record.energies[:, 0]
    assert totals[-1] == totals.min() < totals[0]
    assert solved.parameters == ENDLESS
    assert (running.snapshot, running.record) == (None, None)


def test_cancel_at_start_ends_after_one_evaluation(matching, functions):
    matching.begin(problem(ENDLESS), functions)
    result, record, _ = matching.cancelled()
    assert result.stop_reason == "cancelled"
    assert len(record.stages) >= 1


def test_run_continues_with_changed_problem(running):
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
    # the field continues
    assert regularity[restart] == pytest.approx(regularity[restart - 1], rel=0.1)
    assert result.parameters == changed.parameters


def test_frequent_changes_allow_iterations(running):
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
def test_another_mesh_ends_the_run(running, follow):
    running.follow = follow
    if not follow:
        running.follow_problem(problem(replace(ENDLESS, beta=1e-3)))
        assert running.problem.parameters == ENDLESS
    running.follow_problem(replace(problem(ENDLESS), mesh=tetrahedron()), dragging=False)
    running.follow_problem(problem(QUICK))
    result, _, solved = running.ended()
    assert (solved.mesh, result.stop_reason) == (SPHERE, "cancelled")
    assert running.problem.parameters == result.parameters == ENDLESS


def test_failed_restart_keeps_the_result(running):
    unknown = Channel("gaussian:vertex=100000,width=0.1", PAIR.target)
    running.follow_problem(problem(ENDLESS, unknown))
    result, *_ = running.ended()
    assert running.run.failed
    assert "100000" in running.run.reason
    assert result.stop_reason == "cancelled"


def test_killed_process_leaves_a_requested_field(running, functions):
    found, _ = running.unfinished(running.snapshot, functions)
    result, record, _ = running.killed()
    check_message(running.run.reason)
    np.testing.assert_array_equal(result.velocity, found.velocity)
    assert len(record.stages) >= len(found.energy_history)
    running.begin(problem(ENDLESS), functions)
    until(lambda: running.rows > 0)
    result, *_ = running.killed()
    assert result is None  # not a field of an earlier run


@pytest.fixture
def with_sent_field(running):
    """Return a matching with a run that sent a field without a request."""
    until(lambda: running._best)
    return running


def test_killed_process_leaves_the_sent_field(with_sent_field, functions):
    sent = with_sent_field._best
    result, record, _ = with_sent_field.killed()
    assert result.velocity.any()
    assert result.residual <= sent.shown.residual
    check_advected(result, functions)
    assert len(record.stages) > sent.iteration.iteration


def test_killed_run_keeps_the_latest_result(with_sent_field):
    changed = problem(replace(ENDLESS, beta=1e-4))
    with_sent_field.follow_problem(changed)
    until(lambda: with_sent_field.snapshot.problem is changed)
    assert with_sent_field._best is None
    result, *_ = with_sent_field.killed()
    assert result.velocity.any()


def iterate(**given):
    names = (field.name for field in fields(abfm.matching.Iteration) if field.default is MISSING)
    numbers = {"energy": 6.0, "regularity": 1.0, "mismatch_energy": 5.0, "residual": 0.4}
    known = dict.fromkeys(names, 0) | numbers | {"sigma": 0.1, "term_energies": {}}
    return abfm.matching.Iteration(**(known | given))


def test_new_attempt_does_not_replace_a_better_field(matching):
    matching._next, matching._since_restart = None, 0
    first, second = problem(), problem()
    matching._current = first

    def post(number, residual, picture="picture", of=first, field=None, **more):
        view = IteratePicture(None, picture, field)
        matching._post(of, iterate(iteration=number, residual=residual, view=view, **more))
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
        (9, 0.01, second, 3),  # the problem has changed
    ):
        assert post(number, residual, of=of, field="field") == (4, 4)
        assert matching._best.shown.iteration == best
    assert post(5, 0.9, of=second) == (5, 5)
    for attempt, others in ((2, {1: ()}), (1, {2: ("a step",)})):
        post(6, 0.9, of=second, attempt=attempt, path=("a step",))
        assert matching.snapshot.others == others


def test_record_has_a_curve_for_each_term():
    history = _History()
    history.add(iterate(term_energies={"closeness": 5.0}))
    assert list(history.record(0.1, QUICK).curves) == ["energy", "smoothness", "closeness"]
    history.begin()  # landmarks are set during the run
    history.add(iterate(term_energies={"closeness": 3.0, "landmarks": 2.0}))
    curves = history.record(0.1, QUICK).curves
    assert {name: list(values) for name, values in curves.items()} == {
        "energy": [6, 6],
        "smoothness": [1, 1],
        "closeness": [5, 3],
        "landmarks": [0, 2],
    }
    assert list(history.record(0.1, QUICK).residual_curve) == [0.4, 0.4]
    assert list(history.record(0.1, QUICK).sigmas) == [0.1, 0.1]
