"""Sheets as pictures: frames, panels of every kind, plots and colour bars."""

import numpy as np
import pytest

from abfm.io.sheets import Checker, Coordinates, Curve, Panel, Plot, Sheet, Streaks, Values
from abfm_viewer.pictures.panels import POINT_COLORS, cameras, color_ranges, panel_pictures
from abfm_viewer.pictures.plots import CURVE_COLORS, plot_picture
from abfm_viewer.pictures.sheets import figure_picture
from tests.shapes import ellipsoid, icosphere

SPHERE = icosphere(3)
X, Y, Z = SPHERE.vertices.T
ROTATION = np.cross([0.0, 1.0, 0.0], SPHERE.vertices[SPHERE.faces].mean(axis=1))
SIZE = (160, 160)


def draw(panel):
    """One panel, (160, 160, 4)."""
    sheet = Sheet(((panel,),))
    [picture] = panel_pictures(sheet, [SIZE], color_ranges(sheet), cameras(sheet))
    return np.asarray(picture)


def colors(picture):
    """All colours of a picture, as tuples."""
    return {tuple(color) for color in np.asarray(picture)[..., :3].reshape(-1, 3).tolist()}


def spread(pixels):
    """Standard deviation of the lightness over what is solid."""
    solid = pixels[pixels[..., 3] == 255][:, :3]
    return float(solid.mean(axis=1).std())


PAINTS = {
    "vertex values": Values(X),
    "face values": Values(ROTATION[:, 0]),
    "coordinates": Coordinates(SPHERE.vertices),
    "checker": Checker(3 * SPHERE.vertices[:, :2]),
    "streaks": Streaks(ROTATION),
    "coloured streaks": Streaks(ROTATION, X),
}


@pytest.mark.parametrize("name", PAINTS)
def test_a_panel_shows_its_paint_on_a_transparent_ground(name):
    pixels = draw(Panel(SPHERE, PAINTS[name], "x"))
    alpha = pixels[..., 3] / 255
    assert alpha.sum() == pytest.approx(np.pi * (80 / 1.08) ** 2, rel=0.03)
    assert alpha[0].max() == 0
    plain = draw(Panel(SPHERE, Values(np.zeros(len(X))), "x"))
    assert spread(pixels) > 1.3 * spread(plain)


def test_marks_are_drawn():
    bare = draw(Panel(SPHERE, Values(0 * X), "x")).astype(int)
    front = cameras(Sheet(((Panel(SPHERE, Values(0 * X), "x"),),)))[SPHERE].front.direction
    nearest = SPHERE.vertices[np.argsort(-SPHERE.vertices @ front)[:30]]
    marks = {
        "points": {"points": nearest[:2]},
        "lines": {"lines": (1.01 * nearest[[0, 29]],)},
        "arrows": {"arrows": ROTATION},
    }
    for kind in marks.values():
        drawn = draw(Panel(SPHERE, Values(0 * X), "x", **kind)).astype(int)
        assert (np.abs(drawn - bare).sum(axis=-1) > 60).sum() > 20
    assert len(set(POINT_COLORS)) == len(POINT_COLORS)


def test_a_sheet_has_the_papers_frames_and_labels():
    plain = Values(X, "height")
    rows = (
        tuple(
            Panel(SPHERE, plain, frame, frame)
            for frame in ("source", "target", "result", "field", "other")
        ),
        (Panel(ellipsoid(2, 1, 2, 1), Coordinates(ellipsoid(2, 1, 2, 1).vertices), "tall"),),
    )
    picture = figure_picture(Sheet(rows))
    frames = {
        (0x24, 0x55, 0xC3),
        (0xC6, 0x28, 0x28),
        (0x11, 0x11, 0x11),
        (0x8A, 0x90, 0x9C),
        (255, 255, 255),
    }
    assert frames <= colors(picture)
    assert picture.mode == "RGB"


def test_a_plot_has_its_curves_colours_and_size():
    x = np.linspace(0, 1, 20)
    plot = Plot((Curve("a", x, 1 + x), Curve("b", x, 2 - x)), "t / τ", "value", "", log_y=True)
    picture = plot_picture(plot, (500, 300), 18)
    assert picture.size == (500, 300)
    for code in CURVE_COLORS[:2]:
        assert tuple(bytes.fromhex(code[1:])) in colors(picture)


def test_a_label_that_is_too_long_is_cut_down_to_its_cell():
    long = "a label that is far too long for the narrow panel that it stands below, by all means"
    narrow = ellipsoid(2, 0.4, 1.5, 0.4)
    pictures = [
        np.asarray(figure_picture(Sheet(((Panel(narrow, Coordinates(narrow.vertices), text),),))))
        for text in (long, "a")
    ]
    assert pictures[0].shape == pictures[1].shape
    margin = pictures[0][:, :8]
    assert (margin == 255).all()


def test_a_curve_that_grows_beyond_bounds_leaves_the_plot():
    x = np.linspace(0, 1, 20)
    calm, wild = Curve("calm", x, x), Curve("wild", x, np.exp(20 * x))
    size, text = (500, 300), 18
    whole, cut = (
        plot_picture(Plot((wild, calm), "t", "y", "", top=top), size, text) for top in (None, 4.0)
    )
    blue = tuple(bytes.fromhex(CURVE_COLORS[1][1:]))
    heights = [
        np.ptp(np.nonzero((np.asarray(picture) == blue).all(axis=2))[0][:])
        for picture in (whole, cut)
    ]
    assert colors(whole) & colors(cut) >= {blue}
    assert heights[0] != heights[1]


def test_a_legend_without_a_free_place_stands_above_the_plot():
    x = np.linspace(0, 1, 40)
    few = tuple(Curve(f"curve {k}", x, k * x) for k in (0, 1))
    many = tuple(Curve(f"curve {k}", x, 0 * x + k) for k in range(12))
    for curves, inside in ((few, True), (many, False)):
        picture = np.asarray(plot_picture(Plot(curves, "t", "y", ""), (500, 300), 18))
        # the y axis' line is black
        axis = np.flatnonzero((picture[:, :250] == 0).all(axis=2).sum(axis=0) > 100)
        top = np.flatnonzero((picture[:, axis[-1]] == 0).all(axis=1))[0]
        assert (top < 25) == inside


def test_the_title_of_an_axis_is_whole_in_a_low_plot():
    x = np.linspace(0, 1, 20)
    pictures = (
        plot_picture(Plot((Curve("", x, x),), "t", name, ""), (500, 160), 20)
        for name in ("m" * 18, "")
    )
    titled, bare = (np.asarray(picture) for picture in pictures)
    left = titled[:, : np.flatnonzero((bare < 255).any(axis=(0, 2)))[0] + 10]
    inked = np.flatnonzero((left < 128).any(axis=(1, 2)))
    assert inked.min() > 0
    assert inked.max() < 159
