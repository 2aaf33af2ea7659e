"""Pages of sequences: frames, interpolated frames, arrows, path lines and critical points."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import abfm
from abfm.display import ViewSpec
from abfm.matching.judging.verdict import Verdict
from abfm.outcome import Outcome
from abfm.pages import Labels, Page, Panel, front_of, sequence_page
from abfm.pages.sequence_motion import OPACITY_MIN, fast_speed_of
from abfm.pages.sequence_pages import PLAY_SECONDS_MAX, PLAY_SECONDS_MIN, clock_of, frame_layers
from tests.messages import check_message
from tests.shapes import icosphere

COUNT = 5


@pytest.fixture(scope="module")
def sequence():
    """Return a bump that rotates about the axis z by 10 degrees in each interval."""
    mesh = icosphere(3)
    angles = np.radians(10.0 * np.arange(COUNT))
    middles = np.stack([np.cos(angles), np.sin(angles), np.zeros(COUNT)], axis=1)
    frames = np.exp(4 * (middles @ mesh.vertices.T - 1))
    return abfm.sequence(mesh, frames, 0.1 * np.arange(COUNT))


@pytest.fixture(scope="module")
def page(sequence):
    return sequence_page(sequence, "a bump", Labels(["potential"], "mV", "s", ViewSpec(up="z")))


def test_colors_are_frames_and_interpolated_frames(sequence, page):
    layer = page.panels[0].layers[0]
    assert (layer.name, layer.unit, page.clock.unit) == ("potential", "mV", "s")
    assert len(layer.times) == 4 * (COUNT - 1) + 1
    np.testing.assert_allclose(layer.values[::4], sequence.frames[:, :, 0], atol=1e-12)
    between = 7
    interpolated = sequence.at(float(layer.times[between]))
    np.testing.assert_allclose(layer.values[between], interpolated, atol=1e-12)


def test_other_layers_are_divergence_and_curl(sequence, page):
    """Divergence and curl are further layers, at the midpoints of intervals."""
    names = [layer.name for layer in page.panels[0].layers]
    assert names == ["potential", "divergence", "curl"]
    for layer, values in zip(
        page.panels[0].layers[1:], [sequence.divergence, sequence.curl], strict=True
    ):
        np.testing.assert_array_equal(layer.values, values)
        np.testing.assert_array_equal(layer.times, sequence.middles)
        assert (layer.colors.low, layer.unit) == (-layer.colors.high, "1/s")


def test_arrows_show_the_field_of_each_interval(sequence, page):
    paths = page.panels[0].paths[0]
    assert (paths.name, paths.shown, paths.disc, paths.line) == ("arrows", True, 0.0, 0.0)
    [note] = page.notes
    check_message(note, "arrows")
    places = abfm.maps.spread_points(sequence.mesh).points[np.arange(480)]
    fast = fast_speed_of(sequence)
    for interval, velocity in enumerate(sequence.velocity):
        in_interval = paths.times[:, 0] == sequence.times[interval]
        along = paths.ends[in_interval] - paths.starts[in_interval]
        middles = (paths.starts[in_interval] + paths.ends[in_interval]) / 2
        distances = np.linalg.norm(middles[:, None] - places.positions, axis=2)
        which, lengths = distances.argmin(axis=1), np.linalg.norm(along, axis=1)
        assert len(set(which)) == len(which) > 20
        assert distances.min(axis=1).max() < 0.1 * lengths.max()  # arrows are chords of the sphere
        field = abfm.flow.vectors_at(sequence.mesh, velocity, places)
        speed = np.linalg.norm(field, axis=1)
        cosines = (along * field[which]).sum(axis=1) / (lengths * speed[which])
        assert cosines.min() > 0.99
        relative = np.minimum(speed / fast, 1)
        np.testing.assert_allclose(lengths / lengths.max(), relative[which], atol=0.02)
        assert relative[which].min() > 0.2
        determined = sequence.determined[interval][places.faces]
        np.testing.assert_array_equal(paths.opacities[in_interval], determined[which])
        expected = (relative > 0.21) & (determined > OPACITY_MIN)
        assert expected.sum() == (relative[which] > 0.21).sum()  # the sphere has no boundary
        np.testing.assert_allclose(np.linalg.norm(paths.starts[in_interval], axis=1), 1, atol=0.01)
    gaps = abfm.maps.spread_points(sequence.mesh).gaps[479] * sequence.mesh.length_scale
    assert lengths.max() < gaps
    assert set(map(tuple, paths.times)) == set(pairwise(sequence.times))


def test_path_lines_follow_the_flow(sequence, page):
    paths = page.panels[0].paths[1]
    assert (paths.name, paths.shown) == ("path lines", False)
    per = len(paths.starts) // (COUNT - 1)
    starts, ends = (each.reshape(COUNT - 1, per, 3) for each in (paths.starts, paths.ends))
    np.testing.assert_array_equal(paths.times.reshape(COUNT - 1, per, 2)[2, 0], sequence.times[2:4])
    is_new = np.linalg.norm(starts[1:] - ends[:-1], axis=2) > 1e-12
    assert 0.2 < is_new.mean() * 3 < 0.6  # one in ten restarts in each interval
    np.testing.assert_allclose(np.linalg.norm(ends, axis=2), 1.0, atol=0.02)
    first = abfm.maps.project_onto_surface(sequence.mesh, starts[0])
    expected = sequence.paths(first)[1].positions
    assert np.linalg.norm(expected - starts[0], axis=1).max() > 0.1
    assert np.linalg.norm(ends[0] - expected, axis=1).max() < 0.02


def test_tracks_equal_those_of_critical_points(sequence, page):
    drawn = {paths.name: paths for paths in page.panels[0].paths[2:]}
    tracks = sequence.tracks()
    assert set(drawn) == {f"{track.kind}s" for track in tracks}
    for name, paths in drawn.items():
        same_kind = [track for track in tracks if f"{track.kind}s" == name]
        duration = sum(np.ptp(track.times) for track in same_kind)
        assert np.ptp(paths.times, axis=1).sum() == pytest.approx(duration)
        for track in same_kind:
            distances = np.linalg.norm(paths.starts[:, None] - track.points.positions[:-1], axis=2)
            assert distances.min(axis=0).max() < 1e-9
        steps = np.linalg.norm(paths.ends - paths.starts, axis=1)
        assert steps.max() < 0.03 * sequence.mesh.length_scale


def test_time_bar_reports_every_interval(sequence, page):
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


def test_unknown_part_of_the_surface_is_noted(sequence):
    mesh = sequence.mesh
    frames = np.where(mesh.vertices[:, 2] < -0.5, np.nan, sequence.frames[:2, :, 0])
    masked = abfm.sequence(mesh, frames, parameters=abfm.sequences.defaults(sigma=0.3))
    page = sequence_page(masked, "a bump", Labels())
    is_grey = np.isnan(page.panels[0].layers[0].values)
    missing = ~np.isfinite(frames).all(axis=0)
    assert missing.any()
    np.testing.assert_array_equal(is_grey, np.broadcast_to(missing, is_grey.shape))
    notes = page.notes
    check_message(notes[1])
    share = notes[1].partition("%")[0]
    assert float(share) == pytest.approx(25, abs=2)  # the area of a spherical cap


def test_constant_sequence_has_no_arrows():
    still = abfm.sequence(FramePair.mesh, np.repeat(FramePair.mesh.vertices[None, :, 0], 3, axis=0))
    page = sequence_page(still, "still")
    (note,) = page.notes
    check_message(note)
    assert len(page.panels[0].paths[0].starts) == 0
    assert note.capitalize() in page.html()


class FramePair:
    mesh, times, unknown = icosphere(2), np.array([0.0, 1.0]), None

    def __init__(self, frames):
        self.frames = frames.reshape(*frames.shape[:2], -1)

    def at(self, t):
        return np.mean(self.frames, axis=0)


def test_missing_values_do_not_change_colors():
    frames = np.stack([FramePair.mesh.vertices[:, 0], FramePair.mesh.vertices[:, 1]])
    holes = frames.copy()
    holes[:, np.abs(frames).max(axis=0) < 0.3] = np.nan
    holes[1, np.argmin(np.abs(frames[1]))] = np.inf
    [complete], [layer], [nothing] = (
        frame_layers(FramePair(each), Labels())[0]
        for each in (frames, holes, np.full_like(frames, np.nan))
    )
    assert layer.colors == complete.colors
    assert np.isnan(layer.values).any()
    page = Page("t", "h", [Panel("", FramePair.mesh, [layer], front_of(FramePair.mesh))])
    assert "NaN" not in page.html().split('id="page"')[1].split("</script>")[0]
    assert nothing.colors.low < nothing.colors.high


def test_omitted_channels_are_noted():
    frames = np.stack([FramePair.mesh.vertices] * 2)
    for times, expected in ((1, []), (2, ["the page shows the first 4 of 6 channels"])):
        assert frame_layers(FramePair(np.tile(frames, (1, 1, times))), Labels())[1] == expected


@pytest.mark.parametrize(
    ("frames", "seconds"), [(2, PLAY_SECONDS_MIN), (100, 15.0), (300, PLAY_SECONDS_MAX)]
)
def test_play_time_depends_on_the_number_of_frames(frames, seconds):
    assert (PLAY_SECONDS_MIN, PLAY_SECONDS_MAX) == (4.0, 30.0)
    assert clock_of(list(range(frames)), Labels()).seconds == pytest.approx(seconds)


def test_half_confirmed_sequence_is_a_warning(sequence):
    kinds = (Outcome.MATCHED, Outcome.NOT_REACHED) * 2
    verdicts = tuple(Verdict(kind, "", "") for kind in kinds)
    half = replace(sequence, verdicts=verdicts)
    page = sequence_page(half, "half")
    assert half.facts.outcome.is_good
    assert page.tone == half.facts.tone == "warning"
    assert [span.tone for span in page.clock.spans] == ["good", "failure"] * 2
