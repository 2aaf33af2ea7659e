"""Threads for jobs: as many as are needed at once, gone after a while."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from concurrent.futures import wait

import pytest

from abfm.workers import threads
from abfm.workers.threads import DaemonThreads


def names() -> list[str]:
    return [thread.name for thread in threading.enumerate()]


def until(condition) -> None:
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


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
    monkeypatch.setattr(threads, "_IDLE", idle)
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
