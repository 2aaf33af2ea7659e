"""The layout of a sheet of pictures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from abfm_viewer.appearance.colormaps import ColorRange, table
from abfm_viewer.pictures import sheet

COLORS = ColorRange("abfm sequential", 0, 1)


@given(
    count=st.integers(1, 12),
    aspect=st.floats(0.2, 5),
    size=st.none() | st.tuples(st.integers(320, 4000), st.integers(240, 3000)),
)
def test_tiles_stay_on_the_sheet_and_apart(count, aspect, size):
    grid = sheet.grid(count, aspect, size)
    assert size is None or (grid.width, grid.height) == size
    assert grid.columns * grid.rows >= count
    corners = [grid.corner(index) for index in range(count)]
    for x, y in corners:
        assert x >= 0
        assert y >= 0
    if grid.tile_width > 20 and grid.tile_height > 20:  # a sheet too small for its tiles has no room for labels either
        assert max(x for x, _ in corners) + grid.tile_width < grid.width
        assert max(y for _, y in corners) + grid.tile_height < grid.height
        for index in range(1, count):
            (x0, y0), (x1, y1) = corners[index - 1 : index + 1]
            assert x1 > x0 + grid.tile_width or y1 > y0 + grid.tile_height


@pytest.mark.parametrize(("aspect", "columns"), [(0.5, 6), (1.0, 3), (4.0, 2)])
def test_a_sheet_of_free_size_has_pleasant_proportions(aspect, columns):
    grid = sheet.grid(6, aspect)
    assert grid.columns == columns
    assert 1 < grid.width / grid.height < 5


def test_compose_draws_pictures_frames_labels_and_the_colour_bar():
    grid = sheet.grid(2, 1.0, (900, 400))
    green = Image.new("RGBA", (grid.tile_width, grid.tile_height), (0, 160, 0, 255))
    empty = Image.new("RGBA", green.size)
    tiles = [sheet.Tile(green, "first", "#0000ff", bold=True), sheet.Tile(empty, "second", "#ff0000", bold=False)]
    pixels = np.asarray(sheet.compose(grid, tiles, COLORS))
    assert pixels.shape == (400, 900, 3)
    (x0, y0), (x1, y1) = grid.corner(0), grid.corner(1)
    half = grid.tile_width // 2
    assert tuple(pixels[y0 + half, x0 + half]) == (0, 160, 0)
    assert tuple(pixels[y1 + half, x1 + half]) == (255, 255, 255)
    assert tuple(pixels[y0, x0 + half]) == (0, 0, 255)
    assert tuple(pixels[y1, x1 + half]) == (255, 0, 0)
    labels = pixels[y0 + grid.tile_height + 3 : y0 + grid.tile_height + 40]
    assert (labels[:, x0 : x0 + grid.tile_width] < 128).any()
    bar = pixels[:, x1 + grid.tile_width + 10 :].reshape(-1, 3)
    for color in np.round(255 * table(COLORS.colormap, 64)):
        assert np.abs(bar - color).max(axis=1).min() <= 6


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 1, [0, 0.2, 0.4, 0.6, 0.8, 1]),
        (-2, 2, [-2, -1, 0, 1, 2]),
        (0.4, 1.3, [0.4, 0.6, 0.8, 1, 1.2]),
    ],
)
def test_ticks_are_round(low, high, expected):
    assert sheet.ticks(low, high) == pytest.approx(expected)


@given(low=st.floats(-1e6, 1e6), width=st.floats(1e-3, 1e6))
def test_there_are_three_to_seven_ticks_inside_the_range(low, width):
    ticks = sheet.ticks(low, low + width)
    assert 3 <= len(ticks) <= 7
    assert ticks[0] >= low - 1e-6 * width
    assert ticks[-1] <= low + width + 1e-6 * width
