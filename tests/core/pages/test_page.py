"""HTML of pages: limited size, escaped texts, and no external resources."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

import abfm
from abfm import ParameterError
from abfm.pages import Clock, Labels, Layer, Page, Panel, Paths, Span, match_page
from abfm.pages.colormaps import ColorRange
from abfm.pages.front import Front
from abfm.pages.packing import Store, quantized
from abfm.pages.sequence_pages import PART_VALUES_MAX, VALUES_MAX, frame_layers
from abfm.wording import capital
from tests.messages import check_message, raises
from tests.shapes import icosphere

FRONT = Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
COLORS = ColorRange("abfm diverging", -1.0, 1.0)
EVIL = "</script><script>document.title='broken'</script><img src=x onerror=1> & \"quoted\" 'too'"


class Parts(HTMLParser):
    """Texts of a page by their tag and id, and all attributes."""

    def __init__(self, text):
        super().__init__()
        self.texts, self.attributes, self._now = {}, [], ("", "")
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, *each) for each in attrs]
        self._now = tag, dict(attrs).get("id", "")
        self.texts.setdefault(self._now, "")

    def handle_endtag(self, tag):
        self._now = "", ""

    def handle_data(self, data):
        if self._now in self.texts:
            self.texts[self._now] += data


def wave(mesh, count):
    angle = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    return np.cos(3 * angle - 2 * np.pi * np.linspace(0, 1, count)[:, None]) * np.hypot(
        *mesh.vertices[:, :2].T
    )


def page_of(mesh, values, times, **more):
    layer = Layer(EVIL, values, COLORS, times, EVIL)
    clock = Clock(0.0, float(times[-1]), ticks=times, spans=[Span(0.0, 1.0, EVIL)], unit=EVIL)
    paths = Paths.points(EVIL, mesh.vertices[:2], (0.0, 1.0), (1.0, 0.0, 0.0))
    panel = Panel(EVIL, mesh, [layer], FRONT, [paths])
    return Page(EVIL, EVIL, [panel], clock, about=EVIL, facts={EVIL: EVIL}, notes=[EVIL], **more)


@pytest.fixture(scope="module")
def text():
    mesh, times = icosphere(2), np.linspace(0, 1, 5)
    return page_of(mesh, wave(mesh, 5), times).html()


def test_page_of_60_frames_is_below_2_megabytes():
    mesh = icosphere(5)
    rng = np.random.default_rng(0)
    noisy = wave(mesh, 60) + 0.1 * rng.normal(size=(60, 10_242))
    size = len(page_of(mesh, noisy, np.linspace(0, 1, 60)).html().encode())
    assert size < 2_000_000


def test_page_of_noise_is_below_14_megabytes():
    """A page with the maximum number of values, which are noise, is below 14 MB."""
    store, noise = Store(), np.random.default_rng(0).uniform(size=(20, 10_000))
    store.add(quantized(noise).numbers)
    values_max = VALUES_MAX + 2 * PART_VALUES_MAX
    assert values_max * len(store.text()) / noise.size < 14_000_000


def test_user_texts_are_escaped(text):
    parts = Parts(text)
    scripts = re.findall(r"<script[^>]*>", text)
    assert len(scripts) == 3
    assert text.count("</script>") == 3
    assert parts.texts["h1", ""] == EVIL
    assert "img" not in {tag for tag, *_ in parts.attributes}
    assert not [name for _, name, _ in parts.attributes if name.startswith("on")]
    data = json.loads(parts.texts["script", "page"])
    assert data["panels"][0]["title"] == data["panels"][0]["layers"][0]["unit"] == EVIL
    assert data["clock"]["spans"][0]["text"] == data["panels"][0]["paths"][0]["name"] == EVIL


def test_policy_allows_only_script_and_style_of_the_page(text):
    parts = Parts(text)
    policy = next(v for tag, name, v in parts.attributes if (tag, name) == ("meta", "content"))
    hashes = {
        tag: base64.b64encode(hashlib.sha256(parts.texts[tag, ""].encode()).digest()).decode()
        for tag in ("script", "style")
    }
    assert policy == (
        f"default-src 'none'; script-src 'sha256-{hashes['script']}'; "
        f"style-src 'sha256-{hashes['style']}'; base-uri 'none'; form-action 'none'"
    )
    assert {name for _, name, _ in parts.attributes} & {"src", "href", "style", "action"} == set()


def test_equal_pages_have_equal_bytes(text):
    mesh, times = icosphere(2), np.linspace(0, 1, 5)
    assert page_of(mesh, wave(mesh, 5), times).html() == text


def test_shared_mesh_is_stored_once():
    mesh = icosphere(4)
    panel = Panel("a", mesh, [Layer("f", mesh.vertices[:, 0], COLORS)], FRONT)
    one, two = (len(Page("t", "h", [panel] * count).html()) for count in (1, 2))
    assert two - one < 0.2 * one
    data = json.loads(Parts(Page("t", "h", [panel] * 2).html()).texts["script", "page"])
    assert [each["mesh"] for each in data["panels"]] == [0, 0]
    assert len(data["meshes"]) == 1


def test_inconsistent_frames_and_times_are_refused():
    mesh = icosphere(1)
    layer = Layer("f", wave(mesh, 3), COLORS, np.array([0.0, 1.0]))
    page = Page("t", "h", [Panel("a", mesh, [layer], FRONT)])
    with raises(ParameterError, "f", 3, 2):
        page.html()
    with raises(ParameterError):
        Clock(1.0, 1.0)


class WaveSequence:
    """A rotating wave with exact values at all times."""

    unknown = None

    def __init__(self, mesh, count):
        self.mesh, self.times, self.requested = mesh, np.linspace(2.0, 3.0, count), []
        self.frames = np.stack([self.exact(t) for t in self.times])[:, :, None]

    def exact(self, t):
        angle = np.arctan2(self.mesh.vertices[:, 1], self.mesh.vertices[:, 0])
        return np.cos(2 * angle - 6 * t)

    def at(self, t):
        self.requested.append(t)
        return self.exact(t)[:, None]


def test_keys_between_frames_are_interpolated():
    waves = WaveSequence(icosphere(2), 6)
    [layer], notes = frame_layers(waves, Labels(["potential"], "mV"))
    assert not notes
    assert (layer.name, layer.unit) == ("potential", "mV")
    np.testing.assert_allclose(layer.times, np.linspace(2, 3, 21), rtol=1e-12)
    np.testing.assert_allclose(layer.values, [waves.exact(t) for t in layer.times], atol=1e-12)
    assert not set(waves.requested) & set(waves.times)


def test_many_frames_are_subsampled_with_a_note(monkeypatch):
    monkeypatch.setattr("abfm.pages.sequence_pages.VALUES_MAX", 5 * 42)
    waves = WaveSequence(icosphere(1), 12)
    [layer], [note] = frame_layers(waves, Labels())
    assert len(layer.times) <= 5
    assert (layer.times[0], layer.times[-1]) == (2.0, 3.0)
    np.testing.assert_allclose(layer.values, [waves.exact(t) for t in layer.times], atol=1e-12)
    check_message(note, 3, len(layer.times))
    assert waves.requested == []


def test_page_of_a_match_advects_source_to_target():
    mesh = icosphere(3)
    f, g = (abfm.function(mesh, f"gaussian:vertex={v},width=0.12") for v in (5, 60))
    match = abfm.match(mesh, f, g, abfm.Parameters.of(iterations=12, refine=0))
    page = match_page(match, "a match")
    names = [panel.title for panel in page.panels]
    assert names == ["source", "advected", "target"]
    assert f"<h4>{capital(match.verdict.topic)}</h4>" in page.html()
    source, advected, target = (panel.layers[0] for panel in page.panels)
    np.testing.assert_allclose(advected.values[0], source.values, atol=1e-12)
    np.testing.assert_allclose(advected.values[-1], match.advected[:, 0], atol=1e-9)
    np.testing.assert_array_equal(target.values, match.target[:, 0])
    assert source.colors == advected.colors == target.colors
    flow_lines = page.panels[1].paths[0]
    radii = np.linalg.norm(flow_lines.starts, axis=1)
    assert np.abs(radii - 1).max() < 0.02  # on the sphere
