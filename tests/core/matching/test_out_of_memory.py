"""Memory that runs out in the middle of a match."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

import abfm
from abfm.matching.energy.energy import Evaluation
from tests.core.fields import bump
from tests.shapes import icosphere

SPHERE = icosphere(2)
F, G = (bump(SPHERE, SPHERE.vertices[vertex], 0.3) for vertex in (0, 30))


def full_after(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Let memory run out in the evaluation of the energy after so many."""
    usual = abfm.MatchingEnergy.evaluate
    made = []

    def evaluate(energy: abfm.MatchingEnergy, *arguments: Any, **named: Any) -> Evaluation:
        made.append(1)
        if len(made) > count:
            raise MemoryError("Unable to allocate 1 GiB")
        return usual(energy, *arguments, **named)

    monkeypatch.setattr(abfm.MatchingEnergy, "evaluate", evaluate)


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


def test_a_match_is_kept_where_there_is_no_memory_to_check_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def look(*_: Any) -> Any:
        raise MemoryError

    monkeypatch.setattr(sys.modules[abfm.match.__module__], "look", look)
    match = abfm.match(SPHERE, F, G)
    assert match.mismatch < 0.1
    assert np.isnan(match.verified_mismatch)
