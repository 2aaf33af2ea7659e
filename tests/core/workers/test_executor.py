import os
import signal
import time
from collections import deque
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import closing

import pytest

from abfm.workers.executor import Processes, completed, in_order
from abfm.workers.progress import reporting_steps, step
from abfm.workers.worker import WorkerEndedError
from tests.processes import children, python


@pytest.fixture
def processes():
    made = Processes(2)
    yield made
    made.shutdown(cancel_futures=True)


def reported(name):
    with step(name):
        return os.environ["OPENBLAS_NUM_THREADS"], os.getpid()


def test_calls_use_one_thread_and_report_steps(processes):
    seen = []
    with reporting_steps(lambda now: seen.append(now and now.task)):
        threads, pid = processes.submit(reported, "a step").result()
    assert isinstance(processes, Executor)
    assert (threads, "a step" in seen) == ("1", True)
    assert pid != os.getpid()
    assert processes.submit(os.getpid).result() == pid  # an idle process is reused
    with pytest.raises(RuntimeError, match="nonsense"):
        processes.submit(int, "nonsense").result()


def test_dead_process_fails_only_its_call(processes):
    other = processes.submit(time.sleep, 1.5)
    ended = processes.submit(signal.raise_signal, signal.SIGKILL)
    with pytest.raises(WorkerEndedError):
        ended.result()
    assert processes.submit(abs, -2).result() == 2
    assert other.result() is None


def test_shutdown_waits_or_ends_calls_at_once():
    before, waited = children(), Processes(1)
    future = waited.submit(time.sleep, 0.2)
    waited.shutdown()
    assert future.done()
    assert future.exception() is None
    ended = Processes(1)
    first, second = ended.submit(time.sleep, 60), ended.submit(abs, 1)
    while not first.running():
        time.sleep(0.01)
    began = time.monotonic()
    ended.shutdown(cancel_futures=True)
    assert time.monotonic() - began < 10
    assert isinstance(first.exception(), WorkerEndedError)
    assert second.cancelled()
    assert children() == before
    with pytest.raises(RuntimeError):
        ended.submit(abs, 1)


def test_subprocess_does_not_rerun_the_script():
    code = (
        "print('script', flush=True); from abfm.workers.executor import Processes; "
        "made = Processes(2); print(made.submit(abs, -3).result()); made.shutdown()"
    )
    assert python(code).stdout == "script\n3\n"


def test_tasks_added_during_iteration_are_completed():
    tasks, found = deque([3, 1]), []
    with ThreadPoolExecutor(2) as executor:
        for task, future in completed(lambda n: executor.submit(pow, n, 2), tasks, lambda: True):
            found.append(future.result())
            if task == 3:
                tasks.append(5)
    assert sorted(found) == [1, 9, 25]


def test_submissions_are_limited():
    submitted = []

    def submit(task):
        submitted.append(Future())
        if task == 0:
            submitted[-1].set_result(task)
        return submitted[-1]

    with closing(completed(submit, deque(range(9)), lambda: True, 3)) as pairs:
        next(pairs)
    assert len(submitted) == 3
    assert list(completed(submit, deque([0]), lambda: False)) == []


def test_numbered_results_are_yielded_in_order():
    assert list(in_order([(2, "c"), (0, "a"), (3, "d"), (1, "b")])) == ["a", "b", "c", "d"]
