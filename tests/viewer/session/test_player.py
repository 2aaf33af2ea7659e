"""Playing the time bar, frame by frame."""

from __future__ import annotations

import pytest

from abfm_viewer.session.player import SECONDS, Player, Repeat

TAU, END = 2.0, 4.0
FRAME = 1 / 20


def playing(repeat: Repeat = "loop", beyond: bool = False, speed: float = 1.0) -> Player:
    player = Player()
    player.repeat, player.beyond, player.speed = repeat, beyond, speed
    player.toggle()
    return player


def played(player: Player, time: float, seconds: float) -> list[float]:
    """Times shown over some seconds, until it stops."""
    times = [time]
    for _ in range(round(seconds / FRAME)):
        if player.playing:
            times.append(player.advance(times[-1], FRAME, TAU, END))
    return times


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_the_speed_is_in_units_of_tau_per_four_seconds(speed):
    times = played(playing(speed=speed), 0.0, 0.5 * SECONDS / speed)
    assert times[-1] == pytest.approx(TAU / 2)


def test_once_stops_at_the_end_and_plays_again_from_the_start():
    player = playing("once")
    times = played(player, 0.0, 2 * SECONDS)
    assert not player.playing
    assert times[-1] == TAU
    assert max(times) == TAU
    player.toggle()
    assert player.advance(TAU, FRAME, TAU, END) == 0
    assert player.playing
    assert player.advance(0.0, FRAME, TAU, END) > 0


def test_a_loop_begins_again_and_never_leaves_the_range():
    times = played(playing("loop"), 0.0, 3 * SECONDS)
    assert min(times) == 0
    assert max(times) <= TAU
    assert times.count(0.0) >= 3


def test_ping_pong_turns_at_both_ends():
    times = played(playing("ping-pong"), 0.0, 3 * SECONDS)
    assert times.count(TAU) == 1
    assert times.count(0.0) == 2
    down = times.index(TAU)
    assert all(
        b < a for a, b in zip(times[down:], times[down + 1 : times.index(0.0, 1)], strict=False)
    )


def test_another_way_to_repeat_while_it_runs_back_goes_forward_again():
    player = playing("ping-pong")
    played(player, TAU - 0.01, 2 * FRAME)
    assert player.advance(1.0, FRAME, TAU, END) < 1
    player.repeat = "loop"
    assert player.advance(1.0, FRAME, TAU, END) > 1


def test_beyond_tau_it_plays_on_to_the_end_of_the_bar():
    assert played(playing("once", beyond=True), 0.0, 3 * SECONDS)[-1] == END


def test_a_hang_is_no_leap():
    assert playing().advance(0.0, 30.0, TAU, END) < 0.05 * TAU


def test_a_time_beyond_the_end_starts_again():
    assert playing("ping-pong").advance(1.5 * TAU, FRAME, TAU, END) == 0
