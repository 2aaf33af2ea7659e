"""Reading in the background: given up, taken up again, and one thing in another's place."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from abfm_viewer.computing.background import Jobs
from abfm_viewer.session.loading import Load, Loading
from tests.viewer.sessions import until


class Slow:
    """A read that takes as long as the test likes, and counts how often it began."""

    def __init__(self) -> None:
        self.begun = 0
        self.may_go_on = threading.Event()

    def __call__(self) -> Callable[[], None]:
        self.begun += 1
        assert self.may_go_on.wait(30)
        return lambda: None


@pytest.fixture
def slow():
    slow = Slow()
    yield slow
    slow.may_go_on.set()


@pytest.fixture
def loading():
    jobs = Jobs()
    yield Loading(jobs)
    jobs.close()


def begun(loading: Loading, read: Slow, source: object = None) -> Load:
    before, load = read.begun, Load("reading", read, source=source)
    loading.begin(load)
    until(lambda: read.begun > before)
    return load


def taken(loading: Loading) -> list[Load]:
    """What is read in the end."""
    found = []
    until(lambda: loading.now is None or ((one := loading.taken()) and found.append(one[0])) or found)
    return found


def test_what_was_given_up_is_not_taken(loading, slow):
    begun(loading, slow)
    loading.cancel()
    assert loading.now is None
    slow.may_go_on.set()
    other = Load("other", lambda: lambda: None)
    loading.begin(other)
    assert taken(loading) == [other]
    assert loading.taken() is None


def test_the_same_again_is_read_once(loading, slow):
    begun(loading, slow, "a file")
    for _ in range(3):
        loading.cancel()
        again = Load("reading", slow, source="a file")
        loading.begin(again)
    slow.may_go_on.set()
    assert taken(loading) == [again]
    assert slow.begun == 1
    loading.begin(Load("reading", slow, source="a file"))  # that is over: it is read anew
    taken(loading)
    assert slow.begun == 2


def test_another_source_waits_for_nothing(loading, slow):
    begun(loading, slow, "a file")
    other = Load("other", lambda: lambda: None, source="another file")
    loading.begin(other)
    assert taken(loading) == [other]
    back = Load("reading", slow, source="a file")
    loading.begin(back)
    slow.may_go_on.set()
    assert taken(loading) == [back]
    assert slow.begun == 1


def test_one_that_is_given_up_before_it_begins_is_not_waited_for(loading, slow):
    for _ in range(20):
        loading.begin(Load("reading", slow, source="a file"))
        loading.cancel()
    last = Load("reading", slow, source="a file")
    loading.begin(last)
    slow.may_go_on.set()
    assert taken(loading) == [last]


def test_closing_does_not_wait_for_what_was_given_up(slow):
    jobs, joined = Jobs(), []
    loading = Loading(jobs)
    begun(loading, slow)
    reader = loading._reader
    loading.cancel()
    reader._thread.join = lambda seconds: joined.append(seconds)
    jobs.close()
    assert sum(joined) <= 0.2
    assert reader._thread.daemon
