"""`abfm report`, run in this process on small spheres, with small pictures."""

import base64
import io
import json
from dataclasses import replace
from html.parser import HTMLParser
from importlib.metadata import version
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import abfm as library
from abfm import Correspondence, Parameters, PointMap, TriangleMesh
from abfm.maps import project_onto_surface
from abfm.mesh.shapes import even_sphere
from abfm.registration.symmetric import SymmetricRegistration
from abfm_viewer import pictures
from abfm_viewer.errors import DrawingError
from tests.messages import check_message, check_names
from tests.processes import argv
from tests.shapes import icosphere

A, B = even_sphere(400), icosphere(2)
BRIEF = Parameters.of(iterations=60, refine=0, levels=1, sigma=1, cooling_stages=3, order=1)
TITLE = '<i>"A" & B</i>'
SMALL = ["--width", "40", "--quiet"]


class Page(HTMLParser):
    """A page whose tags are balanced: its text, pictures by what they show, facts and links."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.text, self.facts = [], "", ""
        self.tags, self.links, self.pictures = [], [], {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        named = dict(attributes)
        self.tags.append(tag)
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag == "script":
            assert named == {"type": "application/json", "id": "facts"}
        self.links += [named[name] for name in ("src", "href", "action", "data") if name in named]
        if tag == "img":
            kind, _, data = named["src"].partition(",")
            assert kind == "data:image/png;base64"
            assert named["alt"] not in self.pictures
            self.pictures[named["alt"]] = pixels(base64.b64decode(data, validate=True))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "script" in self.open:
            self.facts += data
        elif "style" in self.open:
            assert "url(" not in data
            assert "@import" not in data
        else:
            self.text += data


def pixels(png):
    with Image.open(io.BytesIO(png)) as image:
        assert image.format == "PNG"
        return np.asarray(image.convert("RGB")).astype(float)


def waves(directions):
    x, y, z = directions.T
    return np.stack([np.sin(3 * x) + y, z * x], axis=1)


@pytest.fixture(scope="module")
def registered():
    bent = B.vertices + [0.15, 0, 0.1] * np.sin(3 * B.vertices[:, [1]])
    bent /= np.linalg.norm(bent, axis=1)[:, None]
    return library.register(
        A, B, waves(A.vertices), waves(bent), initial="closest", parameters=BRIEF
    )


@pytest.fixture(scope="module")
def written(registered, tmp_path_factory):
    """The folder with the registration's file, and its page."""
    from abfm_viewer.cli import main

    folder = tmp_path_factory.mktemp("report")
    registered.save(folder / "r.npz")
    words = ["report", folder / "r.npz", "--out", folder / "r.html", "--title", TITLE]
    assert main(argv(*words, *SMALL)) == 0
    return folder


@pytest.fixture(scope="module")
def found(written):
    return library.load(written / "r.npz")


@pytest.fixture(scope="module")
def page(written):
    return Page((written / "r.html").read_text(encoding="utf-8"))


def test_the_page_needs_nothing_outside_it_and_shows_texts_as_they_are(page):
    assert all(link.startswith("data:") for link in page.links)
    assert page.tags.count("script") == 1
    assert "i" not in page.tags
    assert page.tags[:2] == ["html", "head"]
    assert TITLE in page.text


def test_pictures_show_both_surfaces_from_both_sides(page):
    shown = page.pictures
    columns = ("A", "A on B, at first", "registered", "B", "difference")
    columns_of_map = ("A", "on B, at first", "on B, registered", "areas: log2 J", "shapes: log2 R")
    rows = {"function 1": columns, "function 2": columns, "the map": columns_of_map}
    titles = [f"{row}, {each}" for row, every in rows.items() for each in every]
    views = [f"{title}, {end}" for title in titles for end in ("front", "back")]
    for view in views:
        picture = shown[view]
        assert picture.shape[1] == 40
        assert picture.min() < 240
        assert picture.std() > 5
    assert len(shown) == len(views) + 3  # plots
    assert all(picture.std() > 5 for picture in shown.values())
    for row in list(rows)[:2]:
        before, after, wanted = (shown[f"{row}, {each}, front"] for each in columns[1:4])
        assert np.abs(after - wanted).mean() < 0.7 * np.abs(before - wanted).mean()
    assert np.abs(shown["function 1, B, front"] - shown["function 1, B, back"]).mean() > 5


def test_numbers_on_the_page_are_those_of_the_registration(found, written, page):
    told = json.loads(page.facts)
    assert told["file"] == "r.npz"
    assert (told["title"], told["abfm"]) == (TITLE, version("abfm"))
    assert told["a"] == {"vertices": len(A.vertices), "faces": len(A.faces)}
    assert told["b"] == {"vertices": len(B.vertices), "faces": len(B.faces)}
    for name, one in (("map", found), ("initial_map", found.initial)):
        distortion = one.distortion()
        assert told[name]["log2_area"] == pytest.approx(distortion.log2_area._asdict())
        assert told[name]["log2_shape"] == pytest.approx(distortion.log2_shape._asdict())
        assert told[name]["folded"] == distortion.folded
        assert told[name]["coverage"] == pytest.approx(one.coverage())
        apart = one.there_and_back()._asdict()
        assert told[name]["there_and_back"] == pytest.approx(apart, abs=1e-9)
    match = found.match
    assert told["residual"] == pytest.approx(match.residual)
    assert told["verdict"]["kind"] == match.verdict.kind
    assert len(told["path"]) == len(match.path)
    assert told["changed_parameters"]["sigma"] == 1
    assert "tau" not in told["changed_parameters"]
    log2 = found.distortion().log2_area
    for text in (f"{log2.mean:.3f}", f"{log2.maximum:.3f}", f"{match.residual:.3f}", "cooling"):
        assert text in page.text
    assert told["headline"].lower() in page.text.lower()
    for warning in told["warnings"]:
        assert warning[1:] in page.text


def test_the_same_file_gives_the_same_bytes_and_machines_the_same_numbers(
    written, page, abfm, tmp_path
):
    told = abfm(
        "report", written / "r.npz", f"--out={tmp_path}/s.html", "--json", *SMALL, "--title", TITLE
    )
    assert json.loads(told.out) == json.loads(page.facts)
    assert (tmp_path / "s.html").read_bytes() == (written / "r.html").read_bytes()


def test_notes_and_doubts_of_a_registration_are_on_its_page(found, written, abfm, monkeypatch):
    doubtful = replace(found.match, doubt="0.1 is said to be left")
    other = library.Registration(found.initial, doubtful, ("A & B began <near> each other",))
    monkeypatch.setattr("abfm.load", lambda *_: other)
    abfm("report", written / "r.npz", "--out", written / "n.html", *SMALL)
    page = Page((written / "n.html").read_text(encoding="utf-8"))
    assert "A & B began <near> each other." in page.text
    assert "0.1 is said to be left." in page.text
    assert json.loads(page.facts)["notes"] == list(other.notes)


def test_a_map_without_functions_is_told_with_its_faults(abfm, tmp_path):
    moved = B.vertices + [0, 0, 1.5] + 0.15 * np.random.default_rng(0).normal(size=B.vertices.shape)
    places = project_onto_surface(A, moved)
    found = Correspondence(PointMap(B, A, places.faces, places.barycentric))
    found.save(tmp_path / "c.npz")
    told = abfm("report", tmp_path / "c.npz", "--out", tmp_path / "c.html", "--width", "40")
    folded = found.distortion().folded
    assert folded > 5
    warning = f"{folded} of {len(B.faces)} faces are folded"
    assert f"warning: {warning}" in told.err
    assert "report: drawing" in told.err
    page = Page((tmp_path / "c.html").read_text())
    assert f"Warning: {warning}" in page.text
    assert "A map without functions" in page.text
    check_names(told.err, f"{100 * found.coverage():.3g}%")
    assert len(page.pictures) == 4 * 2 + 2
    assert json.loads(page.facts)["map"]["folded"] == folded


def test_a_match_on_one_surface_has_its_page(abfm, tmp_path):
    f, g = waves(B.vertices)[:, 0], waves(B.vertices[:, [1, 0, 2]])[:, 0]
    library.match(B, f, g, BRIEF).save(tmp_path / "m.npz")
    abfm("report", tmp_path / "m.npz", "--out", tmp_path / "m.html", *SMALL)
    page = Page((tmp_path / "m.html").read_text())
    assert "A match on a surface of 162 vertices" in page.text
    assert "function 1, carried, back" in page.pictures
    assert "initial_map" not in json.loads(page.facts)


def test_another_kind_of_map_shows_its_own_facts(registered, abfm, tmp_path):
    functions = waves(B.vertices), waves(A.vertices)
    backward = library.register(B, A, *functions, initial="closest", parameters=BRIEF)
    found = SymmetricRegistration.of_both(registered, backward)
    found.save(tmp_path / "s.npz")
    abfm("report", tmp_path / "s.npz", "--out", tmp_path / "s.html", *SMALL)
    page = Page((tmp_path / "s.html").read_text(encoding="utf-8"))
    assert found.facts.headline[1:] in page.text
    assert json.loads(page.facts)["asymmetry_95"] == found.facts.numbers["asymmetry_95"]
    assert "the map, on B, front" in page.pictures


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_is_seen_from_where_the_map_brings_b(is_mirrored):
    """Of a copy that is turned, pictures are those of the original, or of its mirror image."""
    places = B.vertices * [1, 1.4, 0.8] + [0, 0, 0.2] * B.vertices[:, [0]] ** 2
    copied, faces = (places * [-1, 1, 1], B.faces[:, ::-1]) if is_mirrored else (places, B.faces)
    turned = Rotation.from_rotvec([0.4, -1.9, 0.3]).apply(copied)
    b, a = TriangleMesh(places, B.faces), TriangleMesh(3 * turned + 1, faces)
    found = Correspondence(PointMap.of_vertices(b, a))
    on_a, on_b = pictures.registration_pictures(found, found.distortion(), 160).map.drawings[:2]
    for one, other in zip(on_a.sides, on_b.sides, strict=True):
        seen, wanted = np.asarray(one).astype(float), np.asarray(other).astype(float)
        off = [np.abs(each - wanted).mean() for each in (seen, seen[:, ::-1])]
        assert off[is_mirrored] < 0.6 * off[not is_mirrored]
        assert is_mirrored or off[False] < 1  # light does not come from the other side there


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["{t}/none.npz", "--out", "{t}/r.html"], ("none.npz",)),
        (["{r}", "--out", "{t}/r.txt"], (".html",)),
        (["{r}", "--out", "{t}/no/r.html"], ()),
        (["{r}", "--out", "{t}/r.html", "--width", "5"], (32, 2000)),
        (["{r}", "--out", "{t}/r.html", "--width", "much"], (32, 2000)),
        (["{r}"], ("--out",)),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line(words, named, written, tmp_path, abfm):
    line = [word.format(r=written / "r.npz", t=tmp_path) for word in words]
    check_message(abfm("report", *line, "--quiet", status=2).err, *named)
    assert list(tmp_path.iterdir()) == []


def test_a_machine_that_cannot_draw_says_so_and_leaves_no_page(
    written, tmp_path, abfm, monkeypatch
):
    refuse = Mock(side_effect=DrawingError("cannot draw without OpenGL"))
    monkeypatch.setattr(pictures, "registration_pictures", refuse)
    told = abfm("report", written / "r.npz", "--out", tmp_path / "r.html", "--quiet", status=2)
    check_message(told.err, "OpenGL")
    assert list(tmp_path.iterdir()) == []


def test_landmarks_alone_have_no_pictures_of_functions_and_the_farthest_is_told(tmp_path, abfm):
    ball = icosphere(2)
    found = library.register(ball, ball, landmarks=[[0, 20], [50, 60]])
    found.save(tmp_path / "r.npz")
    abfm("report", tmp_path / "r.npz", f"--out={tmp_path}/r.html", "--width=160", "--quiet")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Matched: 2 landmarks within 0." in text
    assert "farthest landmark" in text
    assert "<h2>Functions" not in text
