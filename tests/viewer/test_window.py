"""The app's window, driven by injected clicks without a screen."""

from __future__ import annotations

import time

import numpy as np
import polyscope as ps
import polyscope.imgui as imgui
import pytest

from abfm import Parameters
from abfm_viewer import app, opengl
from abfm_viewer.window import Window
from abfm_viewer.worker import Worker
from tests.shapes import icosphere


@pytest.fixture
def window():
    """A window on a small sphere; it leaves polyscope as it found it."""
    window = Window(icosphere(2), "sphere", opengl.OFFSCREEN)
    tick(3)
    yield window
    if window.worker:
        window.worker.cancel()
        window.worker.wait()
    ps.clear_user_callback()


def tick(count: int = 2) -> None:
    """Draw some frames."""
    for _ in range(count):
        ps.frame_tick()


def press(x: float, y: float, down: bool) -> None:
    """Move the mouse and press or release its button."""
    imgui.GetIO().AddMousePosEvent(x, y)
    tick()
    imgui.GetIO().AddMouseButtonEvent(0, down)
    tick()


def click(x: float) -> None:
    """Click on the row of buttons."""
    press(x, ps.get_window_size()[1] - 58, True)
    press(x, ps.get_window_size()[1] - 58, False)


def finish(window: Window) -> None:
    """Draw until the solver has ended."""
    end = time.monotonic() + 60
    while window.worker.running:
        assert time.monotonic() < end
        window.frame()
    tick()


def advected() -> np.ndarray:
    """What the middle surface shows."""
    values = ps.get_surface_mesh("advected").get_quantity_buffer("function", "values")
    return np.array([values.get_value(index) for index in range(values.size())])


def test_match_runs_and_the_slider_moves_through_time(window):
    assert "162 vertices" in window.status()
    assert advected() == pytest.approx(window.source, abs=1e-6)
    click(60)
    assert window.worker is not None
    finish(window)
    assert window.status().startswith(("iteration limit", "converged"))
    result = window.worker.result
    assert result.match.mismatch < 0.05
    assert advected() == pytest.approx(result.match.advected[:, 0], abs=1e-5)

    width, height = ps.get_window_size()
    press(width - 100, height - 58, True)
    imgui.GetIO().AddMousePosEvent(width / 2, height - 58)
    tick()
    press(width / 2, height - 58, False)
    assert 0.2 < window.time < 0.8
    assert advected() == pytest.approx(result.match.advect(window.time), abs=0.02)


def test_cancel_keeps_the_best_result(window):
    window.parameters = Parameters(iterations=10**6, tolerance=0, sigma=1e-6)
    click(60)
    end = time.monotonic() + 60
    while window.worker.latest is None or window.worker.latest.iteration < 3:
        assert time.monotonic() < end
        window.frame()
    assert "stage 1 of 3" in window.status()
    click(60)
    finish(window)
    assert window.worker.result.match.stop_reason == "cancelled"
    assert window.status().startswith("cancelled")


def test_a_second_match_replaces_the_first(window):
    window.parameters = Parameters(iterations=2)
    for _ in range(2):
        click(60)
        first = window.worker
        finish(window)
    window.match()
    assert window.worker is not first
    finish(window)
    assert window.worker.latest.iteration == 2


def test_reset_view_looks_from_the_front_again(window):
    before = ps.get_camera_view_matrix()
    ps.look_at((3, 4, 5), (0, 0, 0))
    assert not np.allclose(before, ps.get_camera_view_matrix())
    click(150)
    assert np.allclose(before, ps.get_camera_view_matrix(), atol=1e-5)


def test_labels_stand_above_their_surfaces(window):
    labels = window.scene.labels()
    assert list(labels) == ["source", "advected", "target"]
    places = np.array(list(labels.values()))
    width, height = ps.get_window_size()
    assert (np.diff(places[:, 0]) > width / 8).all()
    assert (places[:, 1] < height / 2).all()
    assert (places > 0).all()


def test_an_error_in_a_frame_is_shown_and_drawing_goes_on(window, monkeypatch, capsys):
    monkeypatch.setattr(window.scene, "labels", lambda: 1 / 0)
    tick()
    assert window.status() == "ZeroDivisionError: division by zero"
    assert "ZeroDivisionError" in capsys.readouterr().err
    monkeypatch.undo()
    tick()


def test_a_bad_problem_is_told_by_the_worker():
    mesh = icosphere(1)
    worker = Worker(mesh, np.full(42, np.nan), np.ones(42), Parameters())
    worker.wait()
    assert worker.result is None
    assert "not finite" in worker.error


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["missing.off"], "there is no such file"),
        ([__file__], "the format is not known"),
        (["a.off", "b.off"], "'b.off' is not understood"),
        (["--largest"], "did you mean '--largest-component'?"),
    ],
)
def test_bad_words_are_one_line_and_status_2(words, expected, capsys):
    assert app.main(words) == 2
    told = capsys.readouterr().err
    assert told.startswith("abfm-viewer: ")
    assert told.count("\n") == 1
    assert expected in told
