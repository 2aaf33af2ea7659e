from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import abfm
from abfm import AbfmError, FunctionError, ParameterError
from abfm.display import ViewSpec
from abfm.pages.front import front_of
from abfm_viewer.appearance.theme import LIGHT_PALETTE
from abfm_viewer.document.document import Channel, Surface, Viewpoint
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.pictures.canvas import rgb
from abfm_viewer.pictures.document_pictures import DocumentRenderer, PictureOptions
from abfm_viewer.scene import opengl
from abfm_viewer.scene.opengl import ps
from abfm_viewer.session.session import Session
from abfm_viewer.window.window import Window
from tests.messages import raises
from tests.shapes import ellipsoid

SIZE = (480, 300)
SURFACES_ONLY = PictureOptions(color_bar=False, labels=False)
TURNING = replace(SURFACES_ONLY, turns=True)
EGG = ellipsoid(3, 1.0, 0.7, 0.55)
CHANNEL = Channel("gaussian:x=1,y=0,z=0,width=0.15", "gaussian:x=0,y=0.7,z=0,width=0.15")


@pytest.fixture(scope="module")
def document():
    """Return a short match on an egg, with tau = 2."""
    f, g = (abfm.function(EGG, CHANNEL.spec(side)) for side in ("source", "target"))
    match = abfm.match(EGG, f, g, abfm.Parameters.of(tau=2, iterations=40, refine=0))
    solved = {"parameters": match.parameters, "result": match, "time": 2.0}
    return MatchDocument((Surface(EGG, "egg"),), (CHANNEL,), **solved)


def viewed(document, **view):
    return replace(document, view=replace(document.view, **view))


def drawn(document, size=SIZE, options=SURFACES_ONLY, time=2.0, degrees=0.0):
    """Return one picture as an array."""
    with DocumentRenderer(document, {}, size, options) as renderer:
        return np.asarray(renderer.picture(time, degrees)).astype(int)


def is_empty(pixels):
    """Return which pixels of a picture on white are white."""
    return (pixels > 252).all(axis=-1)


def body(pixels):
    """Return the pixels of a dark picture that are not background, (n, 3)."""
    return pixels[np.abs(pixels - pixels[0, 0]).max(axis=-1) > 12]


def touches(empty):
    """Return the sides of a picture whose pixels are not all empty."""
    edges = {"top": empty[0], "bottom": empty[-1], "left": empty[:, 0], "right": empty[:, -1]}
    return [side for side, edge in edges.items() if not edge.all()]


def test_picture_equals_the_window(document):
    drawn(document, degrees=40)  # which must not change the rotation
    session = Session(EGG, "egg")
    session.restore(viewed(document, color_bar=False), {}, None)
    window = Window(session, opengl.OFFSCREEN_BACKEND, (900, 560))
    try:
        while window.shown.busy or not window.scene.paints:
            window.frame()
        window.tick()
        left, top, right, bottom = map(round, window.parts.scene)
        # as a user with the mouse
        window.scene.set_view(window.scene.view.turned("source", (100, 200), (140, 210)))
        window.scene.set_view(window.scene.view.zoomed("source", (150, 200), 1.3))
        window.tick()
        window.tick()
        shown = ps.screenshot_to_buffer(transparent_bg=False).astype(int)
        shown, seen = shown[top:bottom, left:right, :3], session.document
    finally:
        window.close()
    assert seen.view.viewpoint is not None
    picture = drawn(seen, (right - left, bottom - top), PictureOptions())
    assert picture.shape == shown.shape
    # without the names, which are slightly smaller in pictures
    picture, shown = picture[30:], shown[30:]
    assert np.abs(picture - shown).mean() < 0.25 * np.abs(255 - shown).mean()


def test_frames_show_exact_functions(document):
    with DocumentRenderer(document, {}, (64, 64)) as renderer:
        for time in (0.0, 0.613, 2.0, 3.7):
            renderer.picture(time)
            values = renderer._scene.paints["advected"].values
            # values of the solver have a lower accuracy
            at_tau = time == document.parameters.tau
            expected = document.result.advected[:, 0] if at_tau else document.result.advect(time)
            np.testing.assert_allclose(values, expected, rtol=1e-10, atol=1e-12)
    with DocumentRenderer(document, {}, (120, 80), SURFACES_ONLY) as renderer:
        frames = list(renderer.frames(0.0, 2.0, 3, 0.0))
        assert [frame.shape for frame in frames] == [(80, 120, 3)] * 3
        for frame, time in zip(frames, (0.0, 1.0, 2.0), strict=True):
            assert (frame == np.asarray(renderer.picture(time))).all()


@pytest.mark.usefixtures("coarse_streaks")
def test_moving_streaks_are_periodic_in_a_movie(document):
    streaks = viewed(document, streaks=True, animate=True, layout="advected only")
    with DocumentRenderer(streaks, {}, SIZE, SURFACES_ONLY) as renderer:
        frames = [frame.astype(int) for frame in renderer.frames(2.0, 2.0, 4, 0.0)]
        again = np.asarray(renderer.picture(2.0, phase=1.0)).astype(int)
        twice = [frame.astype(int) for frame in renderer.frames(2.0, 2.0, 4, 0.0, cycles=2)]
    steps = [np.abs(frames[i] - frames[i - 1]).mean() for i in range(4)]
    assert min(steps) > 0.1
    assert max(steps) < 1.3 * min(steps)
    assert (again == frames[0]).all()
    assert (twice[1] == frames[2]).all()


def test_error_range_is_constant_in_a_movie(document):
    with DocumentRenderer(viewed(document, error=True), {}, SIZE, SURFACES_ONLY) as renderer:
        ranges, largest = [], []
        for _ in renderer.frames(0.0, 2.0, 3, 0.0):
            ranges.append(renderer._scene.paints["error"].colors)
            largest.append(renderer._scene.paints["error"].values.max())
    f, g = document.result.source[:, 0], document.result.target[:, 0]
    assert len(set(ranges)) == 1
    assert (ranges[0].low, ranges[0].high) == (0, pytest.approx(abs(f - g).max()))
    assert largest[-1] < 0.5 * largest[0]


def test_names_and_color_bars_are_optional(document):
    bare, names, bars = (
        drawn(document, options=PictureOptions(color_bar=bar, labels=labels))
        for bar, labels in ((False, False), (False, True), (True, False))
    )
    source, target = map(rgb, (LIGHT_PALETTE.source, LIGHT_PALETTE.target))
    assert {source, target} <= set(map(tuple, names.reshape(-1, 3).tolist()))
    assert target not in set(map(tuple, bare.reshape(-1, 3).tolist()))
    assert not is_empty(bars[-50:, :200]).all()
    assert is_empty(names[-4:]).all()
    hidden = viewed(document, color_bar=False)
    assert (drawn(hidden, options=PictureOptions(labels=False)) == bare).all()


@pytest.mark.parametrize(
    ("layout", "size"),
    [("automatic", (480, 160)), ("automatic", (160, 480)), ("row", (300, 300)), ("column", SIZE)],
)
def test_all_surfaces_fit_in_any_size(document, layout, size):
    for viewpoint in (None, Viewpoint(front_of(EGG, view=ViewSpec("right")))):
        empty = is_empty(drawn(viewed(document, layout=layout, viewpoint=viewpoint), size))
        assert touches(empty) == []
        assert ndimage.label(ndimage.binary_dilation(~empty))[1] == 3


def test_dark_surfaces_have_the_colors_of_their_bars(document):
    dark = viewed(document, theme="dark")
    light, surface = drawn(viewed(document, theme="light")), body(drawn(dark))
    assert np.median(light[~is_empty(light)], axis=0).min() > 150
    assert 40 < np.median(surface, axis=0).max() < 120
    strip = drawn(dark, options=PictureOptions(labels=False))[-40:-14, 8:100].reshape(-1, 3)
    brightest = surface[surface.sum(axis=1).argmax()]
    directions = strip / np.linalg.norm(strip, axis=1)[:, None]
    assert (directions @ (brightest / np.linalg.norm(brightest))).max() > 0.98
    assert np.abs(strip - brightest).sum(axis=1).min() < np.abs(strip[0] - brightest).sum() / 2


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_lines_have_contrast_with_surfaces(document, theme):
    plain = drawn(viewed(document, theme=theme))
    for shown in ({"arrows": True}, {"coloring": "checker"}, {"isolines": True}):
        other = drawn(viewed(document, theme=theme, **shown))
        assert (np.abs(plain - other).max(axis=-1) > 40).sum() > 200
    if theme == "light":
        changed = (np.abs(plain - other).max(axis=-1) > 25)[~is_empty(plain)]
        assert 0.01 < changed.mean() < 0.2
        flat = replace(document, channels=(Channel("expression:1 + 0*x", "expression:1 + 0*x"),))
        lined, same = (drawn(viewed(flat, isolines=each), time=0.0) for each in (True, False))
        np.testing.assert_array_equal(lined, same)


def test_turning_surfaces_stay_in_the_picture(document):
    slab = ellipsoid(3, 0.3, 0.5, 1.0)
    deep = replace(viewed(document, layout="row"), surfaces=(Surface(slab, "slab"),), result=None)
    with DocumentRenderer(deep, {}, SIZE, TURNING) as renderer:
        first = np.asarray(renderer.picture(0.0, 0.0)).astype(int)
        widths = []
        for degrees in range(0, 360, 45):
            empty = is_empty(np.asarray(renderer.picture(0.0, degrees)))
            assert touches(empty) == []
            columns = np.diff(np.r_[True, empty.all(axis=0), True].astype(int))
            assert (columns == -1).sum() == 3  # three separate surfaces
            widths.append((~empty.all(axis=0)).sum())
        assert max(widths) > 2 * min(widths)
        assert np.abs(np.asarray(renderer.picture(0.0, 360.0)) - first).max() <= 2
    seen = drawn(
        viewed(document, viewpoint=Viewpoint(front_of(EGG, view=ViewSpec("top")))), options=TURNING
    )
    assert touches(is_empty(seen)) == []
    assert np.abs(seen - drawn(document, options=TURNING)).mean() > 1


def test_bad_pictures_are_refused(document):
    with raises(ParameterError, "9000x20", 16, 8192):
        DocumentRenderer(document, {}, (9000, 20))
    velocity = 1e12 * document.result.velocity
    wild = replace(document, result=replace(document.result, fine_velocity=velocity))
    unknown = replace(document, channels=(Channel("gaussian:vertex=99999", CHANNEL.target),))
    for drawn, time, error, named in (
        (document, -0.1, ParameterError, (0, 4)),
        (document, 4.1, ParameterError, (0, 4)),
        (unknown, 0.0, FunctionError, ("gaussian:vertex=99999",)),
        (wild, 1.0, AbfmError, (1,)),
    ):
        with raises(error, *named), DocumentRenderer(drawn, {}, (64, 64)) as renderer:
            renderer.picture(time)
