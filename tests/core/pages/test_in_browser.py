"""Pages in a browser: pixels, controls, and no access to the network."""

from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from threading import Thread

import numpy as np
import pytest

from abfm import TriangleMesh
from abfm.batch import LedgerEntry, Row
from abfm.outcome import Facts, Outcome
from abfm.pages import Clock, Layer, Page, Panel, Paths, Span
from abfm.pages.colormaps import ColorRange, linear_table
from abfm.pages.front import Front
from abfm.population.report import details
from abfm_viewer.reports.batches import SummaryRow, batch_page
from abfm_viewer.reports.pages import population_page
from tests.core.pages.browser import SIZE, ActionChains, Keys, Shown, browser
from tests.core.pages.test_notebook import small_population
from tests.shapes import hemisphere, icosphere

FRONT = Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
COLORS = ColorRange("abfm sequential", 0.0, 1.0)
BALL = icosphere(4)
TIMES = np.array([10.0, 11.0, 14.0])
LIGHT = 0.35 + 0.65 * (0.5 + 0.5 * 0.76)  # of a surface that faces the viewer
EVIL = "</script><script>document.title='broken'</script> & \"quoted\""


def color_of(value, colormap="abfm sequential"):
    """Return the color, 0 to 255, of a value, 0 to 1, where the surface faces the viewer."""
    table = linear_table(colormap, 256)
    places = np.arange(256) / 255
    linear = LIGHT * np.array([np.interp(value, places, channel) for channel in table.T])
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def even(*values):
    return np.array(values)[:, None] * np.ones(len(BALL.vertices))


def sided(one, other):
    """Return one value where x is negative, and another where it is positive."""
    return np.where(BALL.vertices[:, 0] < 0, one, other)


LAYERS = [
    Layer("first", even(0.0, 1.0, 0.4), COLORS, TIMES, "mV"),
    Layer("second", even(0.7)[0], COLORS),
]
SPANS = [Span(10.0, 11.0, "early"), Span(11.0, 14.0, "late")]
CLOCK = Clock(10.0, 14.0, 2.0, "s", ticks=TIMES, spans=SPANS)
RED = (1.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def driver():
    with browser() as opened:
        yield opened


@pytest.fixture
def open_page(driver, tmp_path):
    def opened(page, **more):
        page.write(tmp_path / "page.html")
        return Shown(driver, (tmp_path / "page.html").as_uri(), **more)

    return opened


def page(*panels, clock=CLOCK):
    return Page("a page", "a headline", panels or [Panel("ball", BALL, LAYERS, FRONT)], clock)


def test_time_bar_interpolates_frames(open_page):
    shown = open_page(page())
    np.testing.assert_allclose(shown.centre(), color_of(0.0), atol=4)
    shown.go(Keys.END, 14.0)
    np.testing.assert_allclose(shown.centre(), color_of(0.4), atol=4)
    assert shown.find("#now").text == "14.00 s"
    assert shown.find("#span").text == "late"
    shown.go(Keys.ARROW_LEFT, 11.0)
    np.testing.assert_allclose(shown.centre(), color_of(1.0), atol=4)
    left, top, right, bottom = shown.boxes("#time")[0]
    mouse = ActionChains(shown.driver)
    mouse.w3c_actions.pointer_action.move_to_location(
        round((left + right) / 2), round((top + bottom) / 2)
    ).click()
    mouse.perform()
    shown.until(lambda: abs(shown.drawn() - 12) < 0.1)
    value = np.interp(shown.drawn(), TIMES, [0.0, 1.0, 0.4])
    np.testing.assert_allclose(shown.centre(), color_of(value), atol=4)
    assert shown.log() == []


def test_playing_pauses_at_the_end_unless_looping(open_page):
    shown = open_page(page())
    shown.find("#play").click()
    shown.until(lambda: shown.drawn() > 10.5)
    shown.press(Keys.SPACE)
    shown.until(lambda: shown.find("#play").get_attribute("aria-label") == "Play")
    stopped = shown.drawn()
    assert 10.5 < stopped < 14
    shown.press("l")
    assert shown.find("#loop").get_attribute("aria-pressed") == "false"
    shown.press(Keys.SPACE)
    assert shown.find("#play").get_attribute("aria-label") == "Pause"
    shown.until(lambda: shown.find("#play").get_attribute("aria-label") == "Play")
    shown.until(lambda: shown.drawn() == 14)
    np.testing.assert_allclose(shown.centre(), color_of(0.4), atol=4)
    shown.press("l", Keys.SPACE)  # playing restarts from the end
    shown.until(lambda: shown.drawn() < 14)
    shown.press(Keys.END)
    shown.until(lambda: shown.drawn() < 13)  # the loop restarts


def test_panels_rotate_together_and_reset(open_page):
    one = Panel("one", BALL, [Layer("f", sided(0.2, 0.9), COLORS)], FRONT)
    shown = open_page(page(one, replace(one, title="two")))
    before = [shown.surface(number) for number in range(2)]
    np.testing.assert_allclose(before[0], before[1], atol=3)
    assert np.abs(before[0][:, :100] - before[0][:, -1:-101:-1]).max() > 50  # two sides, two colors
    shown.drag(0, 40, 0)
    turned = [shown.surface(number) for number in range(2)]
    assert np.abs(turned[0] - before[0]).max() > 50
    np.testing.assert_allclose(turned[0], turned[1], atol=3)
    shown.press("r")
    np.testing.assert_allclose(shown.surface(1), before[1], atol=3)


def test_half_a_rotation_shows_the_other_side(open_page):
    value = np.where(BALL.vertices[:, 2] < 0, 0.2, 0.9)
    shown = open_page(page(Panel("ball", BALL, [Layer("f", value, COLORS)], FRONT)))
    np.testing.assert_allclose(shown.centre(), color_of(0.9), atol=4)
    left, top, right, bottom = shown.boxes()[0]
    shown.drag(0, round(min(right - left, bottom - top) / 2), 0)
    shown.drag(0, round(min(right - left, bottom - top) / 2), 0)
    np.testing.assert_allclose(shown.centre(), color_of(0.2), atol=4)


@pytest.mark.parametrize("name", "xyz")
def test_up_axis_rotates_all_panels(open_page, name):
    value = np.where(BALL.vertices[:, "xyz".index(name)] < 0, 0.2, 0.9)
    tilted = Front((0.0, 0.6, 0.8), (0.0, 0.8, -0.6))
    one = Panel("one", BALL, [Layer("f", value, COLORS)], tilted)
    shown = open_page(page(one, replace(one, title="two")))
    shown.find("#up").send_keys(f"{name} up")
    for number in range(2):
        above, below = np.array_split(shown.surface(number, 0.2), 2)
        for half, expected in ((above, 0.9), (below, 0.2)):
            hue = np.median(half.reshape(-1, 3), axis=0) - np.median(color_of(expected))
            expected_hue = color_of(expected) - np.median(color_of(expected))
            other = color_of(1.1 - expected) - np.median(color_of(1.1 - expected))
            assert np.linalg.norm(hue - expected_hue) < np.linalg.norm(hue - other)


def covered(shown):
    """Return the fraction of a panel that is not white."""
    return (shown.surface().min(axis=2) < 250).mean()


def test_wheel_touch_and_keys_zoom(open_page):
    shown = open_page(page())
    before = covered(shown)
    shown.press("-")
    assert covered(shown) == pytest.approx(before / 1.44, rel=0.03)
    shown.press("+")
    assert covered(shown) == pytest.approx(before, rel=0.01)
    left, top, right, bottom = shown.boxes()[0]
    x, y = round((left + right) / 2), round((top + bottom) / 2)
    mouse = ActionChains(shown.driver)
    mouse.w3c_actions.wheel_action.scroll(x, y, 0, 200)
    mouse.perform()
    smaller = covered(shown)
    assert smaller < 0.8 * before
    moves = ("touchMove", 60), ("touchMove", 80)
    for kind, distance in (("touchStart", 40), *moves, ("touchEnd", 0)):
        points = [{"x": x - distance, "y": y, "id": 0}, {"x": x + distance, "y": y, "id": 1}]
        touch = {"type": kind, "touchPoints": points if distance else []}
        shown.driver.execute_cdp_cmd("Input.dispatchTouchEvent", touch)
    assert covered(shown) > 1.5 * smaller


def test_mouse_shows_values(open_page):
    layer = Layer("f", sided(0.25, 0.75), COLORS, unit="mV")
    shown = open_page(page(Panel("ball", BALL, [layer], FRONT)))
    left, top, right, bottom = shown.boxes()[0]
    for dx, expected in ((-60, "0.25"), (60, "0.75")):
        mouse = ActionChains(shown.driver)
        mouse.w3c_actions.pointer_action.move_to_location(
            round((left + right) / 2 + dx), round((top + bottom) / 2)
        )
        mouse.perform()
        shown.until(lambda: shown.find("#tip").is_displayed())
        vertex, value = shown.find("#tip").text.split(": ")
        assert value == f"{expected} mV"
        assert np.sign(BALL.vertices[int(vertex.split()[1]), 0]) == np.sign(dx)


def clicked(shown, dx):
    left, top, right, bottom = shown.boxes()[0]
    x, y = round((left + right) / 2 + dx), round((top + bottom) / 2)
    mouse = ActionChains(shown.driver)
    mouse.w3c_actions.pointer_action.move_to_location(x, y).click()
    mouse.perform()


def test_click_plots_a_value_over_time(open_page):
    values = np.array([0.0, 1.0, 0.4])[:, None] * sided(10.0, -10.0)
    layer = Layer("f", values, ColorRange("viridis", -10.0, 10.0), TIMES, "mV")
    shown = open_page(page(Panel("ball", BALL, [layer], FRONT)))
    for dx, heights in ((60, [0.0, -10.0, -4.0]), (-60, [0.0, 10.0, 4.0])):
        clicked(shown, dx)
        shown.until(lambda: shown.find("#plot").is_displayed())
        places = [pair.split(",") for pair in shown.find("#curve").get_attribute("points").split()]
        x, y = np.array(places, dtype=float).T
        np.testing.assert_allclose(x, [0, 25, 100])
        low, high = min(heights), max(heights)
        np.testing.assert_allclose(y, 46 - 42 * (np.array(heights) - low) / (high - low), atol=0.02)
        labels = [
            shown.find(each).text.replace("\u2212", "-") for each in ("#plot-max", "#plot-min")
        ]
        assert [float(label) for label in labels] == pytest.approx([high, low], abs=0.01)
        shown.go(Keys.ARROW_RIGHT, 11.0)
        assert shown.find("#cursor").get_attribute("x1") == "25"
        now = shown.find("#plot-title").text.split(": ")[1]
        assert now.replace("\u2212", "-") == f"{heights[1]:g} mV"
        assert shown.find("#tip").text == shown.find("#plot-title").text
        shown.go(Keys.HOME, 10.0)
    left, _, right, _ = shown.boxes("#marker")[0]
    assert (left + right) / 2 == pytest.approx(sum(shown.boxes()[0][::2]) / 2 - 60, abs=10)
    clicked(shown, -0.45 * SIZE[0])  # a click outside the surface
    shown.until(lambda: not shown.find("#plot").is_displayed())


def test_layer_changes_colors_and_color_bar(open_page):
    warmth = ColorRange("viridis", -10.0, 10.0)
    layers = [LAYERS[0], Layer("second", even(5.0)[0], warmth, unit="K")]
    shown = open_page(page(Panel("ball", BALL, layers, FRONT)))
    assert shown.find("#bars").text.split("\n")[0] == "first, mV"
    shown.find("#layer").send_keys("second")
    shown.until(lambda: shown.find("#bars").text.startswith("second, K"))
    labels = shown.driver.find_elements("css selector", ".end")
    assert [label.text for label in labels] == ["\u221210", "0", "10"]
    np.testing.assert_allclose(shown.centre(), color_of(0.75, "viridis"), atol=4)


@pytest.mark.parametrize(
    ("mesh", "front"),
    [
        (hemisphere(20), FRONT),
        (hemisphere(20), Front((0.0, 0.0, -1.0), (0.0, 1.0, 0.0))),
        (TriangleMesh(BALL.vertices, BALL.faces[:, ::-1]), FRONT),
    ],
    ids=["outside", "inside", "inside out"],
)
def test_side_that_faces_the_viewer_is_visible(open_page, mesh, front):
    value = np.where(mesh.vertices[:, 2] < -1e-9, 0.2, 0.9)
    shown = open_page(page(Panel("surface", mesh, [Layer("f", value, COLORS)], front)))
    np.testing.assert_allclose(shown.centre(), color_of(0.9), atol=4)


def test_lost_graphics_context_is_restored(open_page):
    shown = open_page(page())
    graphics = "document.querySelector('canvas').getContext('webgl2')"
    shown.script(f"(window.lost = {graphics}.getExtension('WEBGL_lose_context')).loseContext()")
    shown.until(lambda: shown.script(f"{graphics}.isContextLost()"))
    shown.script("window.lost.restoreContext()")
    shown.until(lambda: np.allclose(shown.centre(), color_of(0.0), atol=4))
    shown.go(Keys.END, 14.0)
    np.testing.assert_allclose(shown.centre(), color_of(0.4), atol=4)


def test_unknown_values_are_grey(open_page):
    shown = open_page(page(Panel("ball", BALL, [Layer("f", sided(np.nan, 0.9), COLORS)], FRONT)))
    surface = shown.surface()
    ours = surface[surface.min(axis=2) < 250]
    is_grey = np.ptp(ours, axis=1) < 8
    assert 0.4 < is_grey.mean() < 0.6


def test_known_colors_extend_to_unknown_values(open_page):
    """Next to grey faces without a value, faces have the colour of the value, without a mixture."""
    shown = open_page(page(Panel("ball", BALL, [Layer("f", sided(np.nan, 0.0), COLORS)], FRONT)))
    surface = shown.surface(across=0.6)
    hues = np.ptp(surface[surface.min(axis=2) < 250], axis=1)
    assert hues.max() < np.ptp(color_of(0.0)) + 12 < np.ptp(color_of(1.0)) - 50


@pytest.mark.parametrize("start", [1.7e9, 0.0, -3e4])
@pytest.mark.parametrize("unit", [1e-3, 1e-9])
def test_times_of_any_size_are_distinguished(open_page, start, unit):
    times = start + (unit if abs(start) < 1e4 else 1e-3) * (TIMES - 10)
    paths = [Paths.points("dot", np.array([[0.0, 0.0, 1.0]]), times[[1, 1]], RED, disc=8.0)]
    layer = Layer("f", even(0.0, 1.0, 0.4), COLORS, times)
    clock = Clock(times[0], times[-1], ticks=times)
    shown = open_page(page(Panel("ball", BALL, [layer], FRONT, paths), clock=clock))
    shown.press(Keys.ARROW_RIGHT)
    shown.until(lambda: shown.drawn() == times[1])
    surface = shown.surface(across=0.2)
    np.testing.assert_allclose(np.median(surface.reshape(-1, 3), axis=0), color_of(1.0), atol=4)
    assert (surface[:, :, 0] > 240).sum() > 50  # the dot of the current value
    texts = {shown.find("#now").text}
    shown.press(Keys.END)
    shown.until(lambda: shown.drawn() == times[-1])
    texts.add(shown.find("#now").text)
    assert len(texts) == 2
    assert all(len(text) < 20 for text in texts)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (-1e12, 1e12, ["−1e12", "0", "1e12"]),
        (-1000001.0, -999999.0, ["−1000001", "−1000000", "−999999"]),
        (0.0, 2e-7, ["0", "1e−7", "2e−7"]),
        (1012.0, 1013.0, ["1012", "1012.5", "1013"]),
    ],
)
def test_labels_of_color_bar_are_short_and_distinct(open_page, low, high, expected):
    values = low + (high - low) * sided(0.0, 1.0)
    layer = Layer("f", values, ColorRange("viridis", low, high))
    shown = open_page(page(Panel("ball", BALL, [layer], FRONT)))
    ends = shown.driver.find_elements("css selector", ".end")
    assert [each.text for each in ends] == expected
    boxes = shown.boxes(".end")
    assert all(one[2] <= other[0] for one, other in pairwise(boxes))


def test_arrows_are_visible_in_their_interval(open_page):
    """Arrows appear in their interval, but not on parts of the surface that are seen steeply."""
    tips = np.array([[0.2, 0.0, 1.1], [-0.2, 0.4, 1.1]])

    def arrows(name, times, color, normal):
        starts, sizes = np.array([[-0.2, 0.0, 1.1]] * 2), {"disc": 0.0, "line": 0.0, "arrow": 6.0}
        return Paths(name, starts, tips, times, color, normals=np.array([normal] * 2), **sizes)

    in_turn, steep = np.array([TIMES[:2], TIMES[1:]]), np.array([TIMES[[0, 2]]] * 2)
    paths = [
        arrows("arrows", in_turn, RED, (0.0, 0.0, 1.0)),
        arrows("steep", steep, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
    ]
    light = Layer("f", even(0.0)[0], COLORS)
    shown = open_page(page(Panel("ball", BALL, [light], FRONT, paths)))

    def reds():
        colors = shown.surface(across=0.8)
        assert not ((colors[:, :, 2] > 200) & (colors[:, :, :2].max(axis=2) < 60)).any()
        return np.nonzero((colors[:, :, 0] > 200) & (colors[:, :, 1:].max(axis=2) < 60))

    def widths(rows, columns):
        return [np.ptp(rows[columns == column]) + 1 for column in np.unique(columns)]

    rows, columns = reds()
    assert np.ptp(columns) > 3 * np.ptp(rows)  # the arrow is horizontal
    wide = widths(rows, columns)
    assert np.median(wide[: len(wide) // 3]) == pytest.approx(6, abs=1.5)  # shaft
    assert max(wide[len(wide) // 2 :]) > 12  # head
    assert wide[-1] < 5  # tip
    shown.go(Keys.ARROW_RIGHT, 11.0)  # the next arrow is visible from its start
    rows, columns = reds()
    assert np.ptp(rows) > 3 * np.ptp(columns)  # the arrow is vertical
    shown.go(Keys.END, 14.0)
    assert len(reds()[0]) == len(rows)


def test_lines_have_round_joints(open_page):
    """The pixels around a sharp corner of a line are covered like a disc."""
    corner, width = np.array([0.0, 0.0, 1.1]), 16.0
    for turned in (-0.4, 0.3):
        points = np.array([[-0.5, -0.1, 1.1], corner, [turned, 0.5, 1.1]])
        paths = [Paths.along("path", [(TIMES, points)], RED, disc=0.0, line=width)]
        light = Layer("f", even(0.0)[0], COLORS)
        shown = open_page(page(Panel("ball", BALL, [light], FRONT, paths)))
        shown.go(Keys.END, 14.0)
        colors = shown.surface(across=0.5)
        rows, columns = np.mgrid[: colors.shape[0], : colors.shape[1]]
        far = np.hypot(rows - colors.shape[0] / 2 + 0.5, columns - colors.shape[1] / 2 + 0.5)
        disc = colors[far < width / 2 - 1.5]
        assert ((disc[:, 0] > 240) & (disc[:, 1:].max(axis=1) < 60)).all()


def test_points_appear_and_paths_grow(open_page):
    front = np.array([[0.0, 0.0, 1.0]])
    path = np.stack([np.sin([-0.5, 0.0, 0.5]), np.zeros(3), np.cos([-0.5, 0.0, 0.5])], axis=1)
    paths = [
        Paths.points("dots", front, (11.0, 13.0), RED, disc=8.0),
        Paths.along("tracks", [(TIMES, path)], (0.0, 0.0, 1.0), disc=0.0, line=6.0),
    ]
    clock = replace(CLOCK, ticks=[10.0, 11.0, 12.0, 14.0])
    light = Layer("f", even(0.0)[0], COLORS)
    shown = open_page(page(Panel("ball", BALL, [light], FRONT, paths), clock=clock))

    def seen(channel):
        colors = shown.surface()
        others = [k for k in range(3) if k != channel]
        return ((colors[:, :, channel] > 200) & (colors[:, :, others].max(axis=2) < 60)).sum()

    assert (seen(0), seen(2)) == (0, 0)
    shown.go(Keys.ARROW_RIGHT, 11.0)
    half = seen(2)
    assert seen(0) > 50
    assert half > 50
    shown.go(Keys.END, 14.0)
    assert seen(0) == 0
    assert seen(2) > 1.7 * half
    shown.find("#paths label:nth-child(2)").click()
    assert seen(2) == 0


def test_surface_hides_points_behind_it(open_page):
    paths = [Paths.points("dots", np.array([[0.0, 0.0, -1.0]]), (0.0, 99.0), RED, disc=8.0)]
    shown = open_page(page(Panel("ball", BALL, [LAYERS[1]], FRONT, paths)))
    np.testing.assert_allclose(shown.centre(), color_of(0.7), atol=4)


def test_page_has_no_access_to_the_network(open_page, driver, tmp_path):
    shown = open_page(page())
    shown.go(Keys.END, 14.0)
    assert shown.requests() == [(tmp_path / "page.html").as_uri()]
    requested = []

    class Handler(SimpleHTTPRequestHandler):
        def do_GET(self):
            requested.append(self.path)
            super().do_GET()

        def log_message(self, *words):
            pass

    handler = partial(Handler, directory=tmp_path)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        served = Shown(driver, f"http://127.0.0.1:{server.server_port}/page.html")
        np.testing.assert_allclose(served.centre(), color_of(0.0), atol=4)
        refused = 'fetch("/other").then(() => "answered", (error) => error.name)'
        assert served.script(refused) == "TypeError"
        server.shutdown()
    assert requested == ["/page.html"]


def test_user_texts_are_escaped(open_page):
    layer = replace(LAYERS[0], name=EVIL, unit=EVIL)
    clock = replace(CLOCK, unit=EVIL, spans=[Span(10.0, 14.0, EVIL)])
    paths = [Paths.points(EVIL, BALL.vertices[:1], (0.0, 99.0), RED)]
    given = Page(EVIL, EVIL, [Panel(EVIL, BALL, [layer], FRONT, paths)], clock, about=EVIL)
    shown = open_page(given)
    assert shown.driver.title == EVIL
    for selector in ("h1", ".headline", ".about", "figcaption", "#span", "#paths label"):
        assert shown.find(selector).text == EVIL
    assert shown.find("#now").text == f"10.00 {EVIL}"
    assert shown.log() == []


def test_missing_webgl_is_reported(open_page, driver):
    text = "HTMLCanvasElement.prototype.getContext = () => null"
    command = "Page.addScriptToEvaluateOnNewDocument"
    added = driver.execute_cdp_cmd(command, {"source": text})
    try:
        shown = open_page(page(), ready="!document.querySelector('#problem').hidden")
        assert "WebGL2" in shown.find("#problem").text
        assert not shown.find("#stage").is_displayed()
    finally:
        driver.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)


@pytest.mark.parametrize("size", [(390, 844), (1600, 500)])
def test_layout_fits_phone_and_wide_screens(open_page, size):
    one = Panel("one", BALL, [LAYERS[1]], FRONT)
    shown = open_page(page(one, replace(one, title="two"), replace(one, title="three")))
    shown.resize(*size)
    is_portrait = size[0] < size[1]
    shown.until(lambda: len({top for _, top, _, _ in shown.boxes()}) == (3 if is_portrait else 1))
    boxes = [*shown.boxes(), *shown.boxes("#controls"), *shown.boxes("#play"), *shown.boxes("#now")]
    for left, top, right, bottom in boxes:
        assert 0 <= left < right <= size[0]
        assert 0 <= top < bottom <= size[1]
    assert shown.script("document.documentElement.scrollWidth") <= size[0]
    for number in range(3):
        np.testing.assert_allclose(shown.centre(number), color_of(0.7), atol=4)


def test_static_pages_fit_a_phone(driver, tmp_path):
    row = Row("one", {"mesh": "a" * 60 + ".off", "source": "file:f.npy", "target": "file:g.npy"})
    reason = "a/" * 60 + "b.off: there is no such file"
    failed = SummaryRow(LedgerEntry(row, "failed"), Facts(Outcome.FAILED, "failed", reason))
    names = {"table": "t" * 60, "template": "mean.gii"}
    found = small_population()
    of_population = population_page(names | details(found), found.facts, None)
    for text in (of_population, batch_page("t.csv", [failed] * 2, {}, "")):
        (tmp_path / "static.html").write_text(text, encoding="utf-8")
        shown = Shown(driver, (tmp_path / "static.html").as_uri(), ready="true")
        shown.resize(390, 844, touch=True)
        shown.until(partial(shown.script, "innerWidth === 390"))
        assert shown.script("document.documentElement.scrollWidth") == 390


def test_notebook_view_is_drawn_in_its_frame(driver, tmp_path):
    file = tmp_path / "notebook.html"
    file.write_text(f"<!doctype html><meta charset=utf-8>{BALL._repr_html_()}", encoding="utf-8")
    shown = Shown(driver, file.as_uri(), ready="document.querySelector('iframe') !== null")
    driver.switch_to.frame(shown.find("iframe"))
    try:
        shown.until(lambda: shown.script("document.body.dataset.drawn !== undefined"))
        assert not shown.find("header").is_displayed()
        assert not shown.find("#bars").text  # without values there is no color bar
        middle = shown.find("#stage").rect
    finally:
        driver.switch_to.default_content()
    frame = shown.find("iframe").rect
    x, y = (
        round(frame[at] + middle[at] + middle[size] / 2)
        for at, size in (("x", "width"), ("y", "height"))
    )
    grey = shown.picture()[y - 5 : y + 5, x - 5 : x + 5].reshape(-1, 3)
    assert np.ptp(grey, axis=1).max() < 10
    assert 100 < grey.mean() < 230


def test_color_bar_has_arrows_at_clipped_ends(open_page):
    colors = ColorRange("viridis", 0.0, 1.0, 0.0, 50.0)
    shown = open_page(page(Panel("ball", BALL, [Layer("f", sided(0.0, 50.0), colors)], FRONT)))
    ends = shown.driver.find_elements("css selector", ".end")
    assert [each.text for each in ends] == ["0", "0.5", "1"]
    strip = shown.find(".strip")
    assert strip.get_attribute("title") == "Values range from 0 to 50."
    assert "clips-high" in strip.get_attribute("class")
    assert "clips-low" not in strip.get_attribute("class")
    assert 8 < strip.size["height"] < 16
    clicked(shown, 60)
    shown.until(lambda: shown.find("#plot").is_displayed())
    assert shown.find("#plot-title").text.split(": ")[1] in ("0", "50")
