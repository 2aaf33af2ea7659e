import ast
import math
import pickle
import threading
from dataclasses import replace
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np
import pytest

import abfm
from abfm import Parameters
from abfm.numerics.factoring_in_subprocess import factoring_in_subprocess
from abfm.workers import progress
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import (
    Overall,
    Step,
    phase,
    progress_text,
    reporting_steps,
    step,
    stepped,
    within,
)
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
        assert all(math.isfinite(seconds) and seconds >= 0 for seconds in remaining)
        early = remaining[: len(moments) // 3]
        assert early == sorted(early, reverse=True)
        assert remaining[-1] > 0.2 * expected  # a late step is not announced to end at once


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
        ({"expected": 40.0}, 118.0, "factoring, within about 30 s"),
        ({"expected": 40.0}, 180.0, "factoring, within about 10 s"),
        ({"expected": 1.0}, 100.5, "factoring"),
        ({"done": 0.25}, 110.0, "factoring, within about 30 s"),
    ],
)
def test_text_shows_times_of_long_steps(known, now, text):
    assert Step("factoring", began=100.0, **known).text(now) == text


def test_times_are_rounded_up_and_texts_include_the_step():
    texts = {0: "5 s", 7.6: "10 s", 12: "20 s", 43: "45 s", 55: "1 min", 100: "2 min"}
    texts |= {3500: "60 min", 7000: "2 h"}
    assert {seconds: within(seconds) for seconds in texts} == {
        seconds: f"within about {text}" for seconds, text in texts.items()
    }
    assert progress_text("opening", None) == "opening"
    assert progress_text("opening", Step("reading an OFF mesh")) == "opening: reading an OFF mesh"


def overall(estimates, every=1.0):
    """Return shares and texts of a task with a new estimate of its remaining time every second."""
    found, shares, texts = Overall(0.0), [], []
    for now, seconds in zip(3 + every * np.arange(len(estimates)), estimates, strict=True):
        found.update(Step("match", began=0.0, after=0.0, expected=now + seconds))
        shares.append(found.share(now))
        texts.append(found.text(now))
    return shares, texts


def test_share_of_a_task_falls_by_a_tenth_at_most():
    rng = np.random.default_rng(0)
    for _ in range(20):
        shares, _ = overall(10 ** rng.uniform(-1, 4, 100))
        highest = np.maximum.accumulate(shares)
        assert (highest - shares <= 0.1 + 1e-12).all()
        assert all(0 <= share <= 1 for share in shares)
    assert overall([7.0, 1e6])[0] == pytest.approx([0.3, 0.2])


def test_share_of_a_task_rises_slowly():
    assert overall([0.0, 0.0, 6.0])[0] == pytest.approx([0.3, 0.4, 0.5], abs=0.02)


def test_remaining_time_follows_large_changes_only():
    ends = np.repeat([50.0, 55.0, 200.0], [10, 10, 170])
    times = [text.removeprefix("within about ") for text in overall(ends - np.arange(3, 193))[1]]
    changes = [time for time, _ in groupby(times)]
    assert changes[:4] == ["1 min", "45 s", "2 min", "3 min"]
    assert changes[4:] == ["2 min", "1 min", "45 s", "30 s", "20 s", "10 s"]


def test_remaining_time_ignores_short_changes():
    _, texts = overall([50.0, *[400.0, *[50.0] * 40] * 5], every=0.1)
    assert {*texts} == {"within about 1 min"}
    _, texts = overall([*[50.0] * 20, *[400.0] * 20])
    assert texts[-1] == "within about 7 min"


def test_steps_outside_phases_do_not_predict_the_end():
    for has_phases, text in (True, ""), (False, "within about 10 s"):
        found = Overall(0.0, has_phases)
        found.update(Step("factoring", began=0.0, expected=9.0))
        assert found.text(3.0) == text
        found.update(Step("match", began=0.0, after=0.0, expected=20.0))
        assert found.text(4.0) != ""


def test_remaining_time_is_unknown_in_the_first_seconds():
    found = Overall(0.0)
    assert (found.name, found.share(1.0), found.text(1.0)) == ("starting", None, "")
    found.update(Step("match", began=0.0, after=0.0, expected=9.0))
    assert (found.share(1.0), found.text(1.0), found.text(3.0)) == (None, "", "within about 10 s")


def test_pause_of_a_task_does_not_count(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(progress, "work_time", lambda: clock[0])
    found = Overall()
    clock[0] = 10.0
    found.update(Step("match", began=0.0, after=0.0, expected=20.0))
    found.set_paused(True)
    clock[0] = 100.0
    assert found.share() == 0.5
    found.set_paused(False)
    found.update(Step("match", began=90.0, after=0.0, expected=20.0))
    assert found.share() == pytest.approx(0.5)


def test_compilation_moves_no_estimate(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(progress, "_compilation_seconds", 0.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    found = Overall()
    with reporting_steps(found.update), phase("match") as report:
        report(20.0, "match")
        clock[0] = 10.0
        with progress.compiling(), progress.compiling():  # the first one includes the second
            clock[0] = 100.0
            assert (found.share(), found.text(), found.detail()) == (0.5, "", progress.COMPILING)
            assert found.step.outer.task == "match"
        assert (found.share(), found.text()) == (0.5, "within about 20 s")


def test_remaining_time_includes_later_phases():
    def work():
        with phase("A to B", repeats=1):
            with phase("initial map", after=20.0), step("comparing") as done:
                done(0.25)
            with phase("match") as report, step("factoring"):
                report(7.0, "refine")

    comparing, refine = (
        next(now for now in reported_steps(work) if now and now.task == task and has(now))
        for task, has in (("comparing", lambda now: now.done), ("refine", lambda now: now.expected))
    )
    assert (comparing.phase, refine.phase) == ("A to B, initial map", "A to B, refine")
    began = comparing.began
    steps = [replace(each, began=began) for each in comparing.chain]
    one, two, three = steps
    comparing = replace(one, outer=replace(two, outer=three))
    # 30 s of the map, 20 s of the match, and as much as both and the 10 s so far again
    assert comparing.seconds_of_task(began + 10) == pytest.approx(30 + 20 + 60)
    assert refine.outer.task == "A to B"


def test_step_of_another_process_keeps_its_age(monkeypatch):
    """Otherwise, each report of a step would restart its clock."""
    clock = [100.0]
    monkeypatch.setattr(progress, "work_time", lambda: clock[0])
    sent = pickle.dumps(Step("match", began=60.0, expected=70.0, after=0.0))
    clock[0] = 7.0
    received = pickle.loads(sent)
    assert (received.began, received.seconds_remaining()) == (-33.0, 30.0)


def test_step_of_another_thread_is_reported_in_its_phase():
    def work():
        with phase("round 1"):
            progress.report_step(Step("match", after=0.0))
            progress.report_step(None)

    first, match, again, end = reported_steps(work)
    assert (match.phase, again.task, end) == ("round 1, match", first.task, None)


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
    *tasks, last = [now.task for now in steps if now]
    assert last == "check"
    assert "making coarser meshes" in tasks
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
