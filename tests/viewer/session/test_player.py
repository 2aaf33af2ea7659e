"""Playing the time bar, frame by frame."""

import pytest

from abfm_viewer.session.player import SECONDS, Player

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
    """Times shown over some seconds, until it stops."""
    times = [time]
    for _ in range(round(seconds / FRAME)):
        if player.playing:
            times.append(next_time(player, times[-1]))
    return times


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_the_speed_is_in_units_of_tau_per_four_seconds(speed):
    times = played(playing(speed=speed), 0.0, 0.5 * SECONDS / speed)
    assert times[-1] == pytest.approx(TAU / 2)


def test_once_stops_at_the_end_and_plays_again_from_the_start():
    player = playing("once")
    times = played(player, 0.0, 2 * SECONDS)
    assert (player.playing, times[-1], max(times)) == (False, TAU, TAU)
    player.toggle()
    assert next_time(player, TAU) == 0
    assert player.playing
    assert next_time(player, 0.0) > 0
    assert played(playing("once", beyond=True), 0.0, 3 * SECONDS)[-1] == END


def test_a_loop_begins_again_and_never_leaves_the_range():
    times = played(playing("loop"), 0.0, 3 * SECONDS)
    assert min(times) == 0
    assert max(times) <= TAU
    assert times.count(0.0) >= 3


def test_ping_pong_turns_at_both_ends_and_another_way_to_repeat_goes_forward_again():
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


def test_a_hang_is_no_leap_and_a_time_beyond_the_end_starts_again():
    assert next_time(playing(), 0.0, 30.0) < 0.05 * TAU
    assert next_time(playing("ping-pong"), 1.5 * TAU) == 0
