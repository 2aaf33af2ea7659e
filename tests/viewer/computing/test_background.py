"""Work off the frame loop: the newest request counts, errors are told, and nothing outlives its
owner.
"""

from __future__ import annotations

import threading

import numpy as np
import pytest

from abfm import FunctionError
from abfm.numerics.factoring_apart import is_factored_apart
from abfm_viewer.computing.background import Jobs, Latest
from tests.viewer.sessions import until


def test_large_systems_are_factored_apart_beside_the_frame_loop_and_small_ones_and_others_here():
    latest = Latest[list[bool]]()
    latest.ask("sizes", lambda: [is_factored_apart(size) for size in (14_000, 15_000)])
    until(lambda: latest.key == "sizes")
    assert latest.value == [False, True]
    assert not is_factored_apart(10**9)
    latest.close()


def test_an_error_is_told_in_one_line_and_forgotten_with_the_next_request():
    latest = Latest[int]()

    def fail():
        raise FunctionError("two\nlines")

    latest.ask("bad", fail)
    until(lambda: latest.key == "bad")
    assert (latest.value, latest.error) == (None, "two lines")
    latest.ask("good", lambda: 3)
    until(lambda: latest.key == "good")
    assert (latest.value, latest.error) == (3, "")
    latest.close()


@pytest.fixture
def held():
    """A `Latest` whose jobs wait for each other's leave: the latest, a function that makes jobs,
    what they did.
    """
    latest, leave, begun = Latest[str](), {}, []

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

    yield latest, job, begun, end
    for event in leave.values():
        event.set()
    latest.close()


def test_what_is_there_and_asked_for_again_stays_though_something_else_was_under_way(held):
    latest, job, begun, end = held
    latest.ask("there", job("there"))
    end("there")
    until(lambda: not latest.busy)
    latest.ask("under way", job("under way"))
    until(lambda: begun == ["there", "under way"])
    assert latest.ask("there", job("there")) == "there"
    end("under way")
    latest.close(10)  # when it has ended
    assert not latest.busy
    assert (latest.key, latest.ask("there", job("there"))) == ("there", "there")
    assert begun == ["there", "under way"]


def test_what_is_under_way_and_asked_for_again_is_not_computed_twice(held):
    latest, job, begun, end = held
    under_way = job("under way")
    latest.ask("under way", under_way)
    until(lambda: begun == ["under way"])
    latest.ask("other", job("other"))
    latest.ask("under way", under_way)
    end("under way")
    until(lambda: latest.ask("under way", under_way) == "under way")
    assert not latest.busy
    assert begun == ["under way"]


def test_keys_have_the_same_arrays_if_these_are_the_same_objects():
    latest, values, calls = Latest[int](at_once=True), np.zeros(3), []

    def count():
        calls.append(1)
        return len(calls)

    assert [latest.ask(("a", values), count), latest.ask(("a", values), count)] == [1, 1]
    assert latest.ask(("a", values.copy()), count) == 2


def test_what_is_computed_at_once_is_there_at_once_in_this_thread():
    latest, threads = Latest[int](at_once=True), []
    for number in (1, 2):
        assert (
            latest.ask(
                number, lambda number=number: threads.append(threading.current_thread()) or number
            )
            == number
        )
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
    assert jobs.error == "ZeroDivisionError: division by zero"
    jobs.close()
    assert one.ask("c", lambda: 1) is None
    assert not jobs.busy


def test_one_that_is_at_work_holds_up_no_other(held):
    latest, job, begun, _ = held
    latest.ask("late", job("late"))
    until(lambda: begun == ["late"])
    others = [Latest[int]() for _ in range(30)]
    for number, other in enumerate(others):
        other.ask(number, lambda number=number: number)
    until(lambda: [other.value for other in others] == list(range(30)))


def test_closing_does_not_wait_long_for_a_job(held):
    latest, job, begun, end = held
    latest.ask("late", job("late"))
    until(lambda: begun == ["late"])
    latest.close(0.1)
    assert latest.is_at_work
    end("late")
    latest.close(10)
    assert not latest.is_at_work
