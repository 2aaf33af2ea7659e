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

from abfm import FunctionError, TriangleMesh
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
    worker = Worker(jobs.Lines, "it has ended")
    yield worker
    worker.close()


worker = pytest.fixture(new_worker)
shared = pytest.fixture(new_worker, scope="module")  # for tests that do not end the process


def until(condition):
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_warnings_reach_the_waiting_thread(shared):
    for _ in range(2):
        with pytest.warns(AbfmWarning, match="no value") as caught:
            assert shared.call(jobs.warn, "no value").result() == "no value"
        assert len(caught) == 1


def test_calls_run_in_order_on_one_state(worker):
    calls = [worker.call(jobs.Lines.add, line) for line in "abc"]
    assert [len(call.result()) for call in calls] == [1, 2, 3]
    assert worker.call(jobs.count_in_subprocess, 0).result() == worker.pid != os.getpid()


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
def test_errors_are_raised_and_the_next_call_works(shared, given, error, named):
    with raises(error, named):
        shared.call(jobs.fail, *given).result()
    assert shared.call(jobs.identity, 3).result() == 3


def test_steps_and_reports_reach_the_waiting_thread(shared):
    steps, reports = [], []
    with reporting_steps(steps.append):
        shared.call(jobs.count_in_subprocess, 50).result(reports.append)
    assert [step and step.task for step in steps] == ["counting", None]
    assert reports == list(range(50))


def test_queued_call_reports_the_step_of_the_running_call(shared, tmp_path):
    first = shared.call(jobs.wait_for_file, tmp_path / "end")
    shared.call(jobs.identity, 1)  # a call that is still running
    tasks = []

    def end(step):
        if step is not None:
            tasks.append(step.task)
            (tmp_path / "end").touch()

    with reporting_steps(end):
        assert shared.call(jobs.identity, 2).result() == 2
    assert tasks == ["waiting"]
    first.result()


def test_immediate_call_runs_during_another_call(shared, tmp_path):
    first = shared.call(jobs.wait_for_file, tmp_path / "end")
    assert shared.call_now(jobs.identity, 4).result() == 4
    (tmp_path / "end").touch()
    first.result()


def test_several_threads_wait_at_once(shared):
    with ThreadPoolExecutor(20) as pool:
        found = pool.map(lambda number: shared.call(jobs.identity, number).result(), range(20))
        assert list(found) == list(range(20))


@pytest.mark.parametrize("paused", [False, True])
def test_control_of_the_waiting_thread_pauses_and_cancels(worker, paused):
    control, ended = Control(), []
    call = worker.call(jobs.pass_checkpoints)

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


def test_earlier_cancellation_applies_to_the_call(shared):
    control = Control()
    control.cancel()
    with controlled(control), pytest.raises(CancelledError):
        shared.call(jobs.pass_checkpoints).result()


def test_abandoned_call_ends_and_its_answer_is_dropped(shared):
    class AbandonedError(BaseException):
        pass

    def abandon(_):
        raise AbandonedError

    with pytest.raises(AbandonedError):
        shared.call(jobs.count_in_subprocess, 10).result(abandon)
    assert shared.call(jobs.identity, "next").result() == "next"


def test_mesh_is_sent_once_and_returned_by_name(worker):
    mesh, other = icosphere(2), icosphere(1)
    # the process keeps only the latest mesh
    for sent, known in ((mesh, False), (mesh, True), (other, False), (mesh, False)):
        assert worker.call(jobs.same_mesh, sent).result() == (sent, known)


def test_equal_geometries_keep_their_structures():
    sides = ["CortexLeft", "CortexRight"]
    sphere = icosphere(1)
    meshes = [TriangleMesh(sphere.vertices, sphere.faces, structure=side) for side in sides]
    parcel, _ = pack(meshes)
    received, _ = parcel.unpack({})
    assert [mesh.structure for mesh in received] == sides


def test_digest_of_a_mesh_depends_on_its_content():
    mesh = icosphere(2)
    again = pickle.loads(pickle.dumps(mesh))
    assert again is not mesh
    assert again.digest == mesh.digest == icosphere(2).digest
    assert mesh.normalized().digest not in (mesh.digest, icosphere(1).digest)
    parcel, named = pack([mesh, again, 1], [mesh.message_name])
    assert len(parcel.content) < 1000
    assert (list(named), parcel.values) == ([mesh.message_name], {})


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_killed_process_fails_its_call_and_is_replaced(worker, tmp_path, number):
    call = worker.call(jobs.wait_for_file, tmp_path / "never")
    inner = worker._connection.process._process
    threading.Timer(0.1, lambda: os.kill(inner.pid, number)).start()
    with raises(WorkerEndedError):
        call.result()
    assert inner.returncode is not None
    with pytest.raises(WorkerEndedError):
        worker.call_now(jobs.identity, 1).result()
    assert worker.call(jobs.identity, 1).result() == 1
    os.kill(worker.pid, number)
    until(lambda: worker._connection.process.has_ended)
    assert worker.call(jobs.identity, np.ones(3)).result().sum() == 3


def test_close_ends_a_starting_process(worker):
    call = worker.call(jobs.identity, np.zeros(10**6))
    worker.close()
    with pytest.raises(WorkerEndedError):
        call.result()
    with pytest.raises(WorkerEndedError):
        worker.call(jobs.identity, 1)


def test_garbage_collected_worker_ends_its_process(tmp_path):
    worker = Worker(jobs.Lines, "it has ended")
    worker.call(jobs.wait_for_file, tmp_path / "never")
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
def test_messages_longer_than_a_pipe_are_transmitted(echo, count):
    sent = np.arange(count, dtype=np.float64)
    sending = threading.Thread(target=echo.send, args=(("numbers", sent),))
    sending.start()
    kind, received = echo.receive()
    sending.join()
    assert kind == "numbers"
    np.testing.assert_array_equal(received, sent)
    received += 1  # the received array is writable


def test_close_ends_a_waiting_receive(echo):
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
def test_closed_process_leaves_no_open_files(closed, monkeypatch):
    errors = []
    monkeypatch.setattr(sys, "unraisablehook", errors.append)
    process = ChildProcess("abfm.workers")
    if closed:
        process.close()
    del process
    gc.collect()
    assert not errors


@pytest.mark.parametrize("at_once", [1, 3, 10_000])
def test_message_is_assembled_from_pieces(at_once):
    content = pickle.dumps(list(range(100)))
    complete = len(content).to_bytes(8) + content

    def received(given):
        rest = bytearray(given)

        def read(buffer):
            count = min(len(buffer), len(rest), at_once)
            buffer[:count] = rest[:count]
            del rest[:count]
            return count

        return process._receive(read)

    assert received(complete) == list(range(100))
    with pytest.raises(EOFError):
        received(complete[:-1])


def names():
    return [thread.name for thread in threading.enumerate()]


def test_jobs_do_not_wait_and_threads_are_reused():
    pool, may_end = DaemonThreads("used again"), threading.Event()
    waiting = [pool.submit(may_end.wait, 30) for _ in range(5)]
    assert pool.submit(max, 3, 4).result(30) == 4
    may_end.set()
    assert not wait(waiting, 30).not_done
    until(lambda: pool._idle == names().count("used again"))
    count = pool._idle
    for number in range(50):
        assert pool.submit(abs, -number).result(30) == number
        until(lambda: pool._idle == count)
    assert names().count("used again") == count <= 6


@pytest.mark.parametrize("error", [ValueError, SystemExit])
def test_error_of_a_job_is_raised_and_ends_no_thread(error):
    pool = DaemonThreads("failing")

    def fail():
        raise error("no")

    with pytest.raises(error):
        pool.submit(fail).result(30)
    assert pool.submit(int).result(30) == 0


@pytest.mark.parametrize("idle", [0.0, 0.01])
def test_idle_threads_end_without_losing_jobs(idle, monkeypatch):
    monkeypatch.setattr(threads, "_IDLE_SECONDS", idle)
    pool = DaemonThreads("coming and going")
    for number in range(300):
        assert pool.submit(abs, number).result(30) == number
    until(lambda: "coming and going" not in names())


def test_running_job_does_not_keep_the_program_alive():
    code = (
        "from abfm.workers.threads import DaemonThreads; import time; "
        "DaemonThreads('late').submit(time.sleep, 1000)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)
