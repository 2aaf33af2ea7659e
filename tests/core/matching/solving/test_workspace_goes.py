"""A match's workspace goes with it, at once: not when Python's collector of cycles happens to
look.
"""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import abfm
from abfm import Control, Iteration, Parameters
from abfm.errors import AbfmError
from abfm.flow.exponential import Workspace
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.objective.regularizer import Regularizer
from abfm.matching.solving.descent import Descent
from abfm.matching.solving.record import Record
from tests.core.fields import bump
from tests.shapes import icosphere

SPHERE = icosphere(3)
F, G = (bump(SPHERE, SPHERE.vertices[vertex], 0.4) for vertex in (0, 30))
WAYS = {
    "one level": Parameters(levels=1, iterations=8),
    "coarse to fine": Parameters(levels=2, iterations=12),
    "with a reach": Parameters(levels=2, iterations=12, reach=0.3),
    "with the bracket": Parameters(gradient="bracket", levels=1, iterations=4),
    "without a preconditioner": Parameters(preconditioner="none", levels=1, iterations=4),
}
KINDS = (MatchingEnergy, Workspace, Descent, Record, Regularizer)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[weakref.WeakSet[Any]]:
    """All workspaces that are made and not gone, while nothing collects cycles."""
    alive: weakref.WeakSet[Any] = weakref.WeakSet()

    def noting(usual: Callable[..., None]) -> Callable[..., None]:
        def init(self: Any, *arguments: Any, **named: Any) -> None:
            usual(self, *arguments, **named)
            alive.add(self)

        return init

    for kind in KINDS:
        monkeypatch.setattr(kind, "__init__", noting(kind.__init__))
    gc.collect()
    gc.disable()
    yield alive
    gc.enable()


def left(alive: weakref.WeakSet[Any]) -> list[str]:
    """What is still there besides what its mesh keeps: the norm of fields with the alpha that
    was asked for last.
    """
    kept = [mesh.cache.get("regularizer") for mesh in _meshes(SPHERE)]
    return [type(one).__name__ for one in alive if all(one is not each for each in kept)]


def _meshes(mesh: abfm.TriangleMesh) -> list[abfm.TriangleMesh]:
    inner = [each for each in mesh.cache.values() if isinstance(each, abfm.TriangleMesh)]
    return [mesh, *(found for each in inner for found in _meshes(each))]


@pytest.mark.parametrize("way", WAYS)
def test_after_a_match(made: weakref.WeakSet[Any], way: str) -> None:
    looks = []
    match = abfm.match(
        SPHERE, F, G, WAYS[way], on_iteration=lambda now: looks.append(now.advected.shape)
    )
    assert len(looks) == len(match.energy_history) > 1
    assert left(made) == []


@pytest.mark.parametrize("way", WAYS)
def test_after_one_that_was_cancelled(made: weakref.WeakSet[Any], way: str) -> None:
    control = Control()
    match = abfm.match(
        SPHERE, F, G, WAYS[way], on_iteration=lambda _: control.cancel(), control=control
    )
    assert match.stop_reason == "cancelled"
    assert left(made) == []


@pytest.mark.parametrize("error", [AbfmError, MemoryError, RuntimeError])
def test_after_one_that_failed(made: weakref.WeakSet[Any], error: type[Exception]) -> None:
    def fail(now: Iteration) -> None:
        if now.iteration == 3:
            raise error("no")

    for way in ("one level", "coarse to fine"):
        try:
            match = abfm.match(SPHERE, F, G, WAYS[way], on_iteration=fail)
        except error:
            pass
        else:
            assert match.stop_reason == "out of memory"
            del match
        assert left(made) == []


def test_with_the_last_iterate_that_somebody_kept(made: weakref.WeakSet[Any]) -> None:
    """Each holds what its look is made with, also after the match has ended."""
    kept: list[Iteration] = []
    abfm.match(SPHERE, F, G, WAYS["coarse to fine"], on_iteration=kept.append)
    assert {"MatchingEnergy", "Workspace"} <= set(left(made))
    assert "Descent" not in left(made)
    assert kept[0].velocity.shape == (1, len(SPHERE.faces), 3)
    kept.clear()
    assert left(made) == []
