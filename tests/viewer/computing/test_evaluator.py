"""Functions computed in a process of their own are those computed here, errors included."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from abfm import FunctionError, TriangleMesh, function
from abfm_viewer.computing.evaluator import Evaluator
from tests.shapes import icosphere

SPHERE = icosphere(2)
SPARSE = TriangleMesh(np.insert(SPHERE.vertices, 5, 9.0, axis=0), SPHERE.faces + (SPHERE.faces >= 5))


@pytest.fixture(scope="module")
def apart() -> Iterator[Evaluator]:
    evaluator = Evaluator(SPARSE, own_process=True)
    yield evaluator
    evaluator.close()


@pytest.mark.parametrize("spec", ["gaussian:vertex=7,width=0.2", "eigenfunction:3", "coordinate:x + geodesic:vertex=0"])
def test_values_are_the_same(apart: Evaluator, spec: str) -> None:
    np.testing.assert_array_equal(apart.values(spec), function(SPARSE, spec))


def test_defaults_are_the_same(apart: Evaluator) -> None:
    assert apart.defaults() == Evaluator(SPARSE, own_process=False).defaults()


@pytest.mark.parametrize("spec", ["gaussian:vertex=5", "nonsense", "file:not there.npy"])
def test_errors_are_the_same(apart: Evaluator, spec: str) -> None:
    with pytest.raises(FunctionError) as here:
        function(SPARSE, spec)
    with pytest.raises(FunctionError) as there:
        apart.values(spec)
    assert str(there.value) == str(here.value)


def test_a_process_that_was_ended_is_started_again() -> None:
    evaluator = Evaluator(SPARSE, own_process=True)
    evaluator.values("coordinate:x")
    assert evaluator._process is not None
    evaluator._process.close()
    with pytest.raises(FunctionError, match="try again"):
        evaluator.values("coordinate:x")
    np.testing.assert_array_equal(evaluator.values("coordinate:x"), SPARSE.vertices[:, 0])
    evaluator.close()


def test_a_closed_evaluator_starts_nothing() -> None:
    evaluator = Evaluator(SPARSE, own_process=True)
    evaluator.close()
    with pytest.raises(FunctionError, match="ended"):
        evaluator.values("coordinate:x")


def test_large_meshes_get_a_process() -> None:
    assert not Evaluator(SPHERE)._apart
    assert Evaluator(icosphere(6))._apart
