"""What the monkey says of threads and memory at the end of a long run."""

from __future__ import annotations

import time

import pytest

from tests.attack.endurance import Endurance


@pytest.mark.parametrize(("late", "holds"), [(320.0, True), (360.0, False)])
def test_growth_by_more_than_a_tenth_is_told(late: float, holds: bool, capsys: pytest.CaptureFixture[str]) -> None:
    endurance = Endurance(time.monotonic() - 301)
    endurance.add({"threads": 10, "megabytes": 300.0})
    for k in range(60):
        endurance.add({"threads": 10, "megabytes": late + k % 7})
    assert endurance.end() is holds
    assert "300" in capsys.readouterr().err


def test_nothing_is_said_of_a_short_run(capsys: pytest.CaptureFixture[str]) -> None:
    endurance = Endurance(time.monotonic())
    endurance.add({"threads": 10})
    assert endurance.end()
    assert not capsys.readouterr().err
