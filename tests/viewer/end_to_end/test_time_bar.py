import numpy as np
import polyscope.imgui as imgui
import pytest

from abfm_viewer.panels import time_bar
from tests.messages import check_message


def shown(gui):
    """Return the advected function at the shown time, when it is exact."""
    gui.wait(lambda _: gui.window.shown.flow.settled)
    gui.wait(lambda _: not gui.window.shown.busy)
    return gui.window.shown.flow.advected().copy()


def test_tour_of_the_time_bar(matched, walk):
    walk(matched, scrub_to_the_match_and_beyond, step_and_play, show_the_complete_time_bar)


def scrub_to_the_match_and_beyond(matched):
    session = matched.session
    source, result = session.values("source"), session.result
    matched.click("to start")
    assert session.time == 0
    np.testing.assert_allclose(shown(matched), source, atol=1e-12)
    matched.drag("time", 0.5)
    halfway = shown(matched)
    assert np.abs(halfway - source).max() > 0.01
    np.testing.assert_allclose(halfway, result.advect(session.time)[:, 0], atol=1e-6)
    matched.type("time", "1")
    np.testing.assert_allclose(shown(matched), result.advected[:, 0])
    matched.type("time", "2")
    np.testing.assert_allclose(shown(matched), result.advect(2.0)[:, 0], atol=1e-6)
    matched.frames(2)
    paints = matched.window.scene.paints
    assert paints["advected"].title.startswith("advected, extrapolated")
    assert "extrapolated" not in paints["target"].title


def step_and_play(matched):
    """Drag, type and step the time, and play it once or repeatedly."""
    session = matched.session
    for act, time in (
        (lambda: matched.drag("time", 0.3), 0.3),
        (lambda: matched.drag("time", 1.4), 1.4),
        (lambda: matched.key("ctrl+z"), 0.3),  # dragging the time is one step of undo
        (lambda: matched.key("ctrl+z"), 1),
        (lambda: matched.key("ctrl+shift+z"), 0.3),
    ):
        act()
        assert session.time == pytest.approx(time, abs=0.01)
    matched.type("time", "1")
    for text in ("soon", "nan", "inf"):
        matched.type("time", text)
        check_message(session.notices.latest.text, text)
        assert session.time == 1
    clicks = [(matched.click, label, time) for label, time in (("<", 0.95), (">", 1), (">", 1.05))]
    keys = ("left", 1), ("home", 0), ("right", 0.05), ("end", 1)
    for act, what, time in (*clicks, *((matched.key, key, time) for key, time in keys)):
        act(what)
        assert session.time == pytest.approx(time)
    matched.type("time", "99")
    assert session.time == 2
    player = matched.session.player
    matched.drag("speed", 4.0)
    assert player.speed == pytest.approx(4)
    matched.choose("repeat", "ping-pong")
    matched.type("time", "0.9")
    matched.click("Play")
    matched.wait(lambda s: s.time > 0.95)
    matched.wait(lambda s: s.time < 0.8)
    matched.click("Pause", within="time bar")
    assert not player.playing
    matched.choose("repeat", "loop")
    matched.type("time", "0.9")
    matched.key("space")
    matched.wait(lambda s: s.time < 0.5)
    matched.key("space")
    matched.choose("repeat", "once")
    matched.check("beyond τ")
    matched.type("time", "1.8")
    matched.click("Play")
    matched.wait(lambda s: not s.player.playing)
    assert matched.session.time == 2


def show_the_complete_time_bar(matched, monkeypatch):
    alphas, places, shown = [], [], []
    slider = imgui.SliderFloat
    frames = (imgui.ImGuiCol_FrameBg, imgui.ImGuiCol_FrameBgHovered, imgui.ImGuiCol_FrameBgActive)

    def recorded(label, *options):
        if label == "##time slider":
            alphas.extend(imgui.GetStyleColorVec4(color)[3] for color in frames)
        return slider(label, *options)

    monkeypatch.setattr(imgui, "SliderFloat", recorded)
    monkeypatch.setattr(imgui, "SetNextWindowPos", lambda *place: places.append(place))
    monkeypatch.setattr(imgui, "BeginTooltip", lambda: shown.append(True))
    monkeypatch.setattr(imgui, "EndTooltip", lambda: None)
    left, top, right, bottom = matched.search.find("time", kinds=("slider",)).rect
    matched.input.move((left + right) / 2, (top + bottom) / 2)
    matched.frames(40)
    assert shown
    assert set(alphas) == {0}
    assert any(place[0][1] < top - 20 for place in places)  # above the time bar
    matched.input.press()
    matched.input.move(left + 0.3 * (right - left), (top + bottom) / 2)
    shown.clear()
    matched.frames(40)
    assert not shown
    matched.input.release()


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize("width", [200, 420, 560, 900, 2180])
def test_time_bar_has_few_rows(scale, width):
    rows, groups = time_bar.rows(width / scale), time_bar.groups(width / scale)
    assert rows == sorted(rows)
    for row in set(rows):
        own = [needed for at, needed in zip(rows, groups, strict=True) if at == row]
        room = width / scale - time_bar.PADDING
        assert len(own) == 1 or sum(own) + time_bar.GAP * (len(own) - 1) <= room
    assert time_bar.height(width, scale) >= time_bar.height(2 * width, scale)
