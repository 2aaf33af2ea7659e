import ast
import math
import threading
from itertools import pairwise
from pathlib import Path

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
    monkeypatch.setattr(progress, "_rates", {})


def reported_steps(work):
    steps = []
    with reporting_steps(steps.append):
        work()
    return steps


def tasks_of(work):
    return [now.task for now in reported_steps(work) if now]


def test_initial_rates_have_names_of_steps():
    """Every initial rate belongs to a step: a renamed step would silently lose its rate."""
    names = set()
    for path in Path(abfm.__file__).parent.rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "").endswith("step"):
                has_work = len(call.args) > 1 and isinstance(call.args[0], ast.Constant)
                names |= {call.args[0].value} if has_work else set()
    assert set(progress.INITIAL_RATES) <= names


def test_shares_grow_and_remaining_times_fall():
    for expected in np.random.default_rng(0).uniform(1e-3, 1e3, 50):
        now = Step("factoring", expected=expected, began=100.0)
        moments = 100 + np.linspace(0, 3 * expected, 200)
        shares = [now.share(moment) for moment in moments]
        assert shares[0] == 0
        assert all(a <= b < 1 for a, b in pairwise(shares))
        remaining = [now.seconds_remaining(moment) for moment in moments]
        known = [seconds for seconds in remaining if seconds is not None]
        assert all(math.isfinite(seconds) and seconds >= 0 for seconds in known)
        assert known == sorted(known, reverse=True)
        assert remaining[-1] is None


@pytest.mark.parametrize(
    ("known", "now", "share", "remaining"),
    [
        ({"expected": 10.0}, 50.0, 0, 10),  # if the clock was set back
        ({}, 105.0, None, None),
        ({"done": 0.0}, 105.0, 0, None),
    ],
)
def test_unknown_shares_and_times_are_none(known, now, share, remaining):
    step = Step("factoring", began=100.0, **known)
    assert (step.share(now), step.seconds_remaining(now)) == (share, remaining)


@pytest.mark.parametrize(
    ("known", "now", "text"),
    [
        ({}, 101.0, "factoring"),
        ({}, 105.0, "factoring, 5 s so far"),
        ({"expected": 40.0}, 118.0, "factoring, about 20 s left"),
        ({"expected": 40.0}, 150.0, "factoring, 50 s so far"),
        ({"expected": 1.0}, 100.5, "factoring"),
        ({"done": 0.25}, 110.0, "factoring, about 30 s left"),
    ],
)
def test_text_shows_times_of_long_steps(known, now, text):
    assert Step("factoring", began=100.0, **known).text(now) == text


def test_times_are_rounded_and_texts_include_the_step():
    texts = {0: "1 s", 7.6: "8 s", 12: "10 s", 43: "45 s"}
    texts |= {55: "1 min", 100: "2 min", 3600: "60 min"}
    assert {seconds: rounded_time(seconds) for seconds in texts} == texts
    assert progress_text("opening", None) == "opening"
    assert progress_text("opening", Step("reading an OFF mesh")) == "opening: reading an OFF mesh"


def test_counted_share_never_falls():
    def work():
        with step("drawing") as done:
            for share in (0.0, 0.5, 0.25, math.nan, 1.0, 2.0):
                done(share)

    *steps, end = reported_steps(work)
    shares = [now.done for now in steps if now.done is not None]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1], end) == (0, 1, None)


def test_stepped_loop_reports_shares_and_can_be_cancelled():
    def work(stop):
        with (
            reporting_steps(reported.append),
            controlled(control),
            stepped("walking", range(4)) as items,
        ):
            for item in items:
                seen.append(item)
                stop(item)

    reported, seen, control = [], [], Control()
    work(lambda item: None)
    assert seen == [0, 1, 2, 3]
    assert [now and now.done for now in reported] == [None, 0.25, 0.5, 0.75, 1.0, None]
    with pytest.raises(CancelledError):
        work(lambda item: control.cancel())
    assert (seen[4:], reported[-1]) == ([0], None)


def test_stepped_loop_ends_with_an_error_of_its_body():
    """The step ends when the error is raised, not when it is garbage-collected."""
    errors = []

    def work():
        try:
            with stepped("walking", range(4)) as items:
                for _ in items:
                    raise RuntimeError
        except RuntimeError as error:
            errors.append(error)

    assert [now and now.task for now in reported_steps(work)] == ["walking", None]


def test_nested_step_is_reported_until_it_ends():
    def work():
        with pytest.raises(RuntimeError), step("outer", 1.0), step("inner"):
            raise RuntimeError

    assert [now and now.task for now in reported_steps(work)] == ["outer", "inner", "outer", None]
    assert progress._rates == {}


def test_rates_of_small_steps_predict_larger_ones(monkeypatch):
    clock = iter(range(0, 1000, 2))
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(clock)))
    expected = []
    for work in (10.0, 20.0, 80.0):  # each step takes two seconds
        steps = reported_steps(lambda work=work: step("factoring", work).__enter__())
        expected.append(steps[0].expected)
        progress._store_rate("factoring", 2.0 / work, work)
    assert expected == [None, 4.0, 8.0]


def test_small_works_do_not_replace_rates_of_large_ones():
    progress._store_rate("factoring", 1.0, 100.0)
    progress._store_rate("factoring", 9.0, 1.0)
    assert progress._rates["factoring"] == (1.0, 100.0)
    progress._store_rate("factoring", 3.0, 50.0)
    assert progress._rates["factoring"] == (2.0, 100.0)


def test_steps_of_other_threads_are_not_reported():
    def elsewhere():
        with step("factoring"):
            pass

    def work():
        thread = threading.Thread(target=elsewhere)
        thread.start()
        thread.join()

    assert reported_steps(work) == []


def test_match_reports_its_steps():
    mesh, found = icosphere(3), []
    source, target, _ = mesh.vertices.T
    parameters = Parameters.of(iterations=6, levels=2)
    steps = reported_steps(lambda: found.append(abfm.match(mesh, source, target, parameters)))
    assert steps[-1] is None
    first, *tasks, last = [now.task for now in steps if now]
    assert (first, last) == ("making coarser meshes", "checking by flow lines")
    assert any(task.startswith("factoring a system of") for task in tasks)
    unreported = abfm.match(icosphere(3), source, target, parameters)
    np.testing.assert_array_equal(found[0].velocity, unreported.velocity)


def test_factorisation_in_subprocess_is_reported():
    mesh = icosphere(2)
    with factoring_in_subprocess(1):
        regularizer = abfm.matching.objective.regularizer.regularizer(mesh, 0.01)
        momentum = np.zeros((len(mesh.faces), 2))
        first, second = (tasks_of(lambda: regularizer.inverse(momentum)) for _ in range(2))
    sizes = (len(mesh.edges), len(mesh.vertices))
    assert set(first) == {f"factoring a system of {size} unknowns" for size in sizes}
    assert second == []


def test_files_distances_and_eigenfunctions_report_steps(tmp_path):
    mesh = icosphere(3)
    file = off_file(tmp_path / "sphere.off", mesh)
    distances = tasks_of(lambda: abfm.calculus.geodesic_distance(mesh, [0]))
    assert tasks_of(lambda: abfm.load_mesh(file)) == ["reading an OFF mesh"]
    assert distances == ["factoring for distances"]
    assert "computing eigenfunctions: 32" in tasks_of(lambda: abfm.calculus.eigenbasis(mesh, 5))
