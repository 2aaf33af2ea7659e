"""Which frames draw the surfaces anew while a match runs."""

from types import SimpleNamespace

import pytest

from abfm_viewer.scene.pacing import Pacing


@pytest.fixture
def session():
    solver = SimpleNamespace(running=True, started=1)
    return SimpleNamespace(solver=solver, dragging=False, view=SimpleNamespace(animate=False))


def drawn(pacing: Pacing, frames: int) -> list[int]:
    """The frames in which a run of ever new pictures draws the advected surface."""
    found = []
    for frame in range(frames):
        if not pacing.waits("advected", is_first=True):
            pacing.count(is_new=True, is_texture=False)
            found.append(frame)
    return found


def test_a_machine_that_draws_slowly_shows_the_start_at_once_and_then_a_picture_now_and_then(
    session,
):
    pacing = Pacing(session)
    pacing.redraw_seconds = 0.1
    frames = drawn(pacing, 100)
    assert frames[:3] == [0, 1, 2]
    assert 5 <= len(frames) <= 8


def test_the_field_of_a_run_waits_until_its_first_pictures_are_drawn(session):
    pacing = Pacing(session)
    pacing.redraw_seconds = 0.1
    assert pacing.begins
    drawn(pacing, 3)
    assert pacing.begins
    drawn(pacing, 40)
    assert not pacing.begins
    session.solver.started += 1
    assert pacing.begins
    session.solver.running = False
    assert not pacing.begins


def test_where_surfaces_are_drawn_within_a_frame_nothing_waits(session):
    pacing = Pacing(session)
    pacing.redraw_seconds = 0.01
    assert not pacing.begins
    assert drawn(pacing, 10) == list(range(10))
