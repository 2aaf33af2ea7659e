"""Work off the frame loop: the newest request counts, errors are told, and nothing outlives its owner."""

from __future__ import annotations

import threading
import time

from abfm import FunctionError
from abfm.numerics.own_process import is_factored_apart
from abfm_viewer.computing.background import Latest
from tests.viewer.sessions import until


def test_only_the_newest_of_several_requests_is_computed():
    latest, may_end, computed = Latest[str]("test"), threading.Event(), []

    def job(name):
        def compute():
            computed.append(name)
            may_end.wait(10)
            return name

        return compute

    assert latest.ask("first", job("first")) is None
    until(lambda: computed == ["first"])
    for name in ("second", "third"):
        assert latest.ask(name, job(name)) is None
        assert latest.busy
    may_end.set()
    until(lambda: latest.ask("third", job("third")) == "third")
    assert computed == ["first", "third"]
    assert not latest.busy
    latest.close()


def test_large_systems_are_factored_apart_beside_the_frame_loop_and_small_ones_and_others_here():
    latest = Latest[list[bool]]("test")
    latest.ask("sizes", lambda: [is_factored_apart(size) for size in (14_000, 15_000)])
    until(lambda: latest.key == "sizes")
    assert latest.value == [False, True]
    assert not is_factored_apart(10**9)
    latest.close()


def test_an_error_is_told_in_one_line_and_forgotten_with_the_next_request():
    latest = Latest[int]("test")

    def fail():
        raise FunctionError("two\nlines")

    latest.ask("bad", fail)
    until(lambda: latest.key == "bad")
    assert (latest.value, latest.error) == (None, "two lines")
    latest.ask("good", lambda: 3)
    until(lambda: latest.key == "good")
    assert (latest.value, latest.error) == (3, "")
    latest.close()


def test_closing_ends_the_thread_but_does_not_wait_long_for_a_job():
    idle, busy, begun, may_end = Latest[int]("idle one"), Latest[int]("busy one"), threading.Event(), threading.Event()
    idle.ask("soon", lambda: 1)
    busy.ask("late", lambda: begun.set() or int(may_end.wait(30)))
    until(lambda: idle.key == "soon" and begun.is_set())
    before = time.monotonic()
    idle.close()
    busy.close(0.1)
    assert time.monotonic() - before < 10
    names = {thread.name for thread in threading.enumerate()}
    assert "idle one" not in names
    assert "busy one" in names
    may_end.set()
    until(lambda: "busy one" not in {thread.name for thread in threading.enumerate()})
