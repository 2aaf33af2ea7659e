from types import SimpleNamespace

import pytest

from abfm_viewer.scene import pacing
from abfm_viewer.scene.pacing import STILL_SECONDS, Pacing, Supersampling

FAST, MEDIUM, SLOW, STUCK = 0.002, 0.01, 0.1, 1.0


@pytest.fixture
def paced():
    session = SimpleNamespace(
        solver=SimpleNamespace(started=1),
        matching=SimpleNamespace(running=True),
        dragging=False,
        view=SimpleNamespace(animate=False),
    )
    paced = Pacing(session)
    paced.redraw_seconds = 0.1
    return paced


def drawn(paced, frames):
    """Return the frames in which a run with ever new pictures draws the advected surface."""
    found = []
    for frame in range(frames):
        if not paced.waits("advected", is_first=True):
            paced.count(is_new=True, is_texture=False)
            found.append(frame)
    return found


def test_slow_machine_shows_few_pictures(paced):
    frames = drawn(paced, 100)
    assert frames[:3] == [0, 1, 2]
    assert 5 <= len(frames) <= 8


def test_field_waits_for_first_pictures(paced):
    session = paced._session
    assert paced.is_beginning
    drawn(paced, 3)
    assert paced.is_beginning
    drawn(paced, 40)
    assert not paced.is_beginning
    session.solver.started += 1
    assert paced.is_beginning
    session.matching.running = False
    assert not paced.is_beginning


def test_fast_machine_shows_every_picture(paced):
    paced.redraw_seconds = 0.01
    assert not paced.is_beginning
    assert drawn(paced, 10) == list(range(10))


@pytest.fixture
def window(monkeypatch):
    """Return a window with a simulated clock and time of a redraw, and the used samples."""
    found = SimpleNamespace(samples=[], time=0.0, size=(1280, 800), seconds=FAST, ratio=4)
    fake = SimpleNamespace(set_SSAA_factor=found.samples.append, get_window_size=lambda: found.size)
    monkeypatch.setattr(pacing, "ps", fake)
    monkeypatch.setattr(pacing, "clock", SimpleNamespace(perf_counter=lambda: found.time))
    found.supersampling = Supersampling(True)

    def frame(after, redraws=False, is_busy=False):
        found.time += after
        found.supersampling.update(redraws, is_busy)
        if redraws:
            factor = 1 if found.supersampling.samples == 1 else found.ratio
            found.supersampling.record(factor * found.seconds)
        return found.samples

    found.frame = frame
    return found


def test_still_window_is_antialiased_once(window):
    window.seconds = MEDIUM
    window.frame(0, redraws=True)
    assert window.frame(0.9 * STILL_SECONDS) == []
    assert window.frame(0.2 * STILL_SECONDS) == [3]
    for _ in range(5):
        window.frame(STILL_SECONDS)
    assert window.samples == [3]
    assert window.frame(0, redraws=True) == [3, 1]
    assert window.frame(0.9 * STILL_SECONDS) == [3, 1]
    assert window.frame(0.2 * STILL_SECONDS) == [3, 1, 3]


def test_nothing_is_antialiased_before_first_redraw(window):
    assert window.frame(10 * STILL_SECONDS) == []


@pytest.mark.parametrize(
    ("seconds", "size", "expected"),
    [
        (MEDIUM, (1280, 800), 3),
        (SLOW, (1280, 800), 3),
        (STUCK, (1280, 800), 2),
        (STUCK, (3840, 2160), 2),
        (MEDIUM, (5120, 2880), 1),
    ],
)
def test_samples_at_rest(window, seconds, size, expected):
    window.seconds, window.size = seconds, size
    window.frame(0, redraws=True)
    window.frame(10)
    assert window.supersampling.samples == expected


def test_slow_machine_smooths_after_longer_rest(window):
    window.seconds = SLOW
    window.frame(0, redraws=True)
    assert window.frame(4 * SLOW) == []
    assert window.frame(5 * SLOW, is_busy=True) == []
    assert window.frame(4 * SLOW) == []
    assert window.frame(6 * SLOW) == [3]
    assert window.frame(0, is_busy=True) == [3]


def test_fast_machine_smooths_during_work(window):
    window.frame(0, redraws=True)
    assert window.frame(2 * STILL_SECONDS, is_busy=True) == [3]


def test_fast_machine_smooths_motion(window):
    window.seconds = 1 / 100
    for _ in range(3):
        window.frame(0, redraws=True)
    assert window.supersampling.samples == 1
    window.seconds = 1 / 100 / 3
    for _ in range(3):
        window.frame(0, redraws=True)
    assert window.supersampling.samples == 2
    window.seconds = 1 / 100
    for _ in range(3):
        window.frame(0, redraws=True)
    assert window.supersampling.samples == 1


def test_samples_of_motion_seldom_change(window):
    window.seconds, window.ratio = 1 / 300, 10  # slower than expected
    for _ in range(100):
        window.frame(0, redraws=True)
    assert window.samples == [2, 1]


def test_off_screen_window_has_one_sample(window):
    hidden = Supersampling(False)
    hidden.record(FAST)
    window.time = 10 * STILL_SECONDS
    hidden.update(False, False)
    assert window.samples == []
