"""The time bar: playing, stepping, scrubbing."""

from __future__ import annotations

import numpy as np
import polyscope.imgui as imgui
import pytest

from abfm_viewer.panels import time_bar


def shown(gui):
    """The advected function at the shown time, when it is known exactly."""
    gui.wait(lambda _: gui.window.shown.flow.settled)
    gui.wait(lambda _: not gui.window.shown.busy)
    return gui.window.shown.flow.advected().copy()


def test_scrubbing_goes_from_the_source_to_the_match_and_beyond(matched):
    source, result = matched.session.values("source"), matched.session.result
    matched.click("to start")
    assert matched.session.time == 0
    np.testing.assert_allclose(shown(matched), source, atol=1e-12)
    matched.drag("time", 0.5)
    halfway = shown(matched)
    assert np.abs(halfway - source).max() > 0.01
    np.testing.assert_allclose(halfway, result.advect(matched.session.time)[:, 0], atol=1e-6)
    matched.type("time", "1")
    np.testing.assert_allclose(shown(matched), result.advected[:, 0])
    matched.type("time", "2")
    np.testing.assert_allclose(shown(matched), result.advect(2.0)[:, 0], atol=1e-6)
    matched.frames(2)
    assert matched.window.scene.paints["advected"].title.startswith("advected, extrapolated")
    assert "extrapolated" not in matched.window.scene.paints["target"].title


def test_a_text_that_is_no_time_is_refused(matched):
    for text in ("soon", "nan", "inf"):
        matched.type("time", text)
        assert matched.session.notices.latest.text == f"time: '{text}' is no number"
        assert matched.session.time == 1
    assert matched.errors == {}
    matched.type("time", "99")
    assert matched.session.time == 2


def test_steps_by_button_and_key(matched):
    matched.click("<")
    assert matched.session.time == pytest.approx(0.95)
    matched.click(">")
    matched.click(">")
    assert matched.session.time == pytest.approx(1.05)
    matched.key("left")
    matched.key("home")
    assert matched.session.time == 0
    matched.key("right")
    assert matched.session.time == pytest.approx(0.05)
    matched.key("end")
    assert matched.session.time == 1


def test_playing_repeats_as_it_is_told(matched):
    player = matched.session.player
    matched.drag("speed", 4.0)
    assert player.speed == pytest.approx(4)
    matched.choose("repeat", "ping-pong")
    matched.type("time", "0.9")
    matched.click("Play")
    matched.wait(lambda s: s.time > 0.95, 5)
    matched.wait(lambda s: s.time < 0.8, 5)
    matched.click("Pause", within="time bar")
    assert not player.playing
    matched.choose("repeat", "loop")
    matched.type("time", "0.9")
    matched.key("space")
    matched.wait(lambda s: s.time < 0.5, 5)
    matched.key("space")
    matched.choose("repeat", "once")
    matched.check("beyond τ")
    matched.type("time", "1.8")
    matched.click("Play")
    matched.wait(lambda s: not s.player.playing, 5)
    assert matched.session.time == 2


def test_a_scrub_is_one_step_of_undo(matched):
    matched.drag("time", 0.3)
    matched.drag("time", 1.4)
    matched.key("ctrl+z")
    assert matched.session.time == pytest.approx(0.3, abs=0.01)
    matched.key("ctrl+z")
    assert matched.session.time == 1
    matched.key("ctrl+shift+z")
    assert matched.session.time == pytest.approx(0.3, abs=0.01)


def test_the_track_stays_in_sight_under_the_mouse(matched, monkeypatch):
    grounds, places, shown = [], [], []
    slider = imgui.SliderFloat

    def recorded(label, *options):
        if label == "##time slider":
            frames = (
                imgui.ImGuiCol_FrameBg,
                imgui.ImGuiCol_FrameBgHovered,
                imgui.ImGuiCol_FrameBgActive,
            )
            grounds.append([imgui.GetStyleColorVec4(color)[3] for color in frames])
        return slider(label, *options)

    monkeypatch.setattr(imgui, "SliderFloat", recorded)
    monkeypatch.setattr(imgui, "SetNextWindowPos", lambda place, *_: places.append((place, *_)))
    monkeypatch.setattr(imgui, "BeginTooltip", lambda: shown.append(True))
    monkeypatch.setattr(imgui, "EndTooltip", lambda: None)
    left, top, right, bottom = matched.search.find("time", kinds=("slider",)).rect
    matched.input.move((left + right) / 2, (top + bottom) / 2)
    matched.frames(40)
    assert shown
    assert [alpha for ground in grounds for alpha in ground] == [0] * 3 * len(grounds)
    place, _, pivot = next(entry for entry in places if len(entry) == 3)
    assert pivot == (0, 1)  # its lower left corner
    assert place[1] < top
    matched.input.press()
    matched.input.move(left + 0.3 * (right - left), (top + bottom) / 2)
    shown.clear()
    matched.frames(40)
    assert not shown
    matched.input.release()


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize("width", [200, 420, 560, 900, 2180])
def test_rows_of_the_bar_are_as_few_as_hold_all(scale, width):
    rows = time_bar._rows(width / scale)
    assert rows == sorted(rows)
    for row in set(rows):
        groups = [
            needed
            for at, needed in zip(rows, time_bar._groups(width / scale), strict=True)
            if at == row
        ]
        room = width / scale - time_bar._PADDING
        assert len(groups) == 1 or sum(groups) + time_bar._GAP * (len(groups) - 1) <= room
    assert time_bar.height(width, scale) >= time_bar.height(2 * width, scale)
