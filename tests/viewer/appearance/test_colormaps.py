"""Colour maps and the range that functions share."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from abfm_viewer.appearance import colormaps
from abfm_viewer.appearance.colormaps import color_range, loaded_name, on_ground, table
from abfm_viewer.appearance.theme import DARK
from abfm_viewer.scene.opengl import material_pictures

NAMES = ["abfm sequential", "abfm diverging"]
# Colours in Oklab (lightness, green to red, blue to yellow), evenly spaced along the map.
STOPS = {
    "abfm sequential": [
        (0.93, 0.000, 0.004),
        (0.84, 0.045, 0.085),
        (0.70, 0.130, 0.110),
        (0.55, 0.170, 0.090),
        (0.36, 0.122, 0.052),
    ],
    "abfm diverging": [
        (0.36, -0.010, -0.150),
        (0.62, -0.035, -0.125),
        (0.93, 0.000, 0.002),
        (0.66, 0.150, 0.080),
        (0.38, 0.130, 0.058),
    ],
    "abfm sequential dark": [
        (0.43, 0.000, -0.006),
        (0.50, 0.075, 0.035),
        (0.62, 0.145, 0.085),
        (0.76, 0.105, 0.125),
        (0.92, 0.000, 0.115),
    ],
    "abfm diverging dark": [
        (0.83, -0.035, -0.085),
        (0.60, -0.030, -0.140),
        (0.43, 0.000, -0.006),
        (0.60, 0.150, 0.065),
        (0.83, 0.080, 0.075),
    ],
    "viridis": [
        (0.285, 0.102, -0.091),
        (0.419, 0.016, -0.108),
        (0.535, -0.062, -0.053),
        (0.654, -0.120, 0.023),
        (0.779, -0.135, 0.126),
        (0.918, -0.039, 0.182),
    ],
    "magma": [
        (0.048, -0.003, -0.033),
        (0.309, 0.067, -0.133),
        (0.466, 0.149, -0.077),
        (0.621, 0.181, 0.039),
        (0.789, 0.088, 0.097),
        (0.979, -0.025, 0.075),
    ],
    "coolwarm": [
        (0.475, 0.004, -0.181),
        (0.762, -0.010, -0.119),
        (0.898, 0.000, 0.000),
        (0.767, 0.093, 0.075),
        (0.487, 0.180, 0.074),
    ],
    "gray": [
        (0.252, 0.000, 0.000),
        (0.450, 0.000, 0.000),
        (0.627, 0.000, 0.000),
        (0.792, 0.000, 0.000),
        (0.949, 0.000, 0.000),
    ],
}
TO_LMS = np.array(
    [
        [1, 0.3963377774, 0.2158037573],
        [1, -0.1055613458, -0.0638541728],
        [1, -0.0894841775, -1.2914855480],
    ]
)
TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def luminance(colors):
    """Relative luminance of sRGB colours."""
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def test_functions_of_one_sign_share_the_range_from_least_to_greatest():
    shared = color_range(np.array([0.0, 0.4]), np.array([-0.01, 1.0]))
    assert (shared.colormap, shared.low, shared.high) == ("abfm sequential", -0.01, 1.0)


def test_functions_of_both_signs_have_zero_in_the_middle():
    shared = color_range(np.array([0.0, 0.4]), np.array([-2.0, 1.0]))
    assert (shared.colormap, shared.low, shared.high) == ("abfm diverging", -2.0, 2.0)


@pytest.mark.parametrize("value", [0.0, -3.0, 1e-300, 1e17, -1e30])
def test_a_constant_has_a_range_around_it(value):
    shared = color_range(np.full(4, value))
    assert shared.low < value < shared.high


@pytest.mark.parametrize("name", NAMES)
def test_lightness_falls_away_from_the_light_grey_that_means_nothing(name):
    colors = table(name, 257)
    assert colors.min() >= 0
    assert colors.max() <= 1
    grey = 0 if name == "abfm sequential" else len(colors) // 2
    assert np.ptp(colors[grey]) < 0.03
    assert colors[grey].min() > 0.85
    assert (np.diff(luminance(colors[grey:])) < 0).all()
    assert (np.diff(luminance(colors[: grey + 1])) > 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_on_dark_grounds_lightness_rises_from_a_dark_grey_that_stands_out_from_the_ground(name):
    dark = on_ground(name, is_dark=True)
    colors = table(dark, 257)
    grey = 0 if name == "abfm sequential" else len(colors) // 2
    assert np.ptp(colors[grey]) < 0.05
    ground = luminance(np.array(DARK.ground[:3]))
    assert (luminance(colors) + 0.05).min() > 1.5 * (ground + 0.05)
    assert luminance(colors[grey]) < 0.15
    assert (np.diff(luminance(colors[grey:])) > 0).all()
    assert (np.diff(luminance(colors[: grey + 1])) < 0).all()


def test_maps_stay_themselves_on_light_grounds_and_where_they_have_no_zero():
    assert [on_ground(name, is_dark=False) for name in colormaps.NAMES] == list(colormaps.NAMES)
    assert [on_ground(name, is_dark=True) for name in colormaps.NAMES[2:]] == list(
        colormaps.NAMES[2:]
    )


@pytest.mark.parametrize("is_dark", [False, True])
def test_the_two_ends_of_the_diverging_map_weigh_the_same_and_differ(is_dark):
    blue, red = table(on_ground("abfm diverging", is_dark))[[0, -1]]
    assert luminance(blue) == pytest.approx(luminance(red), abs=0.04)
    assert blue[2] > blue[0] + 0.3
    assert red[0] > red[2] + 0.3


def test_images_hold_the_maps_in_linear_light():
    rows = {name: picture[0] / 255 for name, picture in colormaps.pictures().items()}
    assert set(rows) == set(STOPS)
    assert set(rows) > set(colormaps.NAMES)
    for name, row in rows.items():
        assert row[[0, -1]] ** (1 / 2.2) == pytest.approx(table(name)[[0, -1]], abs=0.03)


def test_maps_of_well_known_names_have_the_colours_that_these_are_known_for():
    assert table("viridis")[[0, -1]] == pytest.approx(
        np.array([[68, 1, 84], [253, 231, 37]]) / 255, abs=0.02
    )
    assert table("coolwarm")[[0, -1]] == pytest.approx(
        np.array([[59, 76, 192], [180, 4, 38]]) / 255, abs=0.02
    )


def test_polyscope_gets_no_name_that_it_has_already():
    assert all(loaded_name(name).startswith("abfm ") for name in colormaps.NAMES)
    assert len({loaded_name(name) for name in colormaps.NAMES}) == len(colormaps.NAMES)


def test_the_material_has_no_colour_of_its_own():
    red, green, blue, black = material_pictures()
    assert (red[..., 0] == green[..., 1]).all()
    assert (red[..., 0] == blue[..., 2]).all()
    assert not red[..., 1:].any()
    assert not black.any()
    assert red.max() < 255


def test_a_range_from_just_above_zero_begins_at_zero():
    assert color_range(np.array([0.01, 1.0])).low == 0
    assert color_range(np.array([0.1, 1.0])).low == 0.1


@pytest.mark.parametrize("name", STOPS)
@pytest.mark.parametrize("size", [64, 256, 1024])
def test_maps_join_their_stops_in_oklab_without_overshooting(name, size):
    stops = np.array(STOPS[name])
    oklab = PchipInterpolator(np.linspace(0, 1, len(stops)), stops)(np.linspace(0, 1, size))
    linear = np.clip((oklab @ TO_LMS.T) ** 3 @ TO_RGB.T, 0, 1)
    assert colormaps.linear_table(name, size) == pytest.approx(linear, abs=0.6 / 255)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert table(name, size) == pytest.approx(encoded, abs=0.6 / 255)
