"""Reports of the process that matches, and the iterates that it stores between two runs."""

import gc
import weakref
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace

import pytest

import abfm
from abfm import AbfmError, MatchingEnergy, Parameters
from abfm.matching import MatchTask
from abfm_viewer.computing import iterates
from abfm_viewer.computing.iterates import FIRST_FIELD_SECONDS, fields, match
from tests.core.fields import bump
from tests.messages import raises
from tests.shapes import icosphere

SPHERE = icosphere(3)
F, G = (bump(SPHERE, SPHERE.vertices[vertex], 0.4)[:, None] for vertex in (0, 30))
QUICK = Parameters.of(iterations=8, levels=2, refine=0)


@pytest.fixture
def reports(monkeypatch):
    reports = []
    monkeypatch.setattr(iterates, "report", reports.append)
    return reports


@pytest.fixture
def energies(monkeypatch):
    """Yield the set of existing energies, without garbage collection of cycles."""
    abfm.match(SPHERE, F, G, QUICK)
    alive, usual = weakref.WeakSet(), MatchingEnergy.__init__

    def init(self, *arguments, **named):
        usual(self, *arguments, **named)
        alive.add(self)

    monkeypatch.setattr(MatchingEnergy, "__init__", init)
    gc.collect()
    gc.disable()
    yield alive
    gc.enable()


def test_ended_run_stores_fields_without_workspace(reports, energies):
    cache = {}
    for run in range(1, 4):
        problem = abfm.Problem(SPHERE, F, G, replace(QUICK, sigma=0.01 * run))
        found = match(cache, run, MatchTask(problem))
        assert [now.iteration for now in reports] == list(range(len(found.energy_history)))
        assert reports[0].view.advected.shape == found.advected.shape
        velocity, advected = fields(cache, run, 10**6)
        assert velocity.shape == found.velocity.shape
        assert advected.shape == found.advected.shape
        assert not energies
        reports.clear()
    fields(cache, 2, 0)  # the window may still show the previous run
    with raises(AbfmError):
        fields(cache, 1, 0)


class Task:
    problem = SimpleNamespace(mesh=SPHERE)

    def __init__(self, post):
        self.post = post

    def solve(self, monitor):
        self.post(monitor.on_partial)


@dataclass(eq=False)
class Iterate:
    """An iterate whose picture and field take time."""

    iteration: int
    residual: float
    view: object = None
    warning = None
    picture_seconds: float = 0.0
    field_seconds: float = 0.0
    clock: object = None

    def _take(self, seconds, what):
        if self.clock is not None:
            self.clock.seconds += seconds
        return f"{what} {self.iteration}"

    @property
    def velocity(self):
        return self._take(self.field_seconds, "field")

    @property
    def advected(self):
        return self._take(self.picture_seconds, "picture")


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(seconds=0.0, perf_counter=lambda: clock.seconds)
    monkeypatch.setattr(iterates, "clock", clock)
    return clock


@pytest.mark.parametrize(("picture", "pause"), [(0.01, 0.09), (0.001, 0.05), (1.0, 0.2)])
def test_pictures_take_a_tenth_of_the_time(picture, pause, monkeypatch, reports, clock):
    monkeypatch.setattr(iterates, "FIRST_FIELD_SECONDS", 1e9)

    def post(take):
        for _ in range(3):
            take(Iterate(0, 1.0, picture_seconds=picture, clock=clock))
            done = clock.seconds
            for clock.seconds in (done, done + 0.99 * pause):
                take(Iterate(0, 1.0))
            clock.seconds = done + 1.01 * pause

    match({}, 1, Task(post))
    assert [one.view.picture for one in reports] == 3 * ["picture 0", None, None]


def test_best_field_stays_available(reports, monkeypatch):
    """The best field is stored during later attempts and after the run, besides the newest ones."""
    monkeypatch.setattr(iterates, "_WAIT_SECONDS_MIN", 0.0)
    monkeypatch.setattr(iterates, "_PICTURE_WAIT_RATIO", 0.0)
    residuals, known = (1.4, 0.5, 0.04, 1.3, 1.2, 1.1, 1.0, 0.9, 0.8), []
    cache = {}

    def post(take):
        for number, residual in enumerate(residuals):
            take(Iterate(number, residual))
            known.append(fields(cache, 1, 2)[0])
        assert fields(cache, 1, 6)[0] == "field 6"
        assert fields(cache, 1, 1)[0] == "field 2"  # its own field is no longer stored

    match(cache, 1, Task(post))
    assert known == ["field 0", "field 1", *7 * ["field 2"]]
    assert fields(cache, 1, 8) == ("field 2", "picture 2")


def sent(reports):
    """Return the reported iterates that have fields."""
    return [now for now in reports if now.view.field is not None]


@pytest.mark.parametrize(
    ("vertices", "seconds"), [(10_000, 0.007), (40_000, 0.033), (160_000, 0.15), (500, 2.0)]
)
def test_fields_take_2_percent_of_the_time(clock, reports, vertices, seconds):
    task, spent, moments = Task(lambda take: follow(take)), 0.0, []
    task.problem = SimpleNamespace(mesh=SimpleNamespace(vertices=range(vertices)))

    def follow(take):
        nonlocal spent
        iteration = 0
        while clock.seconds < 200:
            clock.seconds += 0.01
            iteration += 1
            before = clock.seconds
            take(Iterate(iteration, 1 / iteration, field_seconds=seconds, clock=clock))
            if clock.seconds > before:
                spent += seconds
                moments.append(before)
                assert spent <= 0.021 * clock.seconds + (seconds if seconds > 1 else 0)

    match({}, 1, task)
    assert len(moments) == len(sent(reports))
    assert moments[0] >= FIRST_FIELD_SECONDS
    waits = [later - sooner for sooner, later in pairwise(moments)]
    assert all(later > sooner - 0.05 for sooner, later in pairwise(waits))
    if seconds < 0.1:
        assert moments[0] < FIRST_FIELD_SECONDS + 0.3
        assert max(waits) < iterates._FIELD_WAIT_SECONDS_MAX + 0.3


def test_best_field_is_sent_once(clock, reports):
    def post(take):
        clock.seconds = 3 * FIRST_FIELD_SECONDS
        for iteration, residual in enumerate((0.1, 0.2, 0.05, 0.3)):
            take(Iterate(iteration, residual))
            clock.seconds += 100

    match({}, 1, Task(post))
    assert [now.iteration for now in reports] == [0, 1, 2, 2, 3]  # the start is not sent
    assert [(now.view.field, now.view.picture) for now in sent(reports)] == [
        ("field 2", "picture 2")
    ]
