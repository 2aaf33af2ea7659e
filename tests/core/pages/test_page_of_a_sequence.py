"""The page of a sequence: frames, what is carried between them, path lines, critical points."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import abfm
from abfm.matching.judging.verdict import Verdict
from abfm.outcome import Outcome
from abfm.pages import Labels, Page, Panel, best_front, sequence_page
from abfm.pages.sequence_motion import OPACITY_MIN, fast_speed_of
from abfm.pages.sequence_pages import PLAY_SECONDS_MAX, PLAY_SECONDS_MIN, clock_of, frame_layers
from tests.messages import check_message
from tests.shapes import icosphere

COUNT = 5


@pytest.fixture(scope="module")
def sequence():
    """A bump that turns about the axis z by 10 degrees a frame."""
    mesh = icosphere(3)
    angles = np.radians(10.0 * np.arange(COUNT))
    middles = np.stack([np.cos(angles), np.sin(angles), np.zeros(COUNT)], axis=1)
    frames = np.exp(4 * (middles @ mesh.vertices.T - 1))
    return abfm.sequence(mesh, frames, 0.1 * np.arange(COUNT))


@pytest.fixture(scope="module")
def page(sequence):
    return sequence_page(sequence, "a bump", Labels(["potential"], "mV", "s", "z"))


def test_its_colours_are_the_frames_and_what_is_carried_between_them(sequence, page):
    layer = page.panels[0].layers[0]
    assert (layer.name, layer.unit, page.clock.unit) == ("potential", "mV", "s")
    assert len(layer.times) == 4 * (COUNT - 1) + 1
    np.testing.assert_allclose(layer.values[::4], sequence.frames[:, :, 0], atol=1e-12)
    between = 7
    carried = sequence.at(float(layer.times[between]))
    np.testing.assert_allclose(layer.values[between], carried, atol=1e-12)


def test_its_other_layers_are_parts_of_the_field_at_the_middles_of_intervals(sequence, page):
    names = [layer.name for layer in page.panels[0].layers]
    assert names == ["potential", "divergence", "curl"]
    for layer, values in zip(
        page.panels[0].layers[1:], [sequence.divergence, sequence.curl], strict=True
    ):
        np.testing.assert_array_equal(layer.values, values)
        np.testing.assert_array_equal(layer.times, sequence.middles)
        assert (layer.colors.low, layer.unit) == (-layer.colors.high, "1/s")


def test_arrows_are_the_field_of_each_interval_on_the_surface(sequence, page):
    ways = page.panels[0].paths[0]
    assert (ways.name, ways.shown, ways.disc, ways.line) == ("arrows", True, 0.0, 0.0)
    [note] = page.notes
    check_message(note, "arrows")
    places = abfm.maps.spread_points(sequence.mesh).points[np.arange(480)]
    fast = fast_speed_of(sequence)
    for interval, velocity in enumerate(sequence.velocity):
        mine = ways.times[:, 0] == sequence.times[interval]
        along = ways.ends[mine] - ways.starts[mine]
        middles = (ways.starts[mine] + ways.ends[mine]) / 2
        apart = np.linalg.norm(middles[:, None] - places.positions, axis=2)
        which, lengths = apart.argmin(axis=1), np.linalg.norm(along, axis=1)
        assert len(set(which)) == len(which) > 20
        assert apart.min(axis=1).max() < 0.1 * lengths.max()  # chords of a ball
        field = abfm.flow.vectors_at(sequence.mesh, velocity, places)
        speed = np.linalg.norm(field, axis=1)
        cosines = (along * field[which]).sum(axis=1) / (lengths * speed[which])
        assert cosines.min() > 0.99
        relative = np.minimum(speed / fast, 1)
        np.testing.assert_allclose(lengths / lengths.max(), relative[which], atol=0.02)
        assert relative[which].min() > 0.2
        determined = sequence.determined[interval][places.faces]
        np.testing.assert_array_equal(ways.opacities[mine], determined[which])
        expected = (relative > 0.21) & (determined > OPACITY_MIN)
        assert expected.sum() == (relative[which] > 0.21).sum()  # the ball has no edge
        np.testing.assert_allclose(np.linalg.norm(ways.starts[mine], axis=1), 1, atol=0.01)
    gaps = abfm.maps.spread_points(sequence.mesh).gaps[479] * sequence.mesh.length_scale
    assert lengths.max() < gaps
    assert set(map(tuple, ways.times)) == set(pairwise(sequence.times))


def test_path_lines_go_on_about_as_the_sequence_carries_points(sequence, page):
    ways = page.panels[0].paths[1]
    assert (ways.name, ways.shown) == ("path lines", False)
    per = len(ways.starts) // (COUNT - 1)
    starts, ends = (each.reshape(COUNT - 1, per, 3) for each in (ways.starts, ways.ends))
    np.testing.assert_array_equal(ways.times.reshape(COUNT - 1, per, 2)[2, 0], sequence.times[2:4])
    is_new = np.linalg.norm(starts[1:] - ends[:-1], axis=2) > 1e-12
    assert 0.2 < is_new.mean() * 3 < 0.6  # one in ten of each
    np.testing.assert_allclose(np.linalg.norm(ends, axis=2), 1.0, atol=0.02)
    first = abfm.maps.project_onto_surface(sequence.mesh, starts[0])
    there = sequence.paths(first)[1].positions
    assert np.linalg.norm(there - starts[0], axis=1).max() > 0.1
    assert np.linalg.norm(ends[0] - there, axis=1).max() < 0.02


def test_tracks_are_those_of_critical_points(sequence, page):
    drawn = {ways.name: ways for ways in page.panels[0].paths[2:]}
    tracks = sequence.tracks()
    assert set(drawn) == {f"{track.kind}s" for track in tracks}
    for name, ways in drawn.items():
        own = [track for track in tracks if f"{track.kind}s" == name]
        gone = sum(np.ptp(track.times) for track in own)
        assert np.ptp(ways.times, axis=1).sum() == pytest.approx(gone)
        for track in own:
            away = np.linalg.norm(ways.starts[:, None] - track.points.positions[:-1], axis=2)
            assert away.min(axis=0).max() < 1e-9
        steps = np.linalg.norm(ways.ends - ways.starts, axis=1)
        assert steps.max() < 0.03 * sequence.mesh.length_scale


def test_every_interval_is_told_on_the_bar(sequence, page):
    assert (page.headline, page.tone) == (sequence.facts.headline, "good")
    assert f"{sequence.confirmed} of 4 intervals" in page.headline
    spans = page.clock.spans
    assert [(span.start, span.end) for span in spans] == list(
        zip(sequence.times[:-1], sequence.times[1:], strict=True)
    )
    for number, (span, verdict) in enumerate(zip(spans, sequence.verdicts, strict=True), 1):
        check_message(span.text, f"interval {number}", verdict.kind)
    json.dumps(page.clock.ticks)
    assert f"{COUNT} frames on a surface of {len(sequence.mesh.vertices)} vertices" in page.about
    assert "a bump" in page.html()


def test_what_is_not_compared_is_told(sequence):
    mesh = sequence.mesh
    frames = np.where(mesh.vertices[:, 2] < -0.5, np.nan, sequence.frames[:2, :, 0])
    masked = abfm.sequence(mesh, frames, parameters=abfm.sequences.defaults(sigma=0.3))
    page = sequence_page(masked, "a bump", Labels())
    lacking = np.isnan(page.panels[0].layers[0].values)
    missing = ~np.isfinite(frames).all(axis=0)
    assert missing.any()
    np.testing.assert_array_equal(lacking, np.broadcast_to(missing, lacking.shape))
    notes = page.notes
    check_message(notes[1])
    share = notes[1].partition("%")[0]
    assert float(share) == pytest.approx(25, abs=2)  # Archimedes' hat box


def test_a_film_in_which_nothing_moves_says_so():
    still = abfm.sequence(Film.mesh, np.repeat(Film.mesh.vertices[None, :, 0], 3, axis=0))
    page = sequence_page(still, "still")
    (note,) = page.notes
    check_message(note)
    assert len(page.panels[0].paths[0].starts) == 0
    assert note.capitalize() in page.html()


class Film:
    """Two frames of what nobody solved, blended between them."""

    mesh, times, unknown = icosphere(2), np.array([0.0, 1.0]), None

    def __init__(self, frames):
        self.frames = frames.reshape(*frames.shape[:2], -1)

    def at(self, t):
        return np.mean(self.frames, axis=0)


def test_values_that_are_missing_change_no_colours():
    frames = np.stack([Film.mesh.vertices[:, 0], Film.mesh.vertices[:, 1]])
    holes = frames.copy()
    holes[:, np.abs(frames).max(axis=0) < 0.3] = np.nan
    holes[1, np.argmin(np.abs(frames[1]))] = np.inf
    [whole], [layer], [nothing] = (
        frame_layers(Film(each), Labels())[0]
        for each in (frames, holes, np.full_like(frames, np.nan))
    )
    assert layer.colors == whole.colors
    assert np.isnan(layer.values).any()
    page = Page("t", "h", [Panel("", Film.mesh, [layer], best_front(Film.mesh))])
    assert "NaN" not in page.html().split('id="page"')[1].split("</script>")[0]
    assert nothing.colors.low < nothing.colors.high


def test_channels_beyond_the_first_four_are_told():
    frames = np.stack([Film.mesh.vertices] * 2)
    for times, told in ((1, []), (2, ["the page shows the first 4 of 6 channels"])):
        assert frame_layers(Film(np.tile(frames, (1, 1, times))), Labels())[1] == told


@pytest.mark.parametrize(
    ("frames", "seconds"), [(2, PLAY_SECONDS_MIN), (100, 15.0), (300, PLAY_SECONDS_MAX)]
)
def test_play_seconds(frames, seconds):
    """A page plays for 0.15 s a frame, between 4 s and 30 s."""
    assert (PLAY_SECONDS_MIN, PLAY_SECONDS_MAX) == (4.0, 30.0)
    assert clock_of(list(range(frames)), Labels()).seconds == pytest.approx(seconds)


def test_page_of_half_confirmed_sequence_is_not_red(sequence):
    kinds = (Outcome.MATCHED, Outcome.NOT_REACHED) * 2
    verdicts = tuple(Verdict(kind, "", "") for kind in kinds)
    half = replace(sequence, verdicts=verdicts)
    page = sequence_page(half, "half")
    assert half.facts.outcome.is_good
    assert page.tone == half.facts.tone == "warning"
    assert [span.tone for span in page.clock.spans] == ["good", "failure"] * 2
