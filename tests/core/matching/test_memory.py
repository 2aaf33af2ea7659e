"""Memory that runs out in the middle of a match, and workspaces that go with it."""

import gc
import sys
import weakref

import numpy as np
import pytest

import abfm
from abfm import Parameters
from abfm.errors import AbfmError
from abfm.flow.exponential import Workspace
from abfm.matching.objective.matching_energy import MatchingEnergy, Objective
from abfm.matching.objective.regularizer import Regularizer
from abfm.matching.solving.continuation import State, solve
from abfm.matching.solving.descent import Descent
from abfm.matching.solving.record import Record
from abfm.workers import Control
from tests.core.fields import bump
from tests.messages import check_message
from tests.shapes import icosphere

SPHERE = icosphere(2)
F, G = (bump(SPHERE, SPHERE.vertices[vertex], 0.3) for vertex in (0, 30))


def full_after(monkeypatch, count):
    """Let memory run out in the evaluation of the energy after so many."""
    usual, made = Objective.evaluate, []

    def evaluate(objective, fields):
        made.append(1)
        if len(made) > count:
            raise MemoryError("Unable to allocate 1 GiB")
        return usual(objective, fields)

    monkeypatch.setattr(Objective, "evaluate", evaluate)


def test_the_best_field_so_far_is_kept(monkeypatch, tmp_path):
    whole = abfm.match(SPHERE, F, G)
    full_after(monkeypatch, 6)
    match = abfm.match(SPHERE, F, G)
    assert match.stop_reason == "out of memory"
    check_message(match.verdict.reason)
    assert 2 < len(match.energy_history) < len(whole.energy_history)
    assert match.residual < match.initial_residual
    assert np.isfinite(match.verified_residual)
    match.save(tmp_path / "m.npz")
    assert abfm.load(tmp_path / "m.npz").stop_reason == "out of memory"


def test_a_match_is_kept_where_there_is_no_memory_to_check_it(monkeypatch):
    def measured(*_):
        raise MemoryError

    for module in (abfm.match.__module__, solve.__module__):
        monkeypatch.setattr(sys.modules[module], "flow_line_measures", measured)
    match = abfm.match(SPHERE, F, G)
    assert match.residual < 0.1
    assert np.isnan(match.verified_residual)


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("count", [20, 60, 100])
def test_what_an_earlier_way_found_outlives_one_that_runs_out_of_memory(monkeypatch, count, levels):
    """Each variant begins with a zero field, which matches nothing."""
    mesh, p = icosphere(3), Parameters.of(levels=levels, refine=0)
    f, g = (bump(mesh, mesh.vertices[vertex], 0.1) for vertex in (0, 30))
    seen = []
    full_after(monkeypatch, count)
    match = abfm.match(mesh, f, g, p, on_iteration=seen.append)
    assert match.stop_reason == "out of memory"
    # on the mesh itself as well as on the coarser one, up to what this does not resolve
    found = min(seen[-1].residual, *(step.residual for step in seen[-1].path), 2.0)
    assert match.residual <= 1.01 * found + 0.3 * (levels - 1)


def test_it_is_an_error_where_memory_runs_out_for_the_caller_or_without_a_field(monkeypatch):
    def note(now):
        if now.iteration == 3:
            raise MemoryError("of the caller")

    with pytest.raises(MemoryError, match="of the caller"):
        abfm.match(SPHERE, F, G, on_iteration=note)
    full_after(monkeypatch, 0)
    with pytest.raises(MemoryError, match="Unable to allocate"):
        abfm.match(SPHERE, F, G)


BALL = icosphere(3)
PROBLEM = BALL, *(bump(BALL, BALL.vertices[vertex], 0.4) for vertex in (0, 30))
WAYS = {
    "one level": Parameters.of(levels=1, iterations=8),
    "coarse to fine": Parameters.of(levels=2, iterations=12),
    "with a reach": Parameters.of(levels=2, iterations=12, reach=0.3),
    "with the bracket": Parameters.of(gradient="bracket", levels=1, iterations=4),
    "without a preconditioner": Parameters.of(preconditioner="none", levels=1, iterations=4),
}


@pytest.fixture
def made(monkeypatch):
    """All workspaces that are made and not gone, while nothing collects cycles."""
    alive = weakref.WeakSet()

    def noting(usual):
        def init(self, *arguments, **named):
            usual(self, *arguments, **named)
            alive.add(self)

        return init

    for kind in (MatchingEnergy, Workspace, State, Descent, Record, Regularizer):
        monkeypatch.setattr(kind, "__init__", noting(kind.__init__))
    gc.collect()
    gc.disable()
    yield alive
    gc.enable()


def left(alive):
    """What is still there besides what its mesh keeps."""
    kept = [mesh.cache.get("regularizer") for mesh in _meshes(BALL)]
    return [type(one).__name__ for one in alive if all(one is not each for each in kept)]


def _meshes(mesh):
    inner = [each for each in mesh.cache.values() if isinstance(each, abfm.TriangleMesh)]
    return [mesh, *(found for each in inner for found in _meshes(each))]


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS.keys())
@pytest.mark.parametrize("cancelled", [False, True])
def test_after_a_match_also_one_that_was_cancelled(made, way, cancelled):
    control, looks = Control(), []

    def look(now):
        looks.append(now.advected.shape)
        if cancelled:
            control.cancel()

    match = abfm.match(*PROBLEM, way, on_iteration=look, control=control)
    assert len(looks) == len(match.energy_history)
    assert (match.stop_reason == "cancelled") == cancelled == (len(looks) == 1)
    assert left(made) == []


@pytest.mark.parametrize("error", [AbfmError, MemoryError, RuntimeError])
def test_after_one_that_failed(made, error):
    def fail(now):
        if now.iteration == 3:
            raise error("no")

    for way in ("one level", "coarse to fine"):
        try:
            match = abfm.match(*PROBLEM, WAYS[way], on_iteration=fail)
        except error:
            pass
        else:
            assert match.stop_reason == "out of memory"
            del match
        assert left(made) == []


def test_with_the_last_iterate_that_somebody_kept(made):
    """Each holds what its view is made with, also after the match has ended."""
    kept = []
    abfm.match(*PROBLEM, WAYS["coarse to fine"], on_iteration=kept.append)
    assert {"MatchingEnergy", "Workspace"} <= set(left(made))
    assert {"State", "Descent"}.isdisjoint(left(made))
    assert kept[0].velocity.shape == (1, len(BALL.faces), 3)
    kept.clear()
    assert left(made) == []
