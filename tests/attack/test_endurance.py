"""What the monkey says of threads and memory at the end of a long run."""

from __future__ import annotations

import threading
import time

import pytest

from tests.attack import endurance
from tests.attack.endurance import Endurance, counts


def there_is(monkeypatch: pytest.MonkeyPatch, threads: int, megabytes: float) -> None:
    now = {"threads": threads, "children": 0, "megabytes": megabytes}
    monkeypatch.setattr(endurance, "counts", lambda: now)


@pytest.mark.parametrize(
    ("threads", "megabytes", "holds"),
    [(10, 320.0, True), (10, 360.0, False), (12, 300.0, False), (3, 300.0, True)],
)
def test_growth_by_more_than_a_tenth_is_told(
    threads: int,
    megabytes: float,
    holds: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rests: list[bool] = []
    kept = Endurance(time.monotonic() - 301, lambda: rests.append(True))
    there_is(monkeypatch, 10, 300.0)
    kept.add()
    for k in range(60):
        there_is(monkeypatch, 50, megabytes + k % 7)
        kept.add()
    there_is(monkeypatch, threads, 1000.0)  # after the rest, and some of it in use
    assert kept.end() is holds
    assert len(rests) == 2
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
    kept = Endurance(time.monotonic(), int)
    kept.add()
    assert kept.end()
    assert not capsys.readouterr().err
