"""Colour ranges of a sheet, and what it says of values that they clamp."""

import numpy as np
import pytest

from abfm.io.sheets import Checker, Coordinates, Curve, Panel, Plot, Sheet, Streaks, Values
from abfm_viewer.pictures.panels import CLAMPED, captions, color_ranges
from abfm_viewer.pictures.sheets import figure_picture, wrapped
from tests.shapes import icosphere, square

SPHERE = icosphere(2)
HEIGHT = SPHERE.vertices[:, 1]
FIELD = np.cross([0.0, 1.0, 0.0], SPHERE.vertices[SPHERE.faces].mean(axis=1))
SOURCE = Panel(SPHERE, Values(HEIGHT), "source", "source")


def of(*row, **options):
    return Sheet((row,), **options)


def test_functions_of_one_title_share_a_range():
    sheet = of(Panel(SPHERE, Values(HEIGHT), "a"), Panel(SPHERE, Streaks(FIELD, 3 * HEIGHT), "b"))
    [(title, shared)] = color_ranges(sheet).items()
    assert title == "function"
    assert (shared.low, shared.high) == (-3 * abs(HEIGHT).max(), 3 * abs(HEIGHT).max())


def test_the_range_is_that_of_source_and_target():
    sheet = of(SOURCE, Panel(SPHERE, Values(3 * HEIGHT), "b", "result"))
    assert color_ranges(sheet)["function"].high == abs(HEIGHT).max()


@pytest.mark.parametrize("paint", [Values, lambda values, bar: Streaks(FIELD, values, bar)])
def test_what_colours_hide_is_said_with_its_true_extremes(paint):
    wild = HEIGHT.copy()
    wild[[3, 7]] = 25_250, -0.5
    sheet = of(
        Panel(SPHERE, paint(HEIGHT, "speed"), "u", "source"),
        Panel(SPHERE, paint(wild, "speed"), "u, carried", "result"),
        Panel(SPHERE, Values(1e9 * HEIGHT, "other"), "alone", "result"),
    )
    end = abs(HEIGHT).max()
    assert captions(sheet) == [
        f"Beyond the colours: 'u, carried' (speed) goes from {wild.min():,.4g} to 2.525e+04, the "
        "colours from "
        f"{-end:,.4g} to {end:,.4g}."
    ]


@pytest.mark.parametrize("sign", [1, -1])
def test_small_overshoots_are_not_worth_a_word(sign):
    extent = 2 * abs(HEIGHT).max()
    for share, lines in ((0.9 * CLAMPED, 0), (1.1 * CLAMPED, 1)):
        over = HEIGHT.copy()
        over[np.argmax(sign * HEIGHT)] += sign * share * extent
        assert len(captions(of(SOURCE, Panel(SPHERE, Values(over), "over", "result")))) == lines


def test_places_are_measured_by_the_bounding_box():
    inside, outside = 1.1 * SPHERE.vertices, SPHERE.vertices.copy()
    outside[5, 2] = SPHERE.vertices[:, 2].max() + 3 * np.ptp(SPHERE.vertices[:, 2])
    panels = [
        Panel(SPHERE, Coordinates(places), name)
        for name, places in (("near", inside), ("far", outside))
    ]
    [line] = captions(of(*panels))
    assert "'far' lie up to 3 times the bounding box's extent outside" in line
    flat = square(4)
    assert captions(of(Panel(flat, Coordinates(np.add(flat.vertices, [0, 0, 1e-6])), "flat"))) == []


def test_notes_come_first_and_other_cells_have_nothing_to_hide():
    x = np.linspace(0, 1, 5)
    plot = Plot((Curve("a", x, x),), "x", "y", "", top=0.5)
    sheet = of(
        Panel(SPHERE, Checker(1e6 * SPHERE.vertices[:, :2]), "c"),
        Panel(SPHERE, Streaks(FIELD), "s"),
        plot,
    )
    assert captions(sheet) == []
    noted = of(
        SOURCE, Panel(SPHERE, Values(9 * HEIGHT), "b", "result"), notes=("a map that is none",)
    )
    assert captions(noted)[0] == "a map that is none"
    assert len(captions(noted)) == 2


def test_captions_stand_below_everything_else():
    row = (SOURCE, Panel(SPHERE, Values(HEIGHT), "b", "result"))
    bare, noted = (np.asarray(figure_picture(of(*row), notes)) for notes in ((), ("word " * 60,)))
    height = len(bare)
    assert len(noted) > height
    np.testing.assert_array_equal(noted[:height], bare)
    assert (noted[height:] < 128).any()
    assert (noted[:, -10:] == 255).all()


def test_lines_are_no_longer_than_the_sheet():
    text = " ".join(f"word{number}" for number in range(60))
    lines = wrapped([text, "short"], 300, lambda line: 11.0 * len(line))
    assert max(map(len, lines)) <= 300 / 11
    assert " ".join(lines) == f"{text} short"
    assert lines[-1] == "short"
    assert 5 < len(lines) < 30
    assert wrapped(["unbreakable" * 20], 100, len) == ["unbreakable" * 20]
