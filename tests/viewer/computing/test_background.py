"""Work off the frame loop: the newest request counts, errors are told, nothing outlives its owner,
and what was made last is kept while what it is made of stays the same.
"""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from abfm import FunctionError
from abfm.numerics.factoring_in_subprocess import is_factored_in_subprocess
from abfm.workers.control import CancelledError
from abfm_viewer.computing import background
from abfm_viewer.computing.background import Jobs, Latest, Memo, same
from tests.messages import check_message
from tests.viewer.sessions import until

VALUES, EQUAL = np.zeros(3), np.zeros(3)  # and not the same
FAILING = 2
keys = st.sampled_from([(0, 0), (0, 1), (0, FAILING), (1, 0)])


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (1, 1.0, True),
        ("a", "b", False),
        (None, 0, False),
        (VALUES, VALUES, True),
        (VALUES, EQUAL, False),
        (VALUES, 0.0, False),
        ((1, (VALUES, "a")), (1, (VALUES, "a")), True),
        ((1, (VALUES, "a")), (1, (EQUAL, "a")), False),
        ((1, 2), (1, 2, 3), False),
        ((1,), 1, False),
        (float("nan"), float("nan"), False),
    ],
)
def test_arrays_are_the_same_by_identity_and_other_things_by_value(one, other, expected):
    assert same(one, other) is expected


def test_a_value_is_made_again_only_when_what_it_is_made_of_changes():
    memo, made = Memo(), []

    def make():
        made.append(1)
        return [len(made)]

    first = memo.get((VALUES, 1), make)
    assert memo.get((VALUES, 1), make) is first == [1]
    assert memo.get((EQUAL, 1), make) == [2]
    assert memo.get((VALUES, 2), make) == [3]
    assert memo.get((VALUES, 1), make) == [4]  # only the latest is kept


def test_what_could_not_be_made_leaves_the_value_before():
    memo = Memo()
    memo.get((1,), lambda: 1)
    with pytest.raises(ZeroDivisionError):
        memo.get((2,), lambda: 1 // 0)
    assert memo.get((1,), lambda: 2) == 1
    assert memo.get((3,), lambda: None) is None
    assert memo.get((3,), lambda: 4) is None


class Asking(RuleBasedStateMachine):
    """Whatever is asked for and ends in whatever order, the last request is answered.

    There are requests for four things, each ends when it is told to, and one of them fails.
    """

    def __init__(self):
        super().__init__()
        self.latest, self.begun, self.last = Latest(), [], None

    def compute(self, key):
        leave = threading.Event()
        self.begun.append((key, leave))
        assert leave.wait(30)
        if key[1] == FAILING:
            raise FunctionError(f"no {key}")
        return key

    def answer(self, key):
        return self.latest.newest((VALUES, EQUAL)[key[0]], self.compute, key)

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
        full = ((VALUES, EQUAL)[key[0]], (key,))
        assert self.latest.ask(full, lambda: self.compute(key)) in (None, key)

    @rule()
    def end_what_runs(self):
        if self.latest.busy or self.latest.is_running:
            until(lambda: self.begun)
            _, leave = self.begun.pop(0)
            leave.set()
            until(lambda: self.begun or not (self.latest.busy or self.latest.is_running))

    @invariant()
    def what_is_wanted_waits_runs_or_is_finished(self):
        if self.last is not None and not self.latest.busy:
            assert self.latest.key[0] is (VALUES, EQUAL)[self.last[0]]
            assert self.latest.key[1] == (self.last,)

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


@pytest.fixture
def latest():
    latest = Latest()
    yield latest
    latest.close()


def raising(error):
    def fail(*_):
        raise error

    return fail


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (FunctionError("two\nlines"), "two lines"),
        (SystemExit("library"), "SystemExit: library"),
        (KeyboardInterrupt(), "KeyboardInterrupt: "),
        (BaseException("panic"), "BaseException: panic"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_whatever_a_job_raises_is_told_in_one_line_and_the_next_request_is_answered(
    latest, error, told, monkeypatch
):
    gone = SimpleNamespace(write=raising(OSError("the terminal is gone")))
    monkeypatch.setattr("sys.stderr", gone)  # what cannot be printed ends no thread
    latest.ask("bad", raising(error))
    until(lambda: latest.key == "bad")
    assert (latest.value, latest.error) == (None, told)
    latest.ask("good", lambda: 3)
    until(lambda: latest.ask("good", lambda: 3) == 3)
    assert latest.error == ""


def test_a_job_that_was_cancelled_is_no_fault_of_the_program(latest, capsys):
    latest.ask("key", raising(CancelledError()))
    until(lambda: latest.key == "key")
    assert latest.value is None
    assert capsys.readouterr().err == ""


def test_what_could_not_begin_as_there_was_no_thread_begins_with_the_next_request(
    latest, monkeypatch
):
    with monkeypatch.context() as patched:
        none_left = raising(RuntimeError("can't start new thread"))
        patched.setattr(background.THREADS, "submit", none_left)
        with pytest.raises(RuntimeError):
            latest.ask("key", lambda: 1)
    until(lambda: latest.ask("key", lambda: 1) == 1)
    latest.retire()
    assert latest.ask("another", lambda: 1) is None
    assert not latest.busy


def test_large_systems_are_factored_apart_beside_the_frame_loop_and_small_ones_and_others_here(
    latest,
):
    latest.ask("sizes", lambda: [is_factored_in_subprocess(size) for size in (14_000, 15_000)])
    until(lambda: latest.key == "sizes")
    assert latest.value == [False, True]
    assert not is_factored_in_subprocess(10**9)


@pytest.fixture
def held(latest):
    """Jobs that wait for each other's leave: a function that makes them, what they did, and one
    that gives leave.
    """
    leave, begun = {}, []

    def job(name):
        leave[name] = threading.Event()

        def compute():
            begun.append(name)
            assert leave[name].wait(10)
            return name

        return compute

    def end(name):
        until(lambda: name in begun)
        leave[name].set()

    yield job, begun, end
    for event in leave.values():
        event.set()


def test_what_is_there_or_under_way_and_asked_for_again_is_not_computed_twice(latest, held):
    job, begun, end = held
    there, under_way = job("there"), job("under way")
    latest.ask("there", there)
    until(lambda: begun == ["there"])
    latest.ask("other", job("other"))
    latest.ask("there", there)
    end("there")
    until(lambda: latest.ask("there", there) == "there")
    assert not latest.busy
    latest.ask("under way", under_way)
    until(lambda: begun == ["there", "under way"])
    assert latest.ask("there", there) == "there"
    end("under way")
    latest.close(10)  # when it has ended
    assert not latest.busy
    assert (latest.key, latest.ask("there", there)) == ("there", "there")
    assert begun == ["there", "under way"]


def test_one_that_is_at_work_holds_up_no_other_and_is_not_waited_for_long(latest, held):
    job, begun, end = held
    latest.ask("late", job("late"))
    until(lambda: begun == ["late"])
    others = [Latest() for _ in range(30)]
    for number, other in enumerate(others):
        other.ask(number, lambda number=number: number)
    until(lambda: [other.value for other in others] == list(range(30)))
    latest.close(0.1)
    assert latest.is_running
    end("late")
    latest.close(10)
    assert not latest.is_running


def test_what_is_computed_at_once_is_there_at_once_in_this_thread():
    latest, threads = Latest(at_once=True), []

    def count():
        threads.append(threading.current_thread())
        return len(threads)

    for key, expected in (((1, VALUES), 1), ((1, VALUES), 1), ((1, EQUAL), 2), ((2, EQUAL), 3)):
        assert latest.ask(key, count) == expected
        assert not latest.busy
    assert set(threads) == {threading.current_thread()}


def test_jobs_of_one_owner_tell_and_end_together():
    jobs = Jobs()
    one, other = jobs.latest(), jobs.latest()
    may_end = threading.Event()
    one.ask("a", lambda: may_end.wait(10))
    other.ask("b", lambda: 1 / 0)
    assert jobs.busy
    may_end.set()
    until(lambda: not jobs.busy)
    check_message(jobs.error, "ZeroDivisionError")
    jobs.close()
    assert one.ask("c", lambda: 1) is None
    assert not jobs.busy
