"""What the process that matches reports of a run, and what it keeps between two."""

import gc
import weakref
from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest

import abfm
from abfm import AbfmError, MatchingEnergy, Parameters
from abfm_viewer.computing import match_apart
from abfm_viewer.computing.match_apart import Matching
from tests.core.fields import bump
from tests.messages import raises
from tests.shapes import icosphere

SPHERE = icosphere(3)
F, G = (bump(SPHERE, SPHERE.vertices[vertex], 0.4)[:, None] for vertex in (0, 30))
QUICK = Parameters.of(iterations=8, levels=2, refine=0)


@pytest.fixture
def reports(monkeypatch):
    """What would be sent of iterates."""
    reports = []
    monkeypatch.setattr(match_apart, "report", reports.append)
    return reports


@pytest.fixture
def energies(monkeypatch):
    """All that are made and not gone, while nothing collects cycles, as compiling leaves some."""
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


def test_every_iterate_is_reported_and_of_an_ended_run_the_last_fields_stay_and_no_workspace(
    reports, energies
):
    state = Matching()
    for run in range(1, 4):
        match = state.match(run, abfm.Problem(SPHERE, F, G, replace(QUICK, sigma=0.01 * run)))
        assert [now.iteration for now in reports] == list(range(len(match.energy_history)))
        assert reports[0].look.advected.shape == match.advected.shape
        velocity, advected = state.fields(run, 10**6)
        assert velocity.shape == match.velocity.shape
        assert advected.shape == match.advected.shape
        assert not energies
        reports.clear()
    state.fields(2, 0)  # of the run before something may be shown yet
    with raises(AbfmError):
        state.fields(1, 0)


@pytest.mark.parametrize(("picture", "pause"), [(0.01, 0.09), (0.001, 0.05), (1.0, 0.2)])
def test_no_picture_is_made_for_nine_times_as_long_as_one_took_within_limits(
    picture, pause, monkeypatch, reports
):
    now, made = [0.0], []
    monkeypatch.setattr(match_apart, "clock", SimpleNamespace(perf_counter=lambda: now[0]))

    @dataclass
    class Iteration:
        look: object = None
        warning = velocity = None
        residual = 1.0

        @property
        def advected(self):
            made.append(self)
            now[0] += picture
            return "picture"

    def match(problem, on_iteration):
        for count in (1, 2, 3):
            on_iteration(Iteration())
            done = now[0]
            for moment in (done, done + 0.99 * pause):
                now[0] = moment
                on_iteration(Iteration())
            assert len(made) == count
            now[0] = done + 1.01 * pause

    monkeypatch.setattr(abfm, "match", match)
    Matching().match(1, None)
    assert [one.look.picture for one in reports] == 3 * ["picture", None, None]


@dataclass(eq=False)
class Iterate:
    iteration: int
    residual: float
    look: object = None
    warning = None

    @property
    def velocity(self):
        return f"field {self.iteration}"

    @property
    def advected(self):
        return f"picture {self.iteration}"


def test_the_best_field_is_known_during_a_later_attempt_and_after_the_run(reports, monkeypatch):
    """Though only a few of the newest are."""
    monkeypatch.setattr(match_apart, "_WAIT_SECONDS_MIN", 0.0)
    monkeypatch.setattr(match_apart, "_TIMES_A_PICTURE", 0.0)
    residuals, known = (1.4, 0.5, 0.04, 1.3, 1.2, 1.1, 1.0, 0.9, 0.8), []
    state = Matching()

    def match(problem, on_iteration):
        for number, residual in enumerate(residuals):
            on_iteration(Iterate(number, residual))
            known.append(state.fields(1, 2)[0])
        assert state.fields(1, 6)[0] == "field 6"
        assert state.fields(1, 1)[0] == "field 2"  # forgotten

    monkeypatch.setattr(abfm, "match", match)
    state.match(1, None)
    assert known == ["field 0", "field 1", *7 * ["field 2"]]
    assert state.fields(1, 8) == ("field 2", "picture 2")
