"""Reading in the background: given up, taken up again, and one thing in another's place."""

import threading

import pytest

from abfm_viewer.computing.background import Jobs
from abfm_viewer.session.loading import Load, Loading
from abfm_viewer.session.notices import Notices
from tests.viewer.sessions import until


class Slow:
    """A read that takes as long as the test likes, and counts how often it began and was shown."""

    def __init__(self):
        self.begun = self.shown = 0
        self.may_go_on = threading.Event()

    def __call__(self):
        self.begun += 1
        assert self.may_go_on.wait(30)
        return self.show

    def show(self):
        self.shown += 1


@pytest.fixture
def slow():
    slow = Slow()
    yield slow
    slow.may_go_on.set()


@pytest.fixture
def quick():
    """A read that ends at once."""
    quick = Slow()
    quick.may_go_on.set()
    return quick


@pytest.fixture
def jobs():
    jobs = Jobs()
    yield jobs
    jobs.close()


@pytest.fixture
def loading(jobs):
    return Loading(jobs, Notices(lambda: 0))


def begin(loading, read, source=None, waits=True):
    before = read.begun
    loading.begin(Load("reading", read, source=source))
    until(lambda: not waits or read.begun > before)


def finish(loading):
    """Wait until what is being read has been shown."""
    until(lambda: loading.update() or loading.now is None)


def test_what_was_given_up_is_not_shown(loading, slow, quick):
    begin(loading, slow)
    loading.cancel()
    assert loading.now is None
    slow.may_go_on.set()
    begin(loading, quick)
    finish(loading)
    loading.update()
    assert (slow.shown, quick.shown) == (0, 1)


def test_the_same_again_is_read_once(loading, slow):
    begin(loading, slow, "a file")
    for _ in range(3):
        loading.cancel()
        begin(loading, slow, "a file", waits=False)
    slow.may_go_on.set()
    for count in (1, 2):  # what is over is read anew
        finish(loading)
        assert (slow.begun, slow.shown) == (count, count)
        begin(loading, slow, "a file")


def test_another_source_waits_for_nothing(loading, slow, quick):
    begin(loading, slow, "a file")
    begin(loading, quick, "another file")
    finish(loading)
    assert (slow.shown, quick.shown) == (0, 1)
    begin(loading, slow, "a file", waits=False)
    slow.may_go_on.set()
    finish(loading)
    assert (slow.begun, slow.shown) == (1, 1)


def test_one_that_is_given_up_before_it_begins_is_not_waited_for(loading, slow):
    for _ in range(20):
        begin(loading, slow, "a file", waits=False)
        loading.cancel()
    begin(loading, slow, "a file", waits=False)
    slow.may_go_on.set()
    finish(loading)
    assert slow.shown == 1


def test_closing_does_not_wait_for_what_was_given_up(jobs, loading, slow):
    begin(loading, slow)
    reader = loading._reader
    loading.cancel()
    jobs.close()
    assert reader.is_at_work
