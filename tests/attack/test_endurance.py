"""What the monkey says of threads and memory at the end of a long run."""

from __future__ import annotations

import threading
import time

import pytest

from tests.attack.endurance import Endurance, counts


@pytest.mark.parametrize(("late", "holds"), [(320.0, True), (360.0, False)])
def test_growth_by_more_than_a_tenth_is_told(late: float, holds: bool, capsys: pytest.CaptureFixture[str]) -> None:
    endurance = Endurance(time.monotonic() - 301)
    endurance.add({"threads": 10, "megabytes": 300.0})
    for k in range(60):
        endurance.add({"threads": 10, "megabytes": late + k % 7})
    assert endurance.end() is holds
    assert "300" in capsys.readouterr().err


def test_threads_may_end_while_they_are_counted() -> None:
    done = threading.Event()

    def begin_and_end() -> None:
        while not done.is_set():
            threading.Thread(target=int).start()

    busy = threading.Thread(target=begin_and_end)
    busy.start()
    try:
        found = [counts() for _ in range(200)]
    finally:
        done.set()
        busy.join()
    assert all(each["threads"] >= 2 and each["megabytes"] > 10 for each in found)


def test_nothing_is_said_of_a_short_run(capsys: pytest.CaptureFixture[str]) -> None:
    endurance = Endurance(time.monotonic())
    endurance.add({"threads": 10})
    assert endurance.end()
    assert not capsys.readouterr().err
