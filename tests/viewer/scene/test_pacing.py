from types import SimpleNamespace

import pytest

from abfm_viewer.scene import pacing
from abfm_viewer.scene.pacing import STILL_SECONDS, Pacing, Supersampling

FAST, SLOW, STUCK = 0.005, 0.1, 1.0


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
    """Return a window with a simulated clock, and the samples passed to polyscope."""
    solver, player = SimpleNamespace(running=False), SimpleNamespace(playing=False)
    session = SimpleNamespace(solver=solver, player=player)
    found = SimpleNamespace(session=session, samples=[], time=0.0, size=(1280, 800))
    fake = SimpleNamespace(set_SSAA_factor=found.samples.append, get_window_size=lambda: found.size)
    monkeypatch.setattr(pacing, "ps", fake)
    monkeypatch.setattr(pacing, "clock", SimpleNamespace(perf_counter=lambda: found.time))
    found.supersampling = Supersampling(session, True)

    def frame(after, moves=False, seconds=FAST):
        found.time += after
        found.supersampling.update(moves, seconds)
        return found.samples

    found.frame = frame
    return found


def test_still_window_is_antialiased_once(window):
    assert window.frame(0.9 * STILL_SECONDS) == []
    assert window.frame(0.2 * STILL_SECONDS) == [3]
    for _ in range(5):
        window.frame(STILL_SECONDS)
    assert window.samples == [3]
    assert window.frame(0, moves=True) == [3, 1]
    assert window.frame(0.9 * STILL_SECONDS) == [3, 1]
    assert window.frame(0.2 * STILL_SECONDS) == [3, 1, 3]


@pytest.mark.parametrize("what", ["running", "playing"])
def test_no_antialiasing_during_run_or_playback(window, what):
    setattr(window.session.solver if what == "running" else window.session.player, what, True)
    for _ in range(5):
        window.frame(STILL_SECONDS)
    assert window.samples == []


@pytest.mark.parametrize(
    ("seconds", "size", "expected"),
    [
        (FAST, (1280, 800), [3]),
        (SLOW, (1280, 800), [2]),
        (STUCK, (1280, 800), []),
        (FAST, (3840, 2160), [2]),
    ],
)
def test_samples_depend_on_time_and_window_size(window, seconds, size, expected):
    window.size = size
    assert window.frame(2 * STILL_SECONDS, seconds=seconds) == expected


def test_no_antialiasing_off_screen(window):
    hidden = Supersampling(window.session, False)
    window.time = 10 * STILL_SECONDS
    hidden.update(False, FAST)
    assert window.samples == []
