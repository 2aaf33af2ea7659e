"""Colour maps and the range that functions share."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from abfm_viewer.appearance import colormaps, material
from abfm_viewer.appearance.colormaps import color_range, image_files, loaded_name, table

NAMES = ["abfm sequential", "abfm diverging"]


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


@pytest.mark.parametrize("value", [0.0, -3.0, 1e-300])
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


def test_the_two_ends_of_the_diverging_map_weigh_the_same_and_differ():
    blue, red = table("abfm diverging")[[0, -1]]
    assert luminance(blue) == pytest.approx(luminance(red), abs=0.03)
    assert blue[2] > blue[0] + 0.3
    assert red[0] > red[2] + 0.3


def test_image_files_hold_the_maps_in_linear_light():
    with image_files() as files:
        assert tuple(files) == colormaps.NAMES
        rows = {name: np.asarray(Image.open(file))[0] / 255 for name, file in files.items()}
    for name, row in rows.items():
        assert row[[0, -1]] ** (1 / 2.2) == pytest.approx(table(name)[[0, -1]], abs=0.03)


def test_maps_of_well_known_names_have_the_colours_that_these_are_known_for():
    assert table("viridis")[[0, -1]] == pytest.approx(np.array([[68, 1, 84], [253, 231, 37]]) / 255, abs=0.02)
    assert table("coolwarm")[[0, -1]] == pytest.approx(np.array([[59, 76, 192], [180, 4, 38]]) / 255, abs=0.02)


def test_polyscope_gets_no_name_that_it_has_already():
    assert all(loaded_name(name).startswith("abfm ") for name in colormaps.NAMES)
    assert len({loaded_name(name) for name in colormaps.NAMES}) == len(colormaps.NAMES)


def test_the_material_has_no_colour_of_its_own():
    with material.image_files() as paths:
        red, green, blue, black = (np.asarray(Image.open(path)) for path in paths)
    assert (red[..., 0] == green[..., 1]).all()
    assert (red[..., 0] == blue[..., 2]).all()
    assert not red[..., 1:].any()
    assert not black.any()
    assert red.max() < 255


def test_a_range_from_just_above_zero_begins_at_zero():
    assert color_range(np.array([0.01, 1.0])).low == 0
    assert color_range(np.array([0.1, 1.0])).low == 0.1
