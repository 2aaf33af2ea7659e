"""Functions called in a process of its own that can be ended, messages to it, and threads."""

import gc
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np
import pytest

from abfm import FunctionError
from abfm.errors import AbfmWarning
from abfm.workers import process, threads
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.messages import pack
from abfm.workers.process import ChildProcess, ProcessEndedError
from abfm.workers.progress import reporting_steps
from abfm.workers.threads import DaemonThreads
from abfm.workers.worker import Worker, WorkerEndedError
from tests.core.workers import jobs
from tests.messages import raises
from tests.shapes import icosphere


def new_worker():
    worker = Worker(jobs.Notes, "it has ended")
    yield worker
    worker.close()


worker = pytest.fixture(new_worker)
shared = pytest.fixture(new_worker, scope="module")  # for all tests that do not end it


def until(condition):
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_warnings_come_to_the_caller(shared):
    """They are warnings of the thread that waits, each time."""
    for _ in range(2):
        with pytest.warns(AbfmWarning, match="no value") as caught:
            assert shared.call(jobs.warn, "no value").result() == "no value"
        assert len(caught) == 1


def test_calls_are_computed_in_their_order_on_one_state_in_another_process(worker):
    calls = [worker.call(jobs.Notes.add, line) for line in "abc"]
    assert [len(call.result()) for call in calls] == [1, 2, 3]
    assert worker.call(jobs.count_apart, 0).result() == worker.pid != os.getpid()


@pytest.mark.parametrize(
    ("given", "error", "named"),
    [
        (["input"], FunctionError, ""),
        (["memory"], MemoryError, ""),
        (["bug"], RuntimeError, "KeyError"),
        (["end"], RuntimeError, "SystemExit"),
        ([], RuntimeError, "TypeError"),
    ],
)
def test_errors_come_back_and_the_next_call_is_answered(shared, given, error, named):
    with raises(error, named):
        shared.call(jobs.fail, *given).result()
    assert shared.call(jobs.give_back, 3).result() == 3


def test_steps_are_told_to_who_waits_and_reports_come_in_their_order(shared):
    told, reports = [], []
    with reporting_steps(told.append):
        shared.call(jobs.count_apart, 50).result(reports.append)
    assert [step and step.task for step in told] == ["counting", None]
    assert reports == list(range(50))


def test_who_waits_for_its_turn_is_told_what_is_done_meanwhile(shared, tmp_path):
    first = shared.call(jobs.hold, tmp_path / "end")
    shared.call(jobs.give_back, 1)  # which nobody waits for
    told = []

    def tell(step):
        if step is not None:
            told.append(step.task)
            (tmp_path / "end").touch()

    with reporting_steps(tell):
        assert shared.call(jobs.give_back, 2).result() == 2
    assert told == ["holding"]
    first.result()


def test_a_call_beside_is_answered_though_another_one_is_computed(shared, tmp_path):
    first = shared.call(jobs.hold, tmp_path / "end")
    assert shared.call_now(jobs.give_back, 4).result() == 4
    (tmp_path / "end").touch()
    first.result()


def test_several_threads_may_wait_at_once(shared):
    with ThreadPoolExecutor(20) as pool:
        found = pool.map(lambda number: shared.call(jobs.give_back, number).result(), range(20))
        assert list(found) == list(range(20))


@pytest.mark.parametrize("paused", [False, True])
def test_the_control_of_who_waits_holds_and_ends_the_call(worker, paused):
    control, ended = Control(), []
    call = worker.call(jobs.go_on)

    def wait():
        with controlled(control), pytest.raises(CancelledError):
            call.result()
        ended.append(True)

    waiting = threading.Thread(target=wait)
    waiting.start()

    def count():
        return worker.call_now(jobs.lines).result()

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


def test_what_was_asked_of_a_control_before_is_heeded(shared):
    control = Control()
    control.cancel()
    with controlled(control), pytest.raises(CancelledError):
        shared.call(jobs.go_on).result()


def test_a_call_that_is_given_up_ends_and_its_answer_is_not_taken_for_the_next_one(shared):
    class GivenUpError(BaseException):
        pass

    def give_up(_):
        raise GivenUpError

    with pytest.raises(GivenUpError):
        shared.call(jobs.count_apart, 10).result(give_up)
    assert shared.call(jobs.give_back, "next").result() == "next"


def test_a_mesh_is_sent_once_and_comes_back_as_the_one_that_was_sent(worker):
    mesh, other = icosphere(2), icosphere(1)
    # the process keeps the last one only
    for sent, known in ((mesh, False), (mesh, True), (other, False), (mesh, False)):
        assert worker.call(jobs.mesh_and_size, sent).result() == (sent, known)


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
    with raises(WorkerEndedError):
        call.result()
    assert inner.returncode is not None  # it leaves no zombie
    with pytest.raises(WorkerEndedError):
        worker.call_now(jobs.give_back, 1).result()
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


def test_a_process_that_nothing_refers_to_ends(tmp_path):
    worker = Worker(jobs.Notes, "it has ended")
    worker.call(jobs.hold, tmp_path / "never")
    inner = worker._connection.process._process
    del worker
    gc.collect()
    until(lambda: inner.poll() is not None)


ECHO = """
from abfm.workers.process import Requests
requests = Requests()
for message in requests:
    print("what a library prints")
    requests.answer(message)
"""


@pytest.fixture
def echo(tmp_path, monkeypatch):
    (tmp_path / "echo_of_messages.py").write_text(ECHO)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, sys.path)]))
    process = ChildProcess("echo_of_messages")
    yield process
    process.close()


@pytest.mark.parametrize("count", [0, 1, 3_000_000])
def test_messages_longer_than_a_pipe_come_back_as_they_were(echo, count):
    sent = np.arange(count, dtype=np.float64)
    sending = threading.Thread(target=echo.send, args=(("numbers", sent),))
    sending.start()
    kind, received = echo.receive()
    sending.join()
    assert kind == "numbers"
    np.testing.assert_array_equal(received, sent)
    received += 1  # as its own


def test_a_process_that_is_closed_ends_who_waits_for_it(echo):
    echo.send("first")
    assert echo.receive() == "first"
    closing = threading.Timer(0.2, echo.close)
    closing.start()
    with pytest.raises(ProcessEndedError):
        echo.receive()
    closing.join()
    assert echo.has_ended
    with pytest.raises(ProcessEndedError):
        echo.send("anything")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("closed", [True, False])
def test_nothing_of_it_stays_open(closed, monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    process = ChildProcess("abfm.workers")
    if closed:
        process.close()
    del process
    gc.collect()
    assert not told


@pytest.mark.parametrize("at_once", [1, 3, 10_000])
def test_a_message_may_come_in_pieces_and_is_refused_when_its_end_is_missing(at_once):
    content = pickle.dumps(list(range(100)))
    whole = len(content).to_bytes(8) + content

    def received(given):
        rest = bytearray(given)

        def read(buffer):
            count = min(len(buffer), len(rest), at_once)
            buffer[:count] = rest[:count]
            del rest[:count]
            return count

        return process._receive(read)

    assert received(whole) == list(range(100))
    with pytest.raises(EOFError):
        received(whole[:-1])


def names():
    return [thread.name for thread in threading.enumerate()]


def test_none_waits_for_another_one_and_threads_are_used_again():
    pool, may_end = DaemonThreads("used again"), threading.Event()
    held = [pool.submit(may_end.wait, 30) for _ in range(5)]
    assert pool.submit(max, 3, 4).result(30) == 4
    may_end.set()
    assert not wait(held, 30).not_done
    until(lambda: pool._idle == names().count("used again"))
    count = pool._idle
    for number in range(50):
        assert pool.submit(abs, -number).result(30) == number
        until(lambda: pool._idle == count)
    assert names().count("used again") == count <= 6


@pytest.mark.parametrize("error", [ValueError, SystemExit])
def test_what_a_job_raises_is_told_and_ends_no_thread(error):
    pool = DaemonThreads("failing")

    def fail():
        raise error("no")

    with pytest.raises(error):
        pool.submit(fail).result(30)
    assert pool.submit(int).result(30) == 0


@pytest.mark.parametrize("idle", [0.0, 0.01])
def test_threads_end_without_work_and_every_job_is_done_while_they_come_and_go(idle, monkeypatch):
    monkeypatch.setattr(threads, "_IDLE_SECONDS", idle)
    pool = DaemonThreads("coming and going")
    for number in range(300):
        assert pool.submit(abs, number).result(30) == number
    until(lambda: "coming and going" not in names())


def test_a_program_ends_though_a_job_goes_on():
    code = (
        "from abfm.workers.threads import DaemonThreads; import time; "
        "DaemonThreads('late').submit(time.sleep, 1000)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)
