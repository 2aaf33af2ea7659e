"""What the process that matches keeps between two runs."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

import abfm
from abfm import AbfmError, MatchingEnergy, Parameters
from abfm_viewer.computing import match_apart
from abfm_viewer.computing.match_apart import Matching
from tests.core.fields import bump
from tests.shapes import icosphere

SPHERE = icosphere(3)
F, G = (bump(SPHERE, SPHERE.vertices[vertex], 0.4)[:, None] for vertex in (0, 30))
QUICK = Parameters(iterations=8, levels=2)


@pytest.fixture
def reports(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What would be sent of iterates."""
    reports: list[Any] = []
    monkeypatch.setattr(match_apart, "report", reports.append)
    return reports


@pytest.fixture
def energies(monkeypatch: pytest.MonkeyPatch) -> Iterator[weakref.WeakSet[MatchingEnergy]]:
    """All that are made and not gone, while nothing collects cycles, as compiling leaves some."""
    abfm.match(SPHERE, F, G, QUICK)
    alive: weakref.WeakSet[MatchingEnergy] = weakref.WeakSet()
    usual: Callable[..., None] = MatchingEnergy.__init__

    def init(self: MatchingEnergy, *arguments: Any, **named: Any) -> None:
        usual(self, *arguments, **named)
        alive.add(self)

    monkeypatch.setattr(MatchingEnergy, "__init__", init)
    gc.collect()
    gc.disable()
    yield alive
    gc.enable()


def test_of_a_run_that_ended_the_last_fields_stay_and_no_workspace(
    reports: list[Any], energies: weakref.WeakSet[MatchingEnergy]
) -> None:
    state = Matching()
    for run in range(1, 4):
        match = state.match(run, abfm.Problem(SPHERE, F, G, replace(QUICK, sigma=0.01 * run)))
        velocity, advected = state.fields(run, 10**6)
        assert velocity.shape == match.velocity.shape
        assert advected.shape == match.advected.shape
        assert not energies
    state.fields(2, 0)  # of the run before something may be shown yet
    with pytest.raises(AbfmError, match="not known any more"):
        state.fields(1, 0)


def test_every_iterate_is_reported_and_the_first_of_a_run_with_its_picture(
    reports: list[Any],
) -> None:
    match = Matching().match(1, abfm.Problem(SPHERE, F, G, QUICK))
    assert [now.iteration for now in reports] == list(range(len(match.energy_history)))
    assert reports[0].look.advected.shape == match.advected.shape
