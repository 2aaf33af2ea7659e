import os
import signal
import threading
import time
from functools import partial

import pytest

from abfm import AbfmError
from abfm.workers import worker as worker_module
from abfm.workers.worker import WorkerEndedError
from abfm_viewer.computing import run as run_module
from abfm_viewer.computing.run import Process, Run, RunState
from tests.messages import check_message, raises
from tests.viewer.computing import jobs
from tests.viewer.sessions import until

FOREVER = 10**9


@pytest.fixture
def run():
    run = Run(Process())
    yield run
    run.close()


class StartedRun:
    """A run that was started, its partial results and its results."""

    def __init__(self, run, function, *given, recover=lambda: None, tries=1):
        self.run, self.partials, self.passed_on = run, [], []
        take = self.partials.append
        work = partial(run.call, function, *given, on_partial=take, tries=tries)
        run.start(work, self.passed_on.append, recover)

    def ended(self):
        assert self.run.wait(30)
        self.run.collect()
        [result] = self.passed_on
        return result


def process_of(run):
    return run.process._worker._connection.process


def test_result_is_passed_on_once(run):
    assert (run.running, run.paused, run.finished, run.overall.step) == (False, False, False, None)
    for do in (run.cancel, run.pause, run.resume, run.collect):  # has no effect without a run
        do()
    assert run.state is RunState.IDLE
    started = StartedRun(run, jobs.count, 30)
    assert (run.running, run.state, run.started) == (True, RunState.RUNNING, 1)
    assert started.ended() == 30
    run.collect()
    assert started.passed_on == [30]
    assert started.partials == list(range(30))
    assert (run.running, run.finished, run.failed, run.reason) == (False, True, False, "")
    assert run.has_partial_results
    run.forget()
    assert run.state is RunState.IDLE


def test_paused_run_makes_no_progress(run):
    started = StartedRun(run, jobs.count, FOREVER)
    until(lambda: len(started.partials) > 3)
    for _ in range(2):
        run.pause()
        assert (run.paused, run.running) == (True, True)
        until(lambda: len(started.partials) == (time.sleep(0.1), len(started.partials))[1])
        count = len(started.partials)
        run.resume()
        assert not run.paused
        until(lambda count=count: len(started.partials) > count)
    run.pause()
    run.cancel()
    assert run.state is RunState.ENDING
    run.pause()  # a pause does not stop the cancellation
    assert started.ended() == len(started.partials)
    assert (run.finished, run.failed) == (True, False)


@pytest.mark.parametrize("paused", [False, True])
def test_pause_before_the_call_takes_effect(run, paused):
    may_begin = threading.Event()

    def work():
        may_begin.wait(30)
        return run.call(jobs.count, FOREVER)

    run.start(work, lambda count: None)
    if paused:
        run.pause()
    run.cancel()
    may_begin.set()
    assert run.wait(30)


def test_call_can_be_ended_without_the_run(run):
    partials, passed_on = [], []

    def work():
        first = run.call(jobs.count, FOREVER, on_partial=lambda _: run.end_call())
        run.pause()
        return first, run.call(jobs.count, FOREVER, on_partial=partials.append)

    run.start(work, passed_on.append)
    until(lambda: run.paused)
    time.sleep(0.3)  # meanwhile the next call begins
    count = len(partials)
    time.sleep(0.1)
    assert len(partials) == count
    run.resume()
    until(lambda: len(partials) > 100)
    run.cancel()
    run.wait(30)
    run.collect()
    [(first, second)] = passed_on
    assert (first < FOREVER, second, run.state) == (True, len(partials), RunState.ENDED)


def test_errors_are_one_line_and_keep_the_result(run, capsys):
    started = StartedRun(run, jobs.refuse, recover=lambda: "found")
    assert started.ended() == "found"
    assert (run.failed, run.reason) == (True, "not this")
    assert not capsys.readouterr().err

    def fails():
        raise AbfmError

    def broken():
        raise RuntimeError("boom\nand more")

    passed_on = []
    run.start(broken, passed_on.append, fails)
    run.wait(30)
    run.collect()
    assert (passed_on, run.failed, run.reason) == ([None], True, "RuntimeError: boom and more")
    assert "Traceback" in capsys.readouterr().err  # the traceback, for developers
    assert StartedRun(run, jobs.count, 1).ended() == 1
    assert run.reason == ""


def test_run_reports_its_step(run):
    started = StartedRun(run, jobs.hold, recover=lambda: "found")
    until(lambda: run.overall.step)
    assert run.overall.step.task == "holding"
    until(lambda: process_of(run))
    os.kill(run.process._worker.pid, signal.SIGKILL)
    assert started.ended() == "found"
    assert (run.failed, run.overall.step) == (True, None)
    check_message(run.reason)
    with raises(WorkerEndedError):
        run.process.call_now(jobs.pid)
    assert StartedRun(run, jobs.pid).ended()[0] == run.process._worker.pid  # of the worker process


@pytest.mark.parametrize("tries", [1, 2])
def test_ended_process_is_tried_again(run, tmp_path, tries):
    started = StartedRun(run, jobs.pid_if, tmp_path / "file", tries=tries)
    assert started.ended() == (run.process._worker.pid if tries > 1 else None)
    assert run.failed == (tries == 1)


def test_process_that_does_not_start_fails_the_run(run, monkeypatch):
    monkeypatch.setattr(worker_module, "WORKER_MODULE", "abfm.workers.nothing")
    monkeypatch.setattr(Process, "_idle_workers", [])
    assert StartedRun(run, jobs.pid).ended() is None
    assert run.failed


def test_closing_ends_call_and_process(run):
    StartedRun(run, jobs.hold)
    until(lambda: run.overall.step)
    process = process_of(run)
    run.close(seconds=0)
    assert process.has_ended
    assert run._working.exception(10) is None
    with raises(WorkerEndedError):
        run.process.call(jobs.pid)


def test_idle_process_is_reused(monkeypatch):
    monkeypatch.setattr(Process, "_idle_workers", [])
    pids = []
    for _ in range(2):
        run = Run(Process())
        pids.append(StartedRun(run, jobs.pid).ended())
        run.close()
        Process().close()  # which started no process
    assert pids == [(pids[0][0], 1), (pids[0][0], 2)]
    several = [Process() for _ in range(run_module._IDLE_WORKERS_MAX + 1)]
    for process in several:
        process.solve(jobs.pid)
    workers = [process._worker for process in several]
    for process in several:
        process.close()
    assert Process._idle_workers == workers[:-1]
    for worker in workers:
        worker.close()
