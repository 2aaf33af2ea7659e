"""Pictures drawn by OpenGL off the screen."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ImageFont

import abfm
from abfm.io.sheets import Panel, Sheet, Values
from abfm_viewer.appearance.colormaps import color_range, table
from abfm_viewer.appearance.theme import LIGHT
from abfm_viewer.document.verdict_words import headline
from abfm_viewer.pictures.canvas import rgb
from abfm_viewer.pictures.panels import cameras, panel_pictures
from abfm_viewer.pictures.sheets import DEFAULT_WIDTH, grid, match_picture, sheet_picture
from tests.shapes import icosphere

WHITE, BLUE, BLACK, RED = (
    (255, 255, 255),
    (0x24, 0x55, 0xC3),
    (0x11, 0x11, 0x11),
    (0xC6, 0x28, 0x28),
)


@pytest.fixture(scope="module")
def match():
    """A short match of two channels on a sphere: one non-negative, one of both signs."""
    mesh = icosphere(3)
    x, _, z = mesh.vertices.T
    f = np.stack([np.exp(-4 * (1 - x)), x], axis=1)
    g = np.stack([np.exp(-4 * (1 - z)), z], axis=1)
    return abfm.match(mesh, f, g, abfm.Parameters(tau=2, iterations=5))


def draw(mesh, values, size=200):
    """One function, (size, size, 4)."""
    sheet = Sheet(((Panel(mesh, Values(values), ""),),))
    [picture] = panel_pictures(
        sheet, [(size, size)], {"function": color_range(values)}, cameras(sheet, (1.0, 1.0))
    )
    return np.asarray(picture)


def test_a_sphere_is_a_round_patch_on_a_transparent_ground():
    mesh = icosphere(4)
    alpha = draw(mesh, np.ones(len(mesh.vertices)))[..., 3] / 255
    radius = 100 / 1.08
    assert alpha.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    assert alpha[0].max() == 0
    ys, xs = np.nonzero(alpha > 0.5)
    assert (xs.mean(), ys.mean()) == pytest.approx((99.5, 99.5), abs=1)


def test_colours_on_the_surface_are_those_of_the_map():
    mesh = icosphere(4)
    pixels = draw(mesh, np.sign(mesh.vertices[:, 0]))
    solid = pixels[pixels[..., 3] == 255][:, :3] / 255
    for color in table("abfm diverging")[[0, -1]]:
        distance = np.linalg.norm(solid - color, axis=1)
        assert distance.min() < 0.12


def test_one_sheet_shows_source_times_match_and_target(match):
    sheet_of_match = np.asarray(match_picture(match))
    assert sheet_of_match.shape[1] == DEFAULT_WIDTH
    colors = {tuple(color) for color in sheet_of_match.reshape(-1, 3).tolist()}
    assert {WHITE, BLUE, BLACK, RED} <= colors
    assert len(colors) > 1000
    assert (sheet_of_match == 255).all(axis=2).mean() > 0.15


def test_size_times_channel_and_axis_change_the_picture(match):
    usual = np.asarray(match_picture(match, size=(640, 480)))
    assert usual.shape == (480, 640, 3)
    for other in (
        match_picture(match, times=[0.5, 3.5], size=(640, 480)),
        match_picture(match, size=(640, 480), channel=1),
        match_picture(match, size=(640, 480), up="x"),
    ):
        assert other.size == (640, 480)
        assert (np.asarray(other) != usual).any()


@given(
    count=st.integers(1, 12),
    aspect=st.floats(0.2, 5),
    size=st.none() | st.tuples(st.integers(320, 4000), st.integers(240, 3000)),
)
def test_panels_stay_on_the_sheet_and_apart(count, aspect, size):
    layout = grid(count, aspect, size)
    assert layout.width == (DEFAULT_WIDTH if size is None else size[0])
    assert size is None or layout.height == size[1]
    places = [place for row in layout.rows for place in row]
    assert len(places) >= count
    for place in places:
        assert place.left >= 0
        assert place.top >= 0
    # a sheet too small for its panels has no room for labels either
    if places[0].width > 20 and places[0].height > 20:
        assert max(place.left + place.width for place in places) < layout.bars[0][0]
        assert max(place.top + place.height for place in places) < layout.height
        for one, other in pairwise(places):
            assert other.left > one.left + one.width or other.top > one.top + one.height


@pytest.mark.parametrize(("aspect", "columns"), [(0.5, 6), (1.0, 3), (4.0, 2)])
def test_a_sheet_of_free_size_has_pleasant_proportions(aspect, columns):
    layout = grid(6, aspect)
    assert len(layout.rows[0]) == columns
    assert 1 < layout.width / layout.height < 5


def test_panels_have_frames_labels_and_a_colour_bar_beside_them():
    mesh = icosphere(2)
    ones = Values(np.ones(len(mesh.vertices)))
    panels = (Panel(mesh, ones, "first", "source"), Panel(mesh, ones, "second", "target"))
    layout = grid(2, 1.0, (900, 400))
    sheet = Sheet((panels,))
    pixels = np.asarray(sheet_picture(sheet, cameras(sheet), layout, ImageFont.load_default))
    assert pixels.shape == (400, 900, 3)
    [[first, second]] = layout.rows
    for place, color in ((first, BLUE), (second, RED)):
        assert tuple(pixels[place.top, place.left + place.width // 2]) == color
        assert tuple(pixels[place.top + 10, place.left + 10]) == WHITE
        labels = pixels[place.top + place.height + 3 : place.top + place.height + 40]
        assert (labels[:, place.left : place.left + place.width].min(axis=2) < 128).any()
    bar = pixels[:, second.left + second.width + 5 :].reshape(-1, 3)
    for color in np.round(255 * table("abfm sequential", 64)):
        assert np.abs(bar - color).max(axis=1).min() <= 6


@pytest.mark.parametrize(
    ("kind", "tone"), [("matched", LIGHT.good), ("not reached", LIGHT.failure), ("nearly", None)]
)
def test_the_label_at_tau_says_how_well_it_matches_in_the_colour_that_means_it(
    match, kind, tone, monkeypatch
):
    """The word "matched" stands on no picture of a match that is none."""
    drawn = []

    def kept(sheet, *rest):
        drawn.append(sheet)
        return sheet_picture(sheet, *rest)

    monkeypatch.setattr("abfm_viewer.pictures.sheets.sheet_picture", kept)
    judged = replace(match, verdict=replace(match.verdict, kind=kind), stop_reason="converged")
    pixels = np.asarray(match_picture(judged, [1.0], (900, 400)))
    labels = [panel.label for panel in drawn[0].rows[0]]
    assert labels[2:] == [f"t = 2, {headline(judged)}", "target"]
    assert not any("matched" in label for label in labels) or kind == "matched"
    for color in (LIGHT.good, LIGHT.failure):
        found = (pixels == rgb(color)).all(axis=2).any()
        assert found == (color == tone)
