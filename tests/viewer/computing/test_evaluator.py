"""Functions computed in a process of their own are those computed here, errors included."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from abfm import AbfmError, FunctionError, function
from abfm_viewer.computing.evaluator import OWN_PROCESS_FROM, Evaluator
from tests.shapes import icosphere, with_loose_vertex

SPARSE = with_loose_vertex(icosphere(2))


@pytest.fixture(scope="module")
def apart() -> Iterator[Evaluator]:
    evaluator = Evaluator(SPARSE, own_process=True)
    yield evaluator
    evaluator.close()


@pytest.mark.parametrize(
    "spec", ["gaussian:vertex=7,width=0.2", "eigenfunction:3", "coordinate:x + geodesic:vertex=0"]
)
def test_values_are_the_same(apart: Evaluator, spec: str) -> None:
    assert apart.pid is None or apart.pid > 0
    np.testing.assert_array_equal(apart.values(spec), function(SPARSE, spec))
    assert apart.pid


def test_defaults_are_the_same(apart: Evaluator) -> None:
    assert apart.defaults() == Evaluator(SPARSE, own_process=False).defaults()


@pytest.mark.parametrize("spec", ["gaussian:vertex=5", "nonsense", "file:not there.npy"])
def test_errors_are_the_same(apart: Evaluator, spec: str) -> None:
    with pytest.raises(FunctionError) as here:
        function(SPARSE, spec)
    with pytest.raises(FunctionError) as there:
        apart.values(spec)
    assert str(there.value) == str(here.value)


def test_a_closed_evaluator_starts_nothing() -> None:
    evaluator = Evaluator(SPARSE, own_process=True)
    evaluator.close()
    with pytest.raises(AbfmError, match="the process that computes functions has ended; try again"):
        evaluator.values("coordinate:x")
    assert evaluator.pid is None


def test_large_meshes_get_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("abfm_viewer.computing.evaluator.OWN_PROCESS_FROM", len(SPARSE.vertices))
    for mesh, has_one in ((icosphere(1), False), (SPARSE, True)):
        evaluator = Evaluator(mesh)
        evaluator.values("coordinate:x")
        assert (evaluator.pid is not None) == has_one
        evaluator.close()
    assert OWN_PROCESS_FROM == 20_000
