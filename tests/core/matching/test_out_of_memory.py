"""Memory that runs out in the middle of a match."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

import abfm
from abfm.matching.objective.matching_energy import Evaluation, Objective
from abfm.types import FloatArray
from tests.core.fields import bump
from tests.shapes import icosphere

SPHERE = icosphere(2)
F, G = (bump(SPHERE, SPHERE.vertices[vertex], 0.3) for vertex in (0, 30))


def full_after(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Let memory run out in the evaluation of the energy after so many."""
    usual = Objective.evaluate
    made = []

    def evaluate(objective: Objective, fields: FloatArray) -> Evaluation:
        made.append(1)
        if len(made) > count:
            raise MemoryError("Unable to allocate 1 GiB")
        return usual(objective, fields)

    monkeypatch.setattr(Objective, "evaluate", evaluate)


def test_the_best_field_so_far_is_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    whole = abfm.match(SPHERE, F, G)
    full_after(monkeypatch, 6)
    match = abfm.match(SPHERE, F, G)
    assert match.stop_reason == "out of memory"
    assert "memory ran out" in match.verdict.reason
    assert 2 < len(match.energy_history) < len(whole.energy_history)
    assert match.mismatch < match.initial_mismatch
    assert np.isfinite(match.verified_mismatch)
    match.save(tmp_path / "m.npz")
    assert abfm.load_match(tmp_path / "m.npz").stop_reason == "out of memory"


def test_without_a_field_it_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    full_after(monkeypatch, 0)
    with pytest.raises(MemoryError):
        abfm.match(SPHERE, F, G)


def test_a_match_is_kept_where_there_is_no_memory_to_check_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def estimate(*_: Any) -> Any:
        raise MemoryError

    monkeypatch.setattr(sys.modules[abfm.match.__module__], "estimate", estimate)
    match = abfm.match(SPHERE, F, G)
    assert match.mismatch < 0.1
    assert np.isnan(match.verified_mismatch)


@pytest.mark.parametrize("count", [40, 60, 80])
def test_what_an_earlier_search_found_outlives_one_that_runs_out_of_memory(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """Each way to the target begins with a zero field, which matches nothing."""
    mesh = icosphere(3)
    f, g = (bump(mesh, mesh.vertices[vertex], 0.1) for vertex in (0, 200))
    seen: list[float] = []
    full_after(monkeypatch, count)
    match = abfm.match(mesh, f, g, on_iteration=lambda now: seen.append(now.mismatch))
    assert match.stop_reason == "out of memory"
    assert match.mismatch <= 1.01 * min(seen)


def test_memory_that_runs_out_for_the_caller_is_the_callers() -> None:
    def note(now: abfm.Iteration) -> None:
        if now.iteration == 3:
            raise MemoryError("of the caller")

    with pytest.raises(MemoryError, match="of the caller"):
        abfm.match(SPHERE, F, G, on_iteration=note)
