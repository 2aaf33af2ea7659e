"""`Latest` as a machine of states: whatever is asked for and ends in whatever order, the last
request is answered.
"""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from abfm import FunctionError
from abfm_viewer.computing import background
from abfm_viewer.computing.background import Latest
from tests.viewer.sessions import until

ABOUTS = (np.zeros(3), np.zeros(3))  # equal, and not the same
FAILING = 2
keys = st.sampled_from([(0, 0), (0, 1), (0, FAILING), (1, 0)])


class Asking(RuleBasedStateMachine):
    """Requests for four things, each of which ends when it is told to; one of them fails."""

    def __init__(self) -> None:
        super().__init__()
        self.latest = Latest[tuple[int, int]]()
        self.begun: list[tuple[tuple[int, int], threading.Event]] = []
        self.last: tuple[int, int] | None = None

    def compute(self, key):
        leave = threading.Event()
        self.begun.append((key, leave))
        assert leave.wait(30)
        if key[1] == FAILING:
            raise FunctionError(f"no {key}")
        return key

    def answer(self, key):
        about, name = key
        return self.latest.newest(ABOUTS[about], name, lambda: self.compute(key))

    @rule(key=keys)
    def ask(self, key):
        self.last = key
        answer = self.answer(key)
        assert answer is None or answer[0] == key[0]  # of an earlier one, but about the same
        if not self.latest.busy and key[1] != FAILING:
            assert answer == key

    @rule(key=keys)
    def ask_strictly(self, key):
        self.last = key
        about, name = key
        assert self.latest.ask((ABOUTS[about], name), lambda: self.compute(key)) in (None, key)

    @rule()
    def end_what_runs(self):
        if self.latest.busy or self.latest.is_at_work:
            until(lambda: self.begun)
            _, leave = self.begun.pop(0)
            leave.set()
            until(lambda: self.begun or not (self.latest.busy or self.latest.is_at_work))

    @invariant()
    def what_is_wanted_waits_runs_or_is_finished(self):
        if self.last is not None and not self.latest.busy:
            about, name = self.last
            assert self.latest.key[0] is ABOUTS[about]
            assert self.latest.key[1] == name

    def teardown(self):
        if self.last is not None:
            for _ in range(3):  # what runs, what waits, and none after that
                self.end_what_runs()
            until(lambda: not self.latest.busy)
            failing = self.last[1] == FAILING
            assert self.answer(self.last) == (None if failing else self.last)
            assert self.latest.error == (f"no {self.last}" if failing else "")
            assert not self.latest.busy
        for _, leave in self.begun:
            leave.set()
        self.latest.close(10)


TestAsking = Asking.TestCase
TestAsking.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)


@pytest.mark.parametrize(
    "error", [SystemExit("library"), KeyboardInterrupt(), BaseException("panic")]
)
def test_whatever_a_job_raises_the_next_request_is_answered(error):
    latest = Latest[int]()

    def panic():
        raise error

    latest.ask("first", panic)
    until(lambda: not latest.busy)
    assert latest.error.startswith(type(error).__name__)
    latest.ask("second", lambda: 2)
    until(lambda: latest.ask("second", lambda: 2) == 2)
    latest.close()


def test_an_error_that_cannot_be_printed_ends_no_thread(monkeypatch):
    class Gone:
        def write(self, text):
            raise OSError("the terminal is gone")

    monkeypatch.setattr("sys.stderr", Gone())
    latest = Latest[int]()
    latest.ask("first", lambda: 1 // 0)
    until(lambda: not latest.busy)
    assert latest.error == "ZeroDivisionError: integer division or modulo by zero"
    latest.ask("second", lambda: 2)
    until(lambda: latest.ask("second", lambda: 2) == 2)
    latest.close()


def test_what_could_not_begin_as_there_was_no_thread_begins_with_the_next_request(monkeypatch):
    latest = Latest[int]()

    def none_left(*_):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patched:
        patched.setattr(background.THREADS, "submit", none_left)
        with pytest.raises(RuntimeError):
            latest.ask("key", lambda: 1)
    until(lambda: latest.ask("key", lambda: 1) == 1)
    latest.close()


def test_who_is_retired_is_not_waited_for():
    latest = Latest[int]()
    latest.retire()
    assert latest.ask("key", lambda: 1) is None
    assert not latest.busy
