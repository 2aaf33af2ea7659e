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


def exhaust_memory_after(monkeypatch, count):
    """Let evaluations of the energy raise MemoryError after this number of them."""
    usual, calls = Objective.evaluate, []

    def evaluate(objective, fields):
        calls.append(1)
        if len(calls) > count:
            raise MemoryError("Unable to allocate 1 GiB")
        return usual(objective, fields)

    monkeypatch.setattr(Objective, "evaluate", evaluate)


def test_result_is_best_field_so_far(monkeypatch, tmp_path):
    complete = abfm.match(SPHERE, F, G)
    exhaust_memory_after(monkeypatch, 6)
    match = abfm.match(SPHERE, F, G)
    assert match.stop_reason == "out of memory"
    check_message(match.verdict.reason)
    assert 2 < len(match.energy_history) < len(complete.energy_history)
    assert match.residual < match.initial_residual
    assert np.isfinite(match.verified_residual)
    match.save(tmp_path / "m.npz")
    assert abfm.load(tmp_path / "m.npz").stop_reason == "out of memory"


def test_match_survives_failed_verification(monkeypatch):
    def fail(*_):
        raise MemoryError

    for module in (abfm.match.__module__, solve.__module__):
        monkeypatch.setattr(sys.modules[module], "flow_line_measures", fail)
    match = abfm.match(SPHERE, F, G)
    assert match.residual < 0.1
    assert np.isnan(match.verified_residual)


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("count", [20, 60, 100])
def test_earlier_variant_survives_out_of_memory(monkeypatch, count, levels):
    """If memory runs out in a later variant, which begins at zero, the best step is returned."""
    mesh, p = icosphere(3), Parameters.of(levels=levels, refine=0)
    f, g = (bump(mesh, mesh.vertices[vertex], 0.1) for vertex in (0, 30))
    seen = []
    exhaust_memory_after(monkeypatch, count)
    match = abfm.match(mesh, f, g, p, on_iteration=seen.append)
    assert match.stop_reason == "out of memory"
    # up to the discretisation error of the coarser mesh
    found = min(seen[-1].residual, *(step.residual for step in seen[-1].path), 2.0)
    assert match.residual <= 1.01 * found + 0.3 * (levels - 1)


def test_memory_error_without_a_field_is_raised(monkeypatch):
    def note(now):
        if now.iteration == 3:
            raise MemoryError("of the caller")

    with pytest.raises(MemoryError, match="of the caller"):
        abfm.match(SPHERE, F, G, on_iteration=note)
    exhaust_memory_after(monkeypatch, 0)
    with pytest.raises(MemoryError, match="Unable to allocate"):
        abfm.match(SPHERE, F, G)


BALL = icosphere(3)
PROBLEM = BALL, *(bump(BALL, BALL.vertices[vertex], 0.4) for vertex in (0, 30))
VARIANTS = {
    "one level": Parameters.of(levels=1, iterations=8),
    "coarse to fine": Parameters.of(levels=2, iterations=12),
    "with a reach": Parameters.of(levels=2, iterations=12, reach=0.3),
    "with the bracket": Parameters.of(gradient="bracket", levels=1, iterations=4),
    "without a preconditioner": Parameters.of(preconditioner="none", levels=1, iterations=4),
}


@pytest.fixture
def alive(monkeypatch):
    alive = weakref.WeakSet()

    def recording(usual):
        def init(self, *arguments, **named):
            usual(self, *arguments, **named)
            alive.add(self)

        return init

    for kind in (MatchingEnergy, Workspace, State, Descent, Record, Regularizer):
        monkeypatch.setattr(kind, "__init__", recording(kind.__init__))
    gc.collect()
    gc.disable()
    yield alive
    gc.enable()


def remaining(alive):
    """Return the types of workspaces that exist outside the caches of the meshes."""
    cached = [mesh.cache.get("regularizer") for mesh in _meshes(BALL)]
    return [type(one).__name__ for one in alive if all(one is not each for each in cached)]


def _meshes(mesh):
    inner = [each for each in mesh.cache.values() if isinstance(each, abfm.TriangleMesh)]
    return [mesh, *(found for each in inner for found in _meshes(each))]


@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS.keys())
@pytest.mark.parametrize("cancelled", [False, True])
def test_match_releases_its_workspaces(alive, variant, cancelled):
    control, shapes = Control(), []

    def record(now):
        shapes.append(now.advected.shape)
        if cancelled:
            control.cancel()

    match = abfm.match(*PROBLEM, variant, on_iteration=record, control=control)
    assert len(shapes) == len(match.energy_history)
    assert (match.stop_reason == "cancelled") == cancelled == (len(shapes) == 1)
    assert remaining(alive) == []


@pytest.mark.parametrize("error", [AbfmError, MemoryError, RuntimeError])
def test_failed_match_releases_its_workspaces(alive, error):
    def fail(now):
        if now.iteration == 3:
            raise error("failed")

    for variant in ("one level", "coarse to fine"):
        try:
            match = abfm.match(*PROBLEM, VARIANTS[variant], on_iteration=fail)
        except error:
            pass
        else:
            assert match.stop_reason == "out of memory"
            del match
        assert remaining(alive) == []


def test_stored_iterates_keep_their_workspaces(alive):
    """An iterate holds the objects that make its view, also after the match has ended."""
    iterates = []
    abfm.match(*PROBLEM, VARIANTS["coarse to fine"], on_iteration=iterates.append)
    assert {"MatchingEnergy", "Workspace"} <= set(remaining(alive))
    assert {"State", "Descent"}.isdisjoint(remaining(alive))
    assert iterates[0].velocity.shape == (1, len(BALL.faces), 3)
    iterates.clear()
    assert remaining(alive) == []
