"""Pictures drawn by OpenGL off the screen."""

from __future__ import annotations

import numpy as np
import pytest

import abfm
from abfm_viewer.appearance.colormaps import color_range, table
from abfm_viewer.pictures import pictures, sheet
from abfm_viewer.scene import camera
from abfm_viewer.scene.drawing_units import drawing_units
from tests.shapes import icosphere

WHITE, BLUE, BLACK, RED = (255, 255, 255), (0x24, 0x55, 0xC3), (0x11, 0x11, 0x11), (0xC6, 0x28, 0x28)


@pytest.fixture(scope="module")
def match():
    """A short match of two channels on a sphere: one non-negative, one of both signs."""
    mesh = icosphere(3)
    x, _, z = mesh.vertices.T
    f = np.stack([np.exp(-4 * (1 - x)), x], axis=1)
    g = np.stack([np.exp(-4 * (1 - z)), z], axis=1)
    return abfm.match(mesh, f, g, abfm.Parameters(tau=2, iterations=5))


def draw(mesh, values, size=200):
    """One function from in front, (size, size, 4)."""
    view = camera.View(np.array([0.0, 0, 1]), np.array([0.0, 1, 0]))
    layout = sheet.Grid(0, 0, 1, 1, size, size, 1)
    [picture] = pictures.surface_pictures(
        mesh, [values], color_range(values), camera.fitted(drawing_units(mesh).drawn(mesh.vertices), view, 1.0), layout
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
    sheet_of_match = np.asarray(pictures.match_picture(match, size=(900, 700)))
    assert sheet_of_match.shape == (700, 900, 3)
    colors = {tuple(color) for color in sheet_of_match.reshape(-1, 3).tolist()}
    assert {WHITE, BLUE, BLACK, RED} <= colors
    assert len(colors) > 1000
    assert (sheet_of_match == 255).all(axis=2).mean() > 0.15


def test_size_times_channel_and_axis_change_the_picture(match):
    usual = np.asarray(pictures.match_picture(match, size=(640, 480)))
    assert usual.shape == (480, 640, 3)
    for other in (
        pictures.match_picture(match, times=[0.5, 3.5], size=(640, 480)),
        pictures.match_picture(match, size=(640, 480), channel=1),
        pictures.match_picture(match, size=(640, 480), up="x"),
    ):
        assert other.size == (640, 480)
        assert (np.asarray(other) != usual).any()


def test_the_same_match_gives_the_same_picture(match):
    first, second = (np.asarray(pictures.match_picture(match, size=(640, 480))) for _ in range(2))
    assert (first == second).all()
