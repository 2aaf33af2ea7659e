"""Functions called in a process of its own: as here, but that they can be ended."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from abfm import FunctionError
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.messages import pack
from abfm.workers.progress import Step, telling
from abfm.workers.worker import Worker, WorkerEndedError
from tests.core.workers import jobs
from tests.shapes import icosphere


@pytest.fixture(scope="module")
def shared() -> Iterator[Worker[jobs.Notes]]:
    """One for all tests that do not end it."""
    worker = Worker(jobs.Notes, "it has ended")
    yield worker
    worker.close()


@pytest.fixture
def worker() -> Iterator[Worker[jobs.Notes]]:
    worker = Worker(jobs.Notes, "it has ended")
    yield worker
    worker.close()


def until(condition) -> None:
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_calls_are_computed_in_their_order_on_one_state_in_another_process(worker):
    calls = [worker.call(jobs.Notes.add, line) for line in "abc"]
    assert [len(call.result()) for call in calls] == [1, 2, 3]
    assert worker.call(jobs.count_apart, 0).result() == worker.pid != os.getpid()


@pytest.mark.parametrize(
    ("kind", "error", "words"),
    [
        ("input", FunctionError, "two lines"),
        ("memory", MemoryError, "two\nlines"),
        ("bug", RuntimeError, "KeyError: 'two"),
        ("end", RuntimeError, "SystemExit: two"),
    ],
)
def test_errors_come_back_and_the_next_call_is_answered(shared, kind, error, words):
    with pytest.raises(error, match=words):
        shared.call(jobs.fail, kind).result()
    assert shared.call(jobs.give_back, 3).result() == 3


def test_what_cannot_be_called_there_is_an_error(shared):
    with pytest.raises(RuntimeError, match="TypeError"):
        shared.call(jobs.give_back).result()


def test_steps_are_told_to_who_waits_and_reports_come_in_their_order(shared):
    told: list[Step | None] = []
    reports: list[int] = []
    with telling(told.append):
        shared.call(jobs.count_apart, 50).result(reports.append)
    assert [step and step.task for step in told] == ["counting", None]
    assert reports == list(range(50))


def test_who_waits_for_its_turn_is_told_what_is_done_meanwhile(shared, tmp_path):
    first = shared.call(jobs.hold, tmp_path / "end")
    shared.call(jobs.give_back, 1)  # which nobody waits for
    told: list[str] = []

    def tell(step: Step | None) -> None:
        if step is not None:
            told.append(step.task)
            (tmp_path / "end").touch()

    with telling(tell):
        assert shared.call(jobs.give_back, 2).result() == 2
    assert told == ["holding"]
    first.result()


def test_a_call_beside_is_answered_though_another_one_is_computed(shared, tmp_path):
    first = shared.call(jobs.hold, tmp_path / "end")
    assert first.beside(jobs.give_back, 4).result() == 4
    (tmp_path / "end").touch()
    first.result()


def test_several_threads_may_wait_at_once(shared):
    found: dict[int, int] = {}

    def ask(number: int) -> None:
        found[number] = shared.call(jobs.give_back, number).result()

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert found == {number: number for number in range(20)}


@pytest.mark.parametrize("paused", [False, True])
def test_the_control_of_who_waits_holds_and_ends_the_call(worker, tmp_path, paused):
    control, ended = Control(), []
    call = worker.call(jobs.go_on, tmp_path / "begun")

    def wait() -> None:
        with controlled(control), pytest.raises(CancelledError):
            call.result()
        ended.append(True)

    waiting = threading.Thread(target=wait)
    waiting.start()

    def count() -> int:
        return call.beside(jobs.lines).result()

    until(lambda: count() > 3)
    if paused:
        control.pause()
        until(lambda: count() == (time.sleep(0.1), count())[1])
        standing = count()
        time.sleep(0.1)
        assert count() == standing
        control.resume()
        until(lambda: count() > standing)
        control.pause()
    control.cancel()
    waiting.join(30)
    assert ended


def test_what_was_asked_of_a_control_before_is_heeded(shared, tmp_path):
    control = Control()
    control.cancel()
    with controlled(control), pytest.raises(CancelledError):
        shared.call(jobs.go_on, tmp_path / "begun").result()


def test_a_call_that_is_given_up_ends_and_its_answer_is_not_taken_for_the_next_one(shared):
    class GivenUpError(BaseException):
        pass

    def give_up(_: object) -> None:
        raise GivenUpError

    with pytest.raises(GivenUpError):
        shared.call(jobs.count_apart, 10).result(give_up)
    assert shared.call(jobs.give_back, "next").result() == "next"


def test_a_mesh_is_sent_once_and_comes_back_as_the_one_that_was_sent(worker):
    mesh, other = icosphere(2), icosphere(1)
    assert worker.call(jobs.mesh_and_size, mesh).result() == (mesh, False)
    assert worker.call(jobs.mesh_and_size, mesh).result() == (mesh, True)
    assert worker.call(jobs.mesh_and_size, other).result() == (other, False)
    # the process keeps the last one only
    assert worker.call(jobs.mesh_and_size, mesh).result() == (mesh, False)


def test_the_digest_of_a_mesh_is_that_of_its_content():
    mesh = icosphere(2)
    again = pickle.loads(pickle.dumps(mesh))
    assert again is not mesh
    assert again.digest == mesh.digest == icosphere(2).digest
    assert mesh.normalized().digest not in (mesh.digest, icosphere(1).digest)
    parcel, named = pack([mesh, again, 1], [mesh.digest])
    assert len(parcel.content) < 1000
    assert (list(named), parcel.values) == ([mesh.digest], {})


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_who_waits_is_told_that_the_process_was_killed_and_the_next_call_has_another(
    worker, tmp_path, number
):
    call = worker.call(jobs.hold, tmp_path / "never")
    inner = worker._connection.process._process
    threading.Timer(0.1, lambda: os.kill(inner.pid, number)).start()
    with pytest.raises(WorkerEndedError, match="it has ended"):
        call.result()
    assert inner.returncode is not None  # it leaves no zombie
    with pytest.raises(WorkerEndedError):
        call.beside(jobs.give_back, 1).result()
    assert worker.call(jobs.give_back, 1).result() == 1
    os.kill(worker.pid, number)
    until(lambda: worker._connection.process.has_ended)
    assert worker.call(jobs.give_back, np.ones(3)).result().sum() == 3


def test_closing_ends_the_process_while_it_starts_and_starts_no_other(worker):
    call = worker.call(jobs.give_back, np.zeros(10**6))
    worker.close()
    with pytest.raises(WorkerEndedError):
        call.result()
    with pytest.raises(WorkerEndedError):
        worker.call(jobs.give_back, 1)


def test_a_process_that_nothing_refers_to_ends(tmp_path: Path):
    worker = Worker(jobs.Notes, "it has ended")
    worker.call(jobs.hold, tmp_path / "never")
    inner = worker._connection.process._process
    del worker
    gc.collect()
    until(lambda: inner.poll() is not None)
