"""The time bar: playing, stepping, scrubbing."""

from __future__ import annotations

import numpy as np
import pytest


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


def test_a_text_that_is_no_time_is_refused(matched):
    for text in ("soon", "nan", "inf"):
        matched.type("time", text)
        assert matched.session.notice.text == f"time: '{text}' is no number"
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
    matched.check("beyond tau")
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
