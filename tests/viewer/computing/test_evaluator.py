"""Functions computed in a process of their own are those computed here, errors included."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from abfm import FunctionError, function
from abfm.numerics.own_process import OwnProcess
from abfm.progress import Step, telling
from abfm_viewer.computing import evaluator as evaluator_module
from abfm_viewer.computing.evaluator import Evaluator
from tests.shapes import icosphere, with_loose_vertex

SPHERE = icosphere(2)
SPARSE = with_loose_vertex(SPHERE)


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


def test_an_answer_that_was_not_waited_for_is_not_taken_for_the_next_one() -> None:
    evaluator = Evaluator(SPARSE, own_process=True)

    class GivenUpError(BaseException):
        pass

    def give_up(step: Step | None) -> None:
        if step is not None:
            raise GivenUpError

    with pytest.raises(GivenUpError), telling(give_up):
        evaluator.values("geodesic:vertex=0")  # it tells that it factors
    np.testing.assert_array_equal(evaluator.values("coordinate:x"), SPARSE.vertices[:, 0])
    evaluator.close()


@pytest.mark.parametrize("signal_number", [signal.SIGKILL, signal.SIGTERM])
def test_who_waits_is_told_when_the_process_is_killed(signal_number: int) -> None:
    evaluator = Evaluator(SPARSE, own_process=True)
    evaluator.values("coordinate:x")
    assert evaluator._process is not None
    inner = evaluator._process._process
    inner.send_signal(signal.SIGSTOP)  # in the middle of an answer
    told: list[str] = []

    def ask() -> None:
        try:
            evaluator.values("geodesic:vertex=0")
        except FunctionError as error:
            told.append(str(error))

    waiting = threading.Thread(target=ask)
    waiting.start()
    inner.send_signal(signal_number)
    inner.send_signal(signal.SIGCONT)
    waiting.join(30)
    assert told == ["the process that computes functions has ended; try again"]


def test_closing_while_the_process_starts_ends_it_and_tells_who_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluator, told = Evaluator(SPARSE, own_process=True), []
    send, begun = evaluator_module.OwnProcess.send, threading.Event()

    def send_slowly(process: OwnProcess, message: object) -> None:
        begun.set()
        closed.wait(30)
        send(process, message)

    closed = threading.Event()
    monkeypatch.setattr(evaluator_module.OwnProcess, "send", send_slowly)

    def ask() -> None:
        try:
            evaluator.values("coordinate:x")
        except FunctionError as error:
            told.append(str(error))

    waiting = threading.Thread(target=ask)
    waiting.start()
    assert begun.wait(30)
    evaluator.close()
    closed.set()
    waiting.join(30)
    assert told == ["the process that computes functions has ended; try again"]
