"""When the surfaces in a window are antialiased."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from abfm_viewer.scene import pacing
from abfm_viewer.scene.pacing import STILL, Resting

FAST, SLOW, STUCK = 0.005, 0.1, 1.0


@pytest.fixture
def window(monkeypatch):
    """A window whose clock we turn; `samples` are those that polyscope was told, one after the
    other.
    """
    session = SimpleNamespace(
        solver=SimpleNamespace(running=False), player=SimpleNamespace(playing=False)
    )
    found = SimpleNamespace(session=session, samples=[], time=0.0, size=(1280, 800))
    fake = SimpleNamespace(set_SSAA_factor=found.samples.append, get_window_size=lambda: found.size)
    monkeypatch.setattr(pacing, "ps", fake)
    found.resting = Resting(session, True, now=lambda: found.time)

    def frame(after, moves=False, seconds=FAST):
        found.time += after
        found.resting.update(moves, seconds)

    found.frame = frame
    return found


def test_one_frame_is_drawn_anew_when_nothing_moved_for_a_while(window):
    window.frame(0.9 * STILL)
    assert window.samples == []
    window.frame(0.2 * STILL)
    assert window.samples == [3]
    for _ in range(5):
        window.frame(STILL)
    assert window.samples == [3]


def test_a_motion_ends_it_at_once_and_the_wait_begins_again(window):
    window.frame(2 * STILL)
    window.frame(0, moves=True)
    assert window.samples == [3, 1]
    window.frame(0.9 * STILL)
    assert window.samples == [3, 1]
    window.frame(0.2 * STILL)
    assert window.samples == [3, 1, 3]


@pytest.mark.parametrize("what", ["solver", "player"])
def test_it_never_happens_during_a_run_nor_while_time_moves(window, what):
    busy = window.session.solver if what == "solver" else window.session.player
    setattr(busy, {"solver": "running", "player": "playing"}[what], True)
    for _ in range(5):
        window.frame(STILL)
    assert window.samples == []


@pytest.mark.parametrize(("seconds", "expected"), [(FAST, [3]), (SLOW, [2]), (STUCK, [])])
def test_fewer_samples_where_drawing_takes_long(window, seconds, expected):
    window.frame(2 * STILL, seconds=seconds)
    assert window.samples == expected


def test_fewer_samples_in_large_windows(window):
    window.size = (3840, 2160)
    window.frame(2 * STILL)
    assert window.samples == [2]


def test_off_the_screen_nothing_rests(window):
    hidden = Resting(window.session, False, now=lambda: window.time)
    window.time = 10 * STILL
    hidden.update(False, FAST)
    assert window.samples == []
