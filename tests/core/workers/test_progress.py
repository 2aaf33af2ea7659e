"""What is told of long work: shares that only grow, times, and what is unknown said to be so."""

import math
import threading
from itertools import pairwise

import numpy as np
import pytest

import abfm
from abfm import Parameters
from abfm.numerics.factoring_in_subprocess import factoring_in_subprocess
from abfm.workers import progress
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import Step, progress_text, reporting_steps, rounded_time, step, stepped
from tests.mesh_writers import off_file
from tests.shapes import icosphere


@pytest.fixture(autouse=True)
def nothing_measured(monkeypatch):
    """Each test begins with nothing but what it measures itself."""
    monkeypatch.setattr(progress, "_rates", {})


def told_by(work):
    told = []
    with reporting_steps(told.append):
        work()
    return told


def tasks_of(work):
    return [now.task for now in told_by(work) if now]


def test_shares_grow_from_0_never_reach_1_unless_counted_and_times_left_fall():
    for expected in np.random.default_rng(0).uniform(1e-3, 1e3, 50):
        now = Step("factoring", expected=expected, began=100.0)
        moments = 100 + np.linspace(0, 3 * expected, 200)
        shares = [now.share(moment) for moment in moments]
        assert shares[0] == 0
        assert all(a <= b < 1 for a, b in pairwise(shares))
        left = [now.seconds_remaining(moment) for moment in moments]
        known = [seconds for seconds in left if seconds is not None]
        assert all(math.isfinite(seconds) and seconds >= 0 for seconds in known)
        assert known == sorted(known, reverse=True)
        assert left[-1] is None  # it takes longer than expected, and nobody knows how much


@pytest.mark.parametrize(
    ("known", "now", "share", "left"),
    [
        ({"expected": 10.0}, 50.0, 0, 10),  # a clock that went back
        ({}, 105.0, None, None),
        ({"done": 0.0}, 105.0, 0, None),
    ],
)
def test_what_is_unknown_is_said_to_be_unknown(known, now, share, left):
    step = Step("factoring", began=100.0, **known)
    assert (step.share(now), step.seconds_remaining(now)) == (share, left)


@pytest.mark.parametrize(
    ("known", "now", "words"),
    [
        ({}, 101.0, "factoring"),
        ({}, 105.0, "factoring, 5 s so far"),
        ({"expected": 40.0}, 118.0, "factoring, about 20 s left"),
        ({"expected": 40.0}, 150.0, "factoring, 50 s so far"),
        ({"expected": 1.0}, 100.5, "factoring"),
        ({"done": 0.25}, 110.0, "factoring, about 30 s left"),
    ],
)
def test_words_tell_how_long_it_goes_on_where_that_takes_a_while(known, now, words):
    assert Step("factoring", began=100.0, **known).text(now) == words


def test_times_are_rounded_as_one_says_them_and_what_goes_on_is_said_with_its_step():
    told = {0: "1 s", 7.6: "8 s", 12: "10 s", 43: "45 s", 55: "1 min", 100: "2 min", 3600: "60 min"}
    assert {seconds: rounded_time(seconds) for seconds in told} == told
    assert progress_text("opening", None) == "opening"
    assert progress_text("opening", Step("reading an OFF mesh")) == "opening: reading an OFF mesh"


def test_a_counted_step_goes_from_0_to_1_and_never_back():
    def work():
        with step("drawing") as done:
            for share in (0.0, 0.5, 0.25, math.nan, 1.0, 2.0):
                done(share)

    *told, end = told_by(work)
    shares = [now.done for now in told if now.done is not None]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1], end) == (0, 1, None)


def test_a_stepped_loop_is_counted_cancelled_and_ended():
    def work(stop):
        with (
            reporting_steps(told.append),
            controlled(control),
            stepped("walking", range(4)) as items,
        ):
            for item in items:
                seen.append(item)
                stop(item)

    told, seen, control = [], [], Control()
    work(lambda item: None)
    assert seen == [0, 1, 2, 3]
    assert [now and now.done for now in told] == [None, 0.25, 0.5, 0.75, 1.0, None]
    with pytest.raises(CancelledError):
        work(lambda item: control.cancel())
    assert (seen[4:], told[-1]) == ([0], None)


def test_stepped_loop_ends_with_an_error_of_its_body():
    """At once, not when the error and all that its frames refer to are forgotten."""
    errors = []

    def work():
        try:
            with stepped("walking", range(4)) as items:
                for _ in items:
                    raise RuntimeError
        except RuntimeError as error:
            errors.append(error)

    assert [now and now.task for now in told_by(work)] == ["walking", None]


def test_a_step_inside_another_one_is_told_until_it_ends_and_measures_nothing_if_it_fails():
    def work():
        with pytest.raises(RuntimeError), step("outer", 1.0), step("inner"):
            raise RuntimeError

    assert [now and now.task for now in told_by(work)] == ["outer", "inner", "outer", None]
    assert progress._rates == {}


def test_smaller_steps_tell_how_long_larger_ones_take(monkeypatch):
    clock = iter(range(0, 1000, 2))
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(clock)))
    expected = []
    for work in (10.0, 20.0, 80.0):  # each takes two seconds
        told = told_by(lambda work=work: step("factoring", work).__enter__())
        expected.append(told[0].expected)
        progress._store_rate("factoring", 2.0 / work, work)
    assert expected == [None, 4.0, 8.0]


def test_small_works_say_nothing_of_large_ones_that_were_measured():
    progress._store_rate("factoring", 1.0, 100.0)
    progress._store_rate("factoring", 9.0, 1.0)
    assert progress._rates["factoring"] == (1.0, 100.0)
    progress._store_rate("factoring", 3.0, 50.0)
    assert progress._rates["factoring"] == (2.0, 100.0)


def test_only_the_thread_that_asked_is_told():
    def elsewhere():
        with step("factoring"):
            pass

    def work():
        thread = threading.Thread(target=elsewhere)
        thread.start()
        thread.join()

    assert told_by(work) == []


def test_a_match_tells_of_coarser_meshes_factors_and_the_check_and_is_the_same():
    mesh, found = icosphere(3), []
    source, target, _ = mesh.vertices.T
    parameters = Parameters.of(iterations=6, levels=2)
    told = told_by(lambda: found.append(abfm.match(mesh, source, target, parameters)))
    assert told[-1] is None
    first, *tasks, last = [now.task for now in told if now]
    assert (first, last) == ("making coarser meshes", "checking by flow lines")
    assert any(task.startswith("factoring a system of") for task in tasks)
    unheard = abfm.match(icosphere(3), source, target, parameters)
    np.testing.assert_array_equal(found[0].velocity, unheard.velocity)


def test_a_factorisation_in_another_process_is_told_while_it_is_waited_for():
    mesh = icosphere(2)
    with factoring_in_subprocess(1):
        regularizer = abfm.matching.objective.regularizer.regularizer(mesh, 0.01)
        momentum = np.zeros((len(mesh.faces), 2))
        told, again = (tasks_of(lambda: regularizer.inverse(momentum)) for _ in range(2))
    sizes = (len(mesh.edges), len(mesh.vertices))
    assert set(told) == {f"factoring a system of {size} unknowns" for size in sizes}
    assert again == []


def test_functions_files_and_eigenfunctions_are_told(tmp_path):
    mesh = icosphere(3)
    file = off_file(tmp_path / "sphere.off", mesh)
    distances = tasks_of(lambda: abfm.calculus.geodesic_distance(mesh, [0]))
    assert tasks_of(lambda: abfm.load_mesh(file)) == ["reading an OFF mesh"]
    assert distances == ["factoring for distances"]
    assert "computing eigenfunctions: 32" in tasks_of(lambda: abfm.calculus.eigenbasis(mesh, 5))
