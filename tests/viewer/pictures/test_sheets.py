from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ImageFont

import abfm
from abfm.display import ViewSpec
from abfm.io.sheets import Checker, Coordinates, Curve, Panel, Plot, Sheet, Streaks, Values
from abfm.matching import StopReason
from abfm.outcome import Outcome
from abfm.pages.colormaps import table
from abfm.wording import share
from abfm_viewer.appearance.theme import LIGHT_PALETTE
from abfm_viewer.pictures import panels, sheets
from abfm_viewer.pictures.canvas import rgb
from abfm_viewer.pictures.panels import cameras, captions, color_ranges
from abfm_viewer.pictures.plots import CURVE_COLORS, plot_picture
from abfm_viewer.pictures.sheets import (
    figure_picture,
    match_picture,
    sequence_picture,
    sheet_picture,
)
from tests.core.sequences import rotating_sphere
from tests.messages import check_message
from tests.shapes import ellipsoid, icosphere, square

SPHERE = icosphere(3)
X, Y, Z = SPHERE.vertices.T
ROTATION = np.cross([0.0, 1.0, 0.0], SPHERE.vertices[SPHERE.faces].mean(axis=1))
SOURCE = Panel(SPHERE, Values(Y), "source", "source")
WHITE, BLUE, RED, BLACK = (
    tuple(bytes.fromhex(code)) for code in ("ffffff", "2455c3", "c62828", "111111")
)
ASPECTS = st.lists(st.lists(st.floats(0.45, 3.8), min_size=1, max_size=8), min_size=1, max_size=5)


@pytest.fixture(scope="module")
def match():
    """Return a short match of two channels: one non-negative, one of both signs."""
    f, g = (np.stack([np.exp(-4 * (1 - x)), x], axis=1) for x in (X, Z))
    return abfm.match(SPHERE, f, g, abfm.Parameters.of(tau=2, iterations=5, refine=0))


def of(*row, **options):
    return Sheet((row,), **options)


def draw(panel, size=160):
    [picture] = panels.panel_pictures(
        of(panel), [(size, size)], color_ranges(of(panel)), cameras(of(panel), (1.0, 1.0))
    )
    return np.asarray(picture)


def colors(picture):
    codes = np.asarray(picture)[..., :3].astype(int) @ [1 << 16, 1 << 8, 1]
    return {tuple(int(code).to_bytes(3, "big")) for code in np.unique(codes)}


def spread(pixels):
    """Return the standard deviation of the lightness of opaque pixels."""
    return float(pixels[pixels[..., 3] == 255][:, :3].mean(axis=1).std())


@given(ASPECTS, st.integers(0, 3))
def test_cells_have_one_height_and_do_not_overlap(rows, bars):
    layout = sheets.lay_out(rows, bars)
    assert len(layout.bars) == bars
    assert layout.width <= sheets.WIDTH_MAX + 8  # up to rounding of the widths of cells
    heights = {place.height for row in layout.rows for place in row}
    assert len(heights) == 1
    assert heights.pop() <= sheets.PANEL_HEIGHT_MAX
    for row, aspects in zip(layout.rows, rows, strict=True):
        assert row[0].left >= sheets.MARGIN
        assert row[-1].left + row[-1].width <= layout.width - sheets.MARGIN + 1
        for left, right in pairwise(row):
            assert left.left + left.width < right.left
        for place, aspect in zip(row, aspects, strict=True):
            assert place.width == pytest.approx(aspect * place.height, abs=1 + 0.5 * aspect)
    for above, below in pairwise(layout.rows):
        assert above[0].top + above[0].height + sheets.LABEL < below[0].top
    end = layout.rows[-1][0].top + layout.rows[-1][0].height + sheets.LABEL
    assert end <= layout.height
    for left, top, right, bottom in layout.bars:
        assert end < top < bottom < layout.height
        assert 0 < left < right < layout.width
    for one, other in pairwise(layout.bars):
        assert one[2] < other[0]


def test_widest_row_fills_the_sheet():
    assert sheets.lay_out([[1.0] * 6, [1.0]], 0).width == pytest.approx(sheets.WIDTH_MAX, abs=6)
    single = sheets.lay_out([[1.0]], 0)
    assert single.rows[0][0].height == sheets.PANEL_HEIGHT_MAX
    assert single.width < sheets.WIDTH_MAX / 2


def test_sheet_of_a_match_changes_with_its_options(match):
    size = 480, 360
    usual = np.asarray(match_picture(match, size=size))
    assert usual.shape == (360, 480, 3)
    assert {WHITE, BLUE, BLACK, RED} <= colors(usual)
    assert len(colors(usual)) > 1000
    assert (usual == 255).all(axis=2).mean() > 0.15
    for options in ({"times": [0.5, 3.5]}, {"channel": 1}, {"view": ViewSpec(up="x")}):
        assert (np.asarray(match_picture(match, size=size, **options)) != usual).any()


@given(
    count=st.integers(1, 12),
    aspect=st.floats(0.2, 5),
    size=st.none() | st.tuples(st.integers(320, 4000), st.integers(240, 3000)),
)
def test_panels_are_inside_the_sheet(count, aspect, size):
    layout = sheets.grid(count, aspect, size)
    assert layout.width == (sheets.DEFAULT_WIDTH if size is None else size[0])
    if size is None and count == 6 and 0.5 <= aspect <= 4:
        assert 1 < layout.width / layout.height < 5  # the default aspect
    assert size is None or layout.height == size[1]
    places = [place for row in layout.rows for place in row]
    assert len(places) >= count
    for place in places:
        assert place.left >= 0
        assert place.top >= 0
    # a sheet too small for its panels is also too small for labels
    if places[0].width > 20 and places[0].height > 20:
        assert max(place.left + place.width for place in places) < layout.bars[0][0]
        assert max(place.top + place.height for place in places) < layout.height
        for one, other in pairwise(places):
            assert other.left > one.left + one.width or other.top > one.top + one.height


def test_panels_have_frames_labels_and_a_color_bar():
    ones = Values(np.ones(len(X)))
    layout = sheets.grid(2, 1.0, (900, 400))
    sheet = of(Panel(SPHERE, ones, "first", "source"), Panel(SPHERE, ones, "second", "target"))
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
    ("kind", "tone"),
    [
        ("matched", LIGHT_PALETTE.good),
        ("not reached", LIGHT_PALETTE.failure),
        ("nearly", LIGHT_PALETTE.warning),
    ],
)
def test_label_at_tau_has_the_verdict_and_its_color(match, kind, tone, monkeypatch):
    drawn = []

    def record(sheet, *rest):
        drawn.append(sheet)
        return sheet_picture(sheet, *rest)

    monkeypatch.setattr("abfm_viewer.pictures.sheets.sheet_picture", record)
    judged = replace(match, verdict=replace(match.verdict, kind=Outcome(kind)))
    judged = replace(judged, stop_reason=StopReason.CONVERGED)
    pixels = np.asarray(match_picture(judged, [1.0], (900, 400)))
    labels = [panel.label for panel in drawn[0].rows[0]]
    residual = f"residual {share(judged.worse_residual)}"
    assert labels[2:] == [f"t = 2, {kind if tone == LIGHT_PALETTE.failure else residual}", "target"]
    for color in (LIGHT_PALETTE.good, LIGHT_PALETTE.warning, LIGHT_PALETTE.failure):
        assert (pixels == rgb(color)).all(axis=2).any() == (color == tone)


def test_panels_with_one_title_share_a_range():
    sheet = of(Panel(SPHERE, Values(Y), "a"), Panel(SPHERE, Streaks(ROTATION, 3 * Y), "b"))
    [(title, shared)] = color_ranges(sheet).items()
    assert title == "function"
    assert (shared.low, shared.high) == (-3 * abs(Y).max(), 3 * abs(Y).max())
    sheet = of(SOURCE, Panel(SPHERE, Values(3 * Y), "b", "result"))
    assert color_ranges(sheet)["function"].high == abs(Y).max()


@pytest.mark.parametrize("paint", [Values, lambda values, bar: Streaks(ROTATION, values, bar)])
def test_values_beyond_the_colors_have_a_caption(paint):
    wild = Y.copy()
    wild[[3, 7]] = 25_250, -0.5
    sheet = of(
        Panel(SPHERE, paint(Y, "speed"), "u", "source"),
        Panel(SPHERE, paint(wild, "speed"), "u, advected", "result"),
        Panel(SPHERE, Values(1e9 * Y, "other"), "alone", "result"),
    )
    beyond = f"'u, advected' (speed) ranges from {wild.min():,.4g} to 2.525e+04"
    end = abs(Y).max()
    known = f"the colours from {-end:,.4g} to {end:,.4g}."
    assert captions(sheet) == [f"Outside the colour range: {beyond}, {known}"]


@pytest.mark.parametrize("sign", [1, -1])
def test_small_overshoots_have_no_caption(sign):
    extent = 2 * abs(Y).max()
    for beyond, lines in ((0.9 * panels.CLAMP_SHARE, 0), (1.1 * panels.CLAMP_SHARE, 1)):
        over = Y.copy()
        over[np.argmax(sign * Y)] += sign * beyond * extent
        assert len(captions(of(SOURCE, Panel(SPHERE, Values(over), "over", "result")))) == lines


def test_captions_report_distant_positions_and_notes():
    inside, outside = 1.1 * SPHERE.vertices, SPHERE.vertices.copy()
    outside[5, 2] = SPHERE.vertices[:, 2].max() + 3 * np.ptp(SPHERE.vertices[:, 2])
    places = (("near", inside), ("far", outside))
    [line] = captions(of(*(Panel(SPHERE, Coordinates(where), name) for name, where in places)))
    check_message(line, "far", 3)
    flat = square(4)
    assert captions(of(Panel(flat, Coordinates(np.add(flat.vertices, [0, 0, 1e-6])), "flat"))) == []
    x = np.linspace(0, 1, 5)
    plot = Plot((Curve("a", x, x),), "x", "y", "", top=0.5)
    checker = Panel(SPHERE, Checker(1e6 * SPHERE.vertices[:, :2]), "c")
    assert captions(of(checker, Panel(SPHERE, Streaks(ROTATION), "s"), plot)) == []
    noted = of(SOURCE, Panel(SPHERE, Values(9 * Y), "b", "result"), notes=("a note",))
    assert captions(noted)[0] == "a note"
    assert len(captions(noted)) == 2


def test_captions_are_below_the_sheet():
    bare, noted = (np.asarray(figure_picture(of(SOURCE), notes)) for notes in ((), ("word " * 60,)))
    height = len(bare)
    assert len(noted) > height
    np.testing.assert_array_equal(noted[:height], bare)
    assert (noted[height:] < 128).any()
    assert (noted[:, -10:] == 255).all()
    text = " ".join(f"word{number}" for number in range(60))
    lines = sheets.wrapped([text, "short"], 300, lambda line: 11.0 * len(line))
    assert max(map(len, lines)) <= 300 / 11
    assert " ".join(lines) == f"{text} short"
    assert lines[-1] == "short"
    assert 5 < len(lines) < 30
    assert sheets.wrapped(["unbreakable" * 20], 100, len) == ["unbreakable" * 20]


PAINTS = {
    "vertex values": Values(X),
    "face values": Values(ROTATION[:, 0]),
    "coordinates": Coordinates(SPHERE.vertices),
    "checker": Checker(3 * SPHERE.vertices[:, :2]),
    "streaks": Streaks(ROTATION),
    "coloured streaks": Streaks(ROTATION, X),
}


@pytest.mark.usefixtures("coarse_streaks")
@pytest.mark.parametrize("name", PAINTS)
def test_panel_has_a_transparent_background(name):
    pixels = draw(Panel(SPHERE, PAINTS[name], "x"))
    alpha = pixels[..., 3] / 255
    assert alpha.sum() == pytest.approx(np.pi * (80 / 1.08) ** 2, rel=0.03)
    assert alpha[0].max() == 0
    plain = draw(Panel(SPHERE, Values(np.zeros(len(X))), "x"))
    assert spread(pixels) > 1.3 * spread(plain)


def test_arrows_lines_and_points_are_drawn():
    bare = draw(Panel(SPHERE, Values(0 * X), "x")).astype(int)
    front = cameras(of(Panel(SPHERE, Values(0 * X), "x")))[SPHERE].front.direction
    nearest = SPHERE.vertices[np.argsort(-SPHERE.vertices @ front)[:30]]
    marks = {"points": nearest[:2], "lines": (1.01 * nearest[[0, 29]],), "arrows": ROTATION}
    for name, mark in marks.items():
        drawn = draw(Panel(SPHERE, Values(0 * X), "x", **{name: mark})).astype(int)
        assert (np.abs(drawn - bare).sum(axis=-1) > 60).sum() > 20
    assert len(set(panels.POINT_COLORS)) == len(panels.POINT_COLORS)


def test_plot_clips_curves_at_its_bounds():
    x = np.linspace(0, 1, 20)
    plot = Plot((Curve("a", x, 1 + x), Curve("b", x, 2 - x)), "t / τ", "value", "", log_y=True)
    picture = plot_picture(plot, (500, 300), 18)
    assert picture.size == (500, 300)
    assert {tuple(bytes.fromhex(code[1:])) for code in CURVE_COLORS[:2]} <= colors(picture)
    calm, wild = Curve("calm", x, x), Curve("wild", x, np.exp(20 * x))
    blue = tuple(bytes.fromhex(CURVE_COLORS[1][1:]))
    heights = []
    for top in (None, 4.0):
        shown = np.asarray(plot_picture(Plot((wild, calm), "t", "y", "", top=top), (500, 300), 18))
        heights.append(np.ptp(np.nonzero((shown == blue).all(axis=2))[0]))
    assert heights[0] < heights[1]


def test_long_labels_are_abbreviated():
    long = "a label that is far too long for the narrow panel that it stands below, by all means"
    narrow = ellipsoid(2, 0.4, 1.5, 0.4)
    cut, short = (
        np.asarray(figure_picture(of(Panel(narrow, Coordinates(narrow.vertices), text))))
        for text in (long, "a")
    )
    assert cut.shape == short.shape
    assert (cut[:, :8] == 255).all()


def test_legends_and_titles_do_not_cover_curves():
    x = np.linspace(0, 1, 40)
    few = tuple(Curve(f"curve {k}", x, k * x) for k in (0, 1))
    many = tuple(Curve(f"curve {k}", x, 0 * x + k) for k in range(12))
    for curves, inside in ((few, True), (many, False)):
        picture = np.asarray(plot_picture(Plot(curves, "t", "y", ""), (500, 300), 18))
        # the line of the y axis is black
        axis = np.flatnonzero((picture[:, :250] == 0).all(axis=2).sum(axis=0) > 100)
        assert (np.flatnonzero((picture[:, axis[-1]] == 0).all(axis=1))[0] < 25) == inside
    slot_title, bare = (
        np.asarray(plot_picture(Plot((Curve("", x, x),), "t", name, ""), (500, 160), 20))
        for name in ("m" * 18, "")
    )
    left = slot_title[:, : np.flatnonzero((bare < 255).any(axis=(0, 2)))[0] + 10]
    inked = np.flatnonzero((left < 128).any(axis=(1, 2)))
    assert inked.min() > 0
    assert inked.max() < 159


def test_times_of_a_sequence_have_their_unit(monkeypatch):
    drawn = []
    monkeypatch.setattr(sheets, "sheet_picture", lambda sheet, *_: drawn.append(sheet))
    of_numbers = abfm.sequence(rotating_sphere.MESH, rotating_sphere.rotating_frames()[:2], gamma=0)
    for sequence, times in ((rotating_sphere.solved(), [-0.1, 0.05]), (of_numbers, None)):
        sequence_picture(sequence, times)
    labels = [[panel.label for panel in sheet.rows[0]] for sheet in drawn]
    assert labels == [["t = -0.1 s", "t = 0.05 s"], [f"t = {0.2 * n:.4g}" for n in range(6)]]
