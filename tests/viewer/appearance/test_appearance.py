import colorsys
from itertools import combinations, product
from typing import get_args

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from abfm.pages import colormaps
from abfm.pages.colormaps import (
    DARK_CHECKER_COLORS,
    for_background,
    polyscope_name,
    table,
)
from abfm.parameters import TITLES
from abfm_viewer.appearance.samples import MESHES, PAIRS, POPULATIONS, SEQUENCES
from abfm_viewer.appearance.theme import DARK_PALETTE, LANDMARKS, ON_LANDMARKS, palette
from abfm_viewer.document.document import THEMES
from abfm_viewer.scene.opengl import material_pictures
from abfm_viewer.widgets.toolkit import TextTone
from tests.viewer.contrast import SIGHTS, contrast, difference

NAMES = ["abfm sequential", "abfm diverging"]
# Colours in Oklab, evenly spaced: lightness, green to red, blue to yellow.
STOPS = {
    "abfm sequential": "0.93 0.84 0.7 0.55 0.36 / 0 0.045 0.13 0.17 0.122 "
    "/ 0.004 0.085 0.11 0.09 0.052",
    "abfm diverging": "0.36 0.62 0.93 0.66 0.38 / -0.01 -0.035 0 0.15 0.13 "
    "/ -0.15 -0.125 0.002 0.08 0.058",
    "abfm sequential dark": "0.52 0.575 0.66 0.775 0.92 / 0 0.075 0.145 0.105 0 "
    "/ -0.006 0.035 0.085 0.125 0.115",
    "abfm diverging dark": "0.82 0.655 0.52 0.655 0.82 / -0.035 -0.03 0 0.145 0.075 "
    "/ -0.08 -0.13 -0.006 0.065 0.07",
    "viridis": "0.285 0.419 0.535 0.654 0.779 0.918 / 0.102 0.016 -0.062 -0.12 -0.135 -0.039 "
    "/ -0.091 -0.108 -0.053 0.023 0.126 0.182",
    "magma": "0.048 0.309 0.466 0.621 0.789 0.979 / -0.003 0.067 0.149 0.181 0.088 -0.025 "
    "/ -0.033 -0.133 -0.077 0.039 0.097 0.075",
    "coolwarm": "0.475 0.762 0.898 0.767 0.487 / 0.004 -0.01 0 0.093 0.18 "
    "/ -0.181 -0.119 0 0.075 0.074",
    "gray": "0.252 0.45 0.627 0.792 0.949 / 0 0 0 0 0 / 0 0 0 0 0",
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
GROUNDS = ("panel", "field", "hovered", "pressed", "ground")
CURVES = ("lines", "flow")  # curves of residuals
# in CIELAB, where 2.3 is just noticeable; thin lines need several times as much
DIFFERENCE_MIN = 20.0
# minimum for texts, and for marks that are needed to understand a widget
TEXT_CONTRAST, MARK_CONTRAST = 4.5, 3.0


def luminance(colors):
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


@pytest.mark.parametrize("is_dark", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_lightness_is_monotonic_from_grey(name, is_dark):
    colors = table(for_background(name, is_dark), 257)
    assert 0 <= colors.min() <= colors.max() <= 1
    middle = 0 if name == "abfm sequential" else len(colors) // 2
    grey, light, away = colors[middle], luminance(colors), -1 if not is_dark else 1
    assert (away * np.diff(light[middle:]) > 0).all()
    assert (away * np.diff(light[: middle + 1]) < 0).all()
    if is_dark:
        assert np.ptp(grey) < 0.05
        assert min(contrast(one, DARK_PALETTE.ground) for one in colors) >= MARK_CONTRAST
        assert light[middle] < 0.16
    else:
        assert np.ptp(grey) < 0.03
        assert grey.min() > 0.85


def test_landmarks_have_contrast_on_grey_bodies():
    """The numbers, rims or colours of discs and rings differ from the colour of value 0."""
    for (is_dark, name), color in product(product((False, True), NAMES), LANDMARKS):
        map_ = table(for_background(name, is_dark), 257)
        grey = map_[0 if name == "abfm sequential" else 128]
        assert contrast(color, ON_LANDMARKS) >= TEXT_CONTRAST
        assert max(contrast(color, grey), contrast(ON_LANDMARKS, grey)) >= MARK_CONTRAST


def test_dark_checkerboard_has_contrast():
    light, dark = (np.power(color, 1 / 2.2) for color in DARK_CHECKER_COLORS)
    assert contrast(light, dark) > 2.2
    assert contrast(dark, DARK_PALETTE.ground) > 2.2


def test_maps_on_light_backgrounds_are_unchanged():
    names = list(colormaps.NAMES)
    assert [for_background(name, is_dark=False) for name in names] == names
    assert [for_background(name, is_dark=True) for name in names[2:]] == names[2:]


@pytest.mark.parametrize("is_dark", [False, True])
def test_ends_of_the_diverging_map_are_balanced(is_dark):
    blue, red = table(for_background("abfm diverging", is_dark))[[0, -1]]
    assert luminance(blue) == pytest.approx(luminance(red), abs=0.04)
    assert blue[2] > blue[0] + 0.3
    assert red[0] > red[2] + 0.3


def test_images_of_maps_are_in_linear_light():
    rows = {name: picture[0] / 255 for name, picture in colormaps.colormap_images().items()}
    assert set(rows) == set(STOPS) > set(colormaps.NAMES)
    for name, row in rows.items():
        assert row[[0, -1]] ** (1 / 2.2) == pytest.approx(table(name)[[0, -1]], abs=0.03)


@pytest.mark.parametrize("name", STOPS)
@pytest.mark.parametrize("size", [64, 256, 1024])
def test_maps_interpolate_in_oklab(name, size):
    stops = np.array([row.split() for row in STOPS[name].split("/")], dtype=float).T
    oklab = PchipInterpolator(np.linspace(0, 1, len(stops)), stops)(np.linspace(0, 1, size))
    linear = np.clip((oklab @ TO_LMS.T) ** 3 @ TO_RGB.T, 0, 1)
    assert colormaps.linear_table(name, size) == pytest.approx(linear, abs=0.6 / 255)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert table(name, size) == pytest.approx(encoded, abs=0.6 / 255)


def test_names_of_maps_are_new_to_polyscope():
    names = {polyscope_name(name) for name in colormaps.NAMES}
    assert all(name.startswith("abfm ") for name in names)
    assert len(names) == len(colormaps.NAMES)


def test_material_has_no_tint():
    red, green, blue, black = material_pictures()
    assert (red[..., 0] == green[..., 1]).all()
    assert (red[..., 0] == blue[..., 2]).all()
    assert not red[..., 1:].any()
    assert not black.any()
    assert red.max() < 255


@pytest.fixture(params=THEMES)
def colors(request):
    return palette(request.param)


@pytest.mark.parametrize(("ink", "ground"), [*product(get_args(TextTone), GROUNDS)])
def test_texts_have_contrast(colors, ink, ground):
    assert contrast(getattr(colors, ink), getattr(colors, ground)) >= TEXT_CONTRAST


def test_button_and_sliders_have_contrast(colors):
    assert contrast(colors.accent_ink, colors.accent) >= TEXT_CONTRAST
    assert contrast(colors.accent_ink, colors.accent_hovered) >= TEXT_CONTRAST
    assert contrast(colors.accent, colors.panel) >= MARK_CONTRAST
    assert contrast(colors.accent, colors.field) >= MARK_CONTRAST
    assert contrast(colors.marker, colors.field) >= MARK_CONTRAST


def test_curves_have_contrast_for_every_eye(colors):
    curves = [getattr(colors, name) for name in CURVES]
    assert min(contrast(curve, colors.ground) for curve in curves) >= MARK_CONTRAST
    for sight, (one, other) in product(SIGHTS, combinations(curves, 2)):
        assert difference(one, other, sight) > DIFFERENCE_MIN, sight


def degrees_between(one, other):
    first, second = (360 * colorsys.rgb_to_hsv(*color[:3])[0] for color in (one, other))
    angle = abs(first - second) % 360
    return min(angle, 360 - angle)


def test_tones_differ_for_every_eye(colors):
    tones = [getattr(colors, name) for name in ("good", "warning", "failure")]
    for sight, (one, other) in product(SIGHTS, combinations(tones, 2)):
        assert difference(one, other, sight) > DIFFERENCE_MIN, sight


def test_residual_curves_and_failure_have_other_hues(colors):
    others = ("source", "target", "accent", "accent_hovered", "good", "warning", "marker")
    for term, reserved, minimum in (
        *product(CURVES, ("source", "target", "failure"), (25,)),
        *product(("failure",), others, (45,)),
    ):
        angle = degrees_between(getattr(colors, term), getattr(colors, reserved))
        assert angle > minimum, (term, reserved)


def test_descriptions_of_samples_fit_their_entries():
    """An entry of the menu has space for about 52 letters next to its thumbnail."""
    descriptions = *MESHES.values(), *PAIRS.values(), *SEQUENCES.values(), *POPULATIONS.values()
    assert max(map(len, (*descriptions, *TITLES.values()))) <= 50
