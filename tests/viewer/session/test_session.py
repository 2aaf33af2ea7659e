import time
from dataclasses import replace

import numpy as np
import pytest

from abfm import FunctionError, Parameters
from abfm.outcome import Outcome
from abfm.pages.front import Front
from abfm_viewer.document.document import Channel, Surface, View, Viewpoint
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.session.editor import UNDO_STEPS_MAX, Editor
from abfm_viewer.session.player import SECONDS, Player
from abfm_viewer.session.session import Session
from tests.messages import check_message
from tests.shapes import torus
from tests.viewer.sessions import EGG, PAIR, QUICK, SPHERE, matched, ready, until

TORUS = torus(24, 12)


@pytest.fixture
def fresh():
    session = Session(SPHERE, "sphere")
    yield session
    session.close()


def test_new_mesh_gets_default_functions(fresh):
    assert "chosen" in fresh.obstacle
    fresh.match()
    assert not fresh.solver.running
    assert "chosen" in fresh.notices.latest.text
    ready(fresh)
    assert {fresh.values(side).shape for side in ("source", "target")} == {(len(SPHERE.vertices),)}
    assert (fresh.editor.undo_label, fresh.saves.unsaved) == ("", False)


def test_functions_with_errors_prevent_a_match(session):
    session.editor.set_spec("source", "gaussian:vertex=100000,width=0.1")
    assert "computed" in session.obstacle
    until(lambda: "computed" not in session.obstacle, session)
    assert "100000" in session.obstacle
    assert session.work.error("source") in session.obstacle
    session.match()
    assert not session.solver.running
    assert session.notices.latest.is_error
    session.undo()
    ready(session)
    session.editor.set_mask("indicator:vertex=100000,radius=1")
    until(lambda: session.work.error("mask"), session)
    assert session.obstacle
    with pytest.raises(FunctionError):
        session.editor.set_mask("no such family:")
    assert session.document.mask == "indicator:vertex=100000,radius=1"


def test_invalid_masks_and_extreme_functions_are_refused(session):
    for mask in ("expression:0*x", "coordinate:x"):
        session.editor.set_mask(mask)
        until(lambda: "computed" not in session.obstacle, session)
        check_message(session.obstacle)
        session.editor.set_mask("expression:x*x")
        ready(session)
    for factor in ("1e300", "1e-40"):
        session.editor.set_spec("source", f"expression:{factor}*x")
        until(lambda: "1e+30" in session.obstacle, session)
        session.undo()
        ready(session)


def test_new_mesh_starts_with_default_parameters_and_view(fresh):
    wanted = replace(fresh.view, theme="dark", error=True, streaks=True, part="commuting")
    fresh.editor.amend(parameters=Parameters(sigma=0.5, tau=2.0), view=wanted)
    fresh.set_mesh(TORUS, "torus")
    assert fresh.parameters == Parameters()
    assert fresh.view == View(theme="dark")
    fresh.undo()
    assert (fresh.parameters.sigma, fresh.view) == (0.5, wanted)
    fresh.set_surfaces(fresh.surface(), Surface(TORUS, "torus"))  # a second one keeps both
    assert (fresh.parameters.sigma, fresh.view.streaks) == (0.5, True)


def test_values_of_one_mesh_are_never_shown_on_another(fresh):
    coordinates = (Channel("coordinate:x", "coordinate:y"),)
    fresh.editor.change("start", channels=coordinates)
    ready(fresh)
    fresh.set_mesh(TORUS, "torus")
    fresh.editor.change("same functions", channels=coordinates)
    for _ in range(100):
        fresh.update()
        values = fresh.values("source")
        assert values is None or len(values) == len(TORUS.vertices)
    ready(fresh)
    for _ in range(2):
        fresh.undo()
    fresh.update()
    assert fresh.surface().mesh is SPHERE
    assert len(fresh.values("source")) == len(SPHERE.vertices)


def test_changes_that_make_a_result_outdated(session, monkeypatch):
    matched(session)
    for change in (
        lambda: session.editor.set_parameter(alpha=0.5),
        lambda: session.editor.set_spec("source", "coordinate:x"),
        lambda: session.editor.set_spec("target", "coordinate:x"),
        lambda: session.editor.set_weight(2.0),
        lambda: session.editor.set_mask("expression:x * x"),
        lambda: session.editor.duplicate_channel(),
        lambda: session.editor.swap_channel(),
    ):
        change()
        ready(session)
        assert session.outdated
        session.undo()
        ready(session)
        assert not session.outdated
    session.set_time(0.2)
    session.editor.set_view("darken", theme="dark")
    session.editor.set_spec("source", PAIR.source + " ")  # an equal spec changes nothing
    ready(session)
    assert not session.outdated
    monkeypatch.setattr(np, "array_equal", lambda *_: pytest.fail("asking compares in each frame"))
    for _ in range(10):
        session.update()
        assert not session.outdated


def test_masked_and_weighted_result_is_not_outdated(session):
    session.editor.set_mask("expression:1 + x * x")
    session.editor.set_weight(3.0)
    ready(session)
    matched(session)
    assert not session.outdated
    session.editor.set_mask("")
    assert session.outdated


def test_parameters_are_set_together_as_one_step(session):
    session.editor.set_parameter(label="preset", tau=2.0, alpha=1.0)
    assert session.editor.undo_label == "preset"
    session.editor.reset_parameters()
    assert session.parameters == Parameters()
    session.undo()
    session.undo()
    assert session.parameters == QUICK


def test_notices_disappear(session, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])

    def after(seconds):
        now[0] += seconds
        session.update()
        return session.notices.latest

    session.notices.show("saved\n here")
    assert session.notices.latest.text == after(0).text == "saved here"
    assert after(7).text == ""
    session.notices.show("it failed", is_error=True)
    assert after(7).is_error
    assert after(6).text == ""
    session.notices.show("it failed", is_error=True)
    session.editor.set_parameter(alpha=0.3)  # the next action removes it
    assert after(0).text == ""
    for number in range(1000):  # unread messages do not accumulate
        session.notices.show(f"problem {number}", is_error=True)
    assert len(session.notices.cards) <= 50
    assert session.notices.cards[0].text == "problem 999"


def test_channels_without_weight_prevent_a_match(session):
    session.editor.amend(channels=(replace(session.active, weight=0.0),))
    check_message(session.obstacle, 0)
    session.editor.amend(channels=(PAIR,))
    session.editor.add_channel()
    session.editor.select(channel=0)
    session.editor.set_weight(0)
    session.editor.select(channel=1)
    session.editor.remove_channel()
    assert [channel.weight for channel in session.channels] == [1]
    session.undo()
    assert [channel.weight for channel in session.channels] == [0, 1]


@pytest.fixture
def editor():
    return Editor(MatchDocument((Surface(SPHERE, "sphere"),)))


def move(editor, time, merge="", label="move"):
    editor.go_to(replace(editor.document, time=time), label, merge)


def look(editor, **view):
    return replace(editor.document, view=replace(editor.document.view, **view))


def test_undo_and_redo_reach_both_ends_of_the_history(editor):
    start = editor.document
    for moment in (1.0, 2.0, 3.0):
        move(editor, moment, label=f"move to {moment:g}")
    assert editor.undo_label == "move to 3"
    for _ in range(4):  # undo without steps does nothing
        editor.undo()
    assert editor.document is start
    assert (editor.undo_label, editor.redo_label) == ("", "move to 1")
    for _ in range(4):
        editor.redo()
    assert editor.document.time == 3
    assert (editor.undo_label, editor.redo_label) == ("move to 3", "")
    for number in range(UNDO_STEPS_MAX + 10):  # only the latest steps are stored
        move(editor, number + 1)
    for _ in range(UNDO_STEPS_MAX + 10):
        editor.undo()
    assert editor.document.time == 10


@pytest.mark.parametrize("between", ["seal", "undo and redo", "another step"])
def test_actions_between_two_drags_separate_their_steps(editor, between):
    editor.seal()  # without a step this has no effect
    move(editor, 0.1, "time")
    if between == "seal":
        editor.seal()
    elif between == "another step":
        editor.go_to(replace(editor.document, mask="coordinate:x"), "mask")
    else:
        editor.undo()
        editor.redo()
    document = editor.document
    move(editor, 0.2, "time")
    editor.undo()
    assert editor.document is document
    assert document.time == 0.1


def test_drag_is_one_step_and_amending_is_none(editor):
    start = editor.document
    for moment in (0.1, 0.2, 0.3):
        move(editor, moment, "time")
    editor.undo()
    assert editor.document is start
    editor.redo()
    assert editor.document.time == 0.3
    moves = editor.action_count
    editor.amend(time=1.5)
    assert editor.action_count == moves
    editor.undo()
    assert editor.document is start
    move(editor, 2)
    assert editor.redo_label == ""
    editor.redo()
    assert editor.document.time == 2


def test_undo_keeps_the_viewpoint(editor):
    front, side, above = (Viewpoint(Front(tuple(axis), (0.0, 0.0, 1.0))) for axis in np.eye(3))
    move(editor, 1)
    editor.document = look(editor, viewpoint=front, enlarged="source")
    editor.undo()
    view = editor.document.view
    assert (editor.document.time, view.viewpoint, view.enlarged) == (0, front, "source")
    editor.redo()
    editor.go_to(look(editor, viewpoint=side), "look from the side")
    editor.document = look(editor, viewpoint=above)
    editor.undo()
    assert editor.document.view.viewpoint == front
    editor.redo()
    assert editor.document.view.viewpoint == above
    ball = MatchDocument((Surface(EGG, "egg"),))
    editor.go_to(ball, "open egg")
    editor.undo()
    assert editor.document.view.viewpoint == above
    editor.redo()
    assert editor.document is ball


TAU, END = 2.0, 4.0
FRAME = 1 / 20


def playing(repeat="loop", beyond=False, speed=1.0):
    player = Player()
    player.repeat, player.beyond, player.speed = repeat, beyond, speed
    player.toggle()
    return player


def next_time(player, time, seconds=FRAME):
    return player.advance(time, seconds, TAU, END)


def played(player, time, seconds):
    """Return the shown times over some seconds, until playing stops."""
    times = [time]
    for _ in range(round(seconds / FRAME)):
        if player.playing:
            times.append(next_time(player, times[-1]))
    return times


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_the_speed_is_in_units_of_tau_per_four_seconds(speed):
    times = played(playing(speed=speed), 0.0, 0.5 * SECONDS / speed)
    assert times[-1] == pytest.approx(TAU / 2)


def test_playing_once_stops_at_the_end_and_restarts():
    player = playing("once")
    times = played(player, 0.0, 2 * SECONDS)
    assert (player.playing, times[-1], max(times)) == (False, TAU, TAU)
    player.toggle()
    assert next_time(player, TAU) == 0
    assert player.playing
    assert next_time(player, 0.0) > 0
    assert played(playing("once", beyond=True), 0.0, 3 * SECONDS)[-1] == END


def test_looped_times_never_leave_their_range():
    times = played(playing("loop"), 0.0, 3 * SECONDS)
    assert min(times) == 0
    assert max(times) <= TAU
    assert times.count(0.0) >= 3
    assert next_time(playing(), 0.0, 30.0) < 0.05 * TAU  # a long frame does not jump
    assert next_time(playing("ping-pong"), 1.5 * TAU) == 0


def test_ping_pong_reverses_at_both_ends():
    player = playing("ping-pong")
    times = played(player, 0.0, 3 * SECONDS)
    assert (times.count(TAU), times.count(0.0)) == (1, 2)
    back = times[times.index(TAU) : times.index(0.0, 1) + 1]
    assert back == sorted(set(back), reverse=True)
    player = playing("ping-pong")
    played(player, TAU - 0.01, 2 * FRAME)
    assert next_time(player, 1.0) < 1
    player.repeat = "loop"
    assert next_time(player, 1.0) > 1


def test_constant_target_is_reported_before_the_match(session):
    session.editor.set_spec("target", "expression:2")
    ready(session)
    until(lambda: session.work.expected_facts, session)
    assert session.work.expected_facts.outcome is Outcome.IMPOSSIBLE
    assert session.scaled_channels("source") == session.channels


def test_theme_belongs_to_no_document_and_no_step_of_undo(fresh):
    session = fresh
    session.editor.set_view("flat", flat=True)
    session.set_appearance(theme="dark", ui_scale=1.5)
    session.undo()
    assert (session.view.flat, session.view.theme) == (False, "dark")
    session.restore(MatchDocument((Surface(SPHERE, "other"),)), {}, None)
    assert session.view.appearance == {"theme": "dark", "ui_scale": 1.5}
    session.set_appearance(theme="light")
    session.undo()
    assert session.view.appearance == {"theme": "light", "ui_scale": 1.5}
