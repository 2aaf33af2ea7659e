"""Background jobs: the latest request wins, errors are reported, and jobs end with their owner.

Also the memo, which caches the latest value until its inputs change.
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

VALUES, EQUAL = np.zeros(3), np.zeros(3)  # an equal array, but another object
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
def test_arrays_are_compared_by_identity(one, other, expected):
    assert same(one, other) is expected


def test_memo_makes_a_value_only_for_new_inputs():
    memo, calls = Memo(), []

    def make():
        calls.append(1)
        return [len(calls)]

    first = memo.get((VALUES, 1), make)
    assert memo.get((VALUES, 1), make) is first == [1]
    assert memo.get((EQUAL, 1), make) == [2]
    assert memo.get((VALUES, 2), make) == [3]
    assert memo.get((VALUES, 1), make) == [4]  # only the latest value is cached


def test_memo_keeps_its_value_after_an_error():
    memo = Memo()
    memo.get((1,), lambda: 1)
    with pytest.raises(ZeroDivisionError):
        memo.get((2,), lambda: 1 // 0)
    assert memo.get((1,), lambda: 2) == 1
    assert memo.get((3,), lambda: None) is None
    assert memo.get((3,), lambda: 4) is None


class RequestMachine(RuleBasedStateMachine):
    """Requests for four keys in any order, whose jobs end in any order; one of them fails.

    The last request is always answered.
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
    def request(self, key):
        self.last = key
        answer = self.answer(key)
        assert answer is None or answer[0] == key[0]  # of an earlier request for this key
        if not self.latest.busy and key[1] != FAILING:
            assert answer == key

    @rule(key=keys)
    def request_exactly(self, key):
        self.last = key
        full = ((VALUES, EQUAL)[key[0]], (key,))
        assert self.latest.request(full, lambda: self.compute(key)) in (None, key)

    @rule()
    def end_running_job(self):
        if self.latest.busy or self.latest.is_running:
            until(lambda: self.begun)
            _, leave = self.begun.pop(0)
            leave.set()
            until(lambda: self.begun or not (self.latest.busy or self.latest.is_running))

    @invariant()
    def last_request_waits_runs_or_is_finished(self):
        if self.last is not None and not self.latest.busy:
            assert self.latest.key[0] is (VALUES, EQUAL)[self.last[0]]
            assert self.latest.key[1] == (self.last,)

    def teardown(self):
        if self.last is not None:
            for _ in range(3):  # only the running and the waiting job
                self.end_running_job()
            until(lambda: not self.latest.busy)
            failing = self.last[1] == FAILING
            assert self.answer(self.last) == (None if failing else self.last)
            assert self.latest.error == (f"no {self.last}" if failing else "")
            assert not self.latest.busy
        for _, leave in self.begun:
            leave.set()
        self.latest.close(10)


TestRequests = RequestMachine.TestCase
TestRequests.settings = settings(max_examples=60, stateful_step_count=25)


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
    ("error", "message"),
    [
        (FunctionError("two\nlines"), "two lines"),
        (SystemExit("library"), "SystemExit: library"),
        (KeyboardInterrupt(), "KeyboardInterrupt: "),
        (BaseException("panic"), "BaseException: panic"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_errors_of_jobs_are_one_line(latest, error, message, monkeypatch):
    gone = SimpleNamespace(write=raising(OSError("the terminal is gone")))
    monkeypatch.setattr("sys.stderr", gone)  # unprintable errors do not end the thread
    latest.request("bad", raising(error))
    until(lambda: latest.key == "bad")
    assert (latest.value, latest.error) == (None, message)
    latest.request("good", lambda: 3)
    until(lambda: latest.request("good", lambda: 3) == 3)
    assert latest.error == ""


def test_cancelled_job_prints_no_traceback(latest, capsys):
    latest.request("key", raising(CancelledError()))
    until(lambda: latest.key == "key")
    assert latest.value is None
    assert capsys.readouterr().err == ""


def test_job_without_a_thread_starts_later(latest, monkeypatch):
    """If no thread could be started, the next request starts one."""
    with monkeypatch.context() as patched:
        none_left = raising(RuntimeError("can't start new thread"))
        patched.setattr(background.THREADS, "submit", none_left)
        with pytest.raises(RuntimeError):
            latest.request("key", lambda: 1)
    until(lambda: latest.request("key", lambda: 1) == 1)
    latest.retire()
    assert latest.request("another", lambda: 1) is None
    assert not latest.busy


def test_jobs_factor_large_systems_in_a_subprocess(latest):
    latest.request("sizes", lambda: [is_factored_in_subprocess(size) for size in (14_000, 15_000)])
    until(lambda: latest.key == "sizes")
    assert latest.value == [False, True]
    assert not is_factored_in_subprocess(10**9)


@pytest.fixture
def controlled(latest):
    """Yield a function that makes blocked jobs, a list of begun jobs, and a release function."""
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


def test_repeated_request_is_computed_once(latest, controlled):
    job, begun, end = controlled
    there, running = job("there"), job("under way")
    latest.request("there", there)
    until(lambda: begun == ["there"])
    latest.request("other", job("other"))
    latest.request("there", there)
    end("there")
    until(lambda: latest.request("there", there) == "there")
    assert not latest.busy
    latest.request("under way", running)
    until(lambda: begun == ["there", "under way"])
    assert latest.request("there", there) == "there"
    end("under way")
    latest.close(10)  # after the job has ended
    assert not latest.busy
    assert (latest.key, latest.request("there", there)) == ("there", "there")
    assert begun == ["there", "under way"]


def test_running_job_does_not_block_others(latest, controlled):
    job, begun, end = controlled
    latest.request("late", job("late"))
    until(lambda: begun == ["late"])
    others = [Latest() for _ in range(30)]
    for number, other in enumerate(others):
        other.request(number, lambda number=number: number)
    until(lambda: [other.value for other in others] == list(range(30)))
    latest.close(0.1)
    assert latest.is_running
    end("late")
    latest.close(10)
    assert not latest.is_running


def test_at_once_computes_in_this_thread():
    latest, threads = Latest(at_once=True), []

    def count():
        threads.append(threading.current_thread())
        return len(threads)

    for key, expected in (((1, VALUES), 1), ((1, VALUES), 1), ((1, EQUAL), 2), ((2, EQUAL), 3)):
        assert latest.request(key, count) == expected
        assert not latest.busy
    assert set(threads) == {threading.current_thread()}


def test_jobs_share_error_and_end():
    jobs = Jobs()
    one, other = jobs.latest(), jobs.latest()
    may_end = threading.Event()
    one.request("a", lambda: may_end.wait(10))
    other.request("b", lambda: 1 / 0)
    assert jobs.busy
    may_end.set()
    until(lambda: not jobs.busy)
    check_message(jobs.error, "ZeroDivisionError")
    jobs.close()
    assert one.request("c", lambda: 1) is None
    assert not jobs.busy
