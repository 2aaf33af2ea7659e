import json
import re
from dataclasses import replace
from importlib.metadata import version
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import abfm as library
from abfm import Correspondence, Parameters, PointMap, TriangleMesh
from abfm.maps import project_onto_surface
from abfm.mesh.shapes import even_sphere
from abfm.registration.symmetric import SymmetricRegistration
from abfm_viewer import pictures
from abfm_viewer.cli import main
from abfm_viewer.errors import DrawingError
from tests.messages import check_message, check_names
from tests.processes import words_of
from tests.shapes import icosphere
from tests.viewer.cli.page import page_at

A, B = even_sphere(400), icosphere(2)
SHORT_RUN = Parameters.of(iterations=60, refine=0, levels=1, sigma=1, cooling_stages=3, order=1)
TITLE = '<i>"A" & B</i>'
SMALL_PICTURES = "--width 40 --quiet"


def waves(directions):
    x, y, z = directions.T
    return np.stack([np.sin(3 * x) + y, z * x], axis=1)


@pytest.fixture(scope="module")
def registered():
    bent = B.vertices + [0.15, 0, 0.1] * np.sin(3 * B.vertices[:, [1]])
    bent /= np.linalg.norm(bent, axis=1)[:, None]
    functions = waves(A.vertices), waves(bent)
    return library.register(A, B, *functions, initial="closest", parameters=SHORT_RUN)


@pytest.fixture(scope="module")
def written(registered, tmp_path_factory):
    """Return a folder with the file of the registration and its page."""
    folder = tmp_path_factory.mktemp("report")
    registered.save(folder / "r.npz")
    line = words_of(f"report {{f}}/r.npz --out {{f}}/r.html {SMALL_PICTURES}", f=folder)
    assert main([*line, "--title", TITLE]) == 0
    return folder


@pytest.fixture(scope="module")
def page(written):
    return page_at(written / "r.html")


def test_page_is_complete_and_escapes_texts(page):
    assert all(link.startswith("data:") for link in page.links)
    assert page.tags.count("script") == 1
    assert "i" not in page.tags
    assert page.tags[:2] == ["html", "head"]
    assert TITLE in page.text


def test_pictures_show_both_surfaces_from_both_sides(page):
    shown = page.pictures
    columns = ("A", "A on B, initial map", "registered", "B", "difference")
    columns_of_map = (
        "A",
        "on B, initial map",
        "on B, registered",
        "areas: log2 J",
        "shapes: log2 R",
    )
    rows = {"function 1": columns, "function 2": columns, "the map": columns_of_map}
    titles = [f"{row}, {each}" for row, every in rows.items() for each in every]
    views = [f"{title}, {end}" for title in titles for end in ("front", "back")]
    for view in views:
        assert shown[view].shape[1] == 40
        assert shown[view].min() < 240
    assert len(shown) == len(views) + 3  # the other pictures are plots
    assert all(picture.std() > 5 for picture in shown.values())
    for row in list(rows)[:2]:
        before, after, wanted = (shown[f"{row}, {each}, front"] for each in columns[1:4])
        assert np.abs(after - wanted).mean() < 0.7 * np.abs(before - wanted).mean()
    assert np.abs(shown["function 1, B, front"] - shown["function 1, B, back"]).mean() > 5


def test_numbers_are_those_of_the_registration(written, page):
    facts, found = json.loads(page.facts), library.load(written / "r.npz")
    assert (facts["file"], facts["title"], facts["abfm"]) == ("r.npz", TITLE, version("abfm"))
    for name, mesh in (("a", A), ("b", B)):
        assert facts[name] == {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
    for name, one in (("map", found), ("initial_map", found.initial)):
        distortion = one.distortion()
        assert facts[name]["log2_area"] == pytest.approx(distortion.log2_area._asdict())
        assert facts[name]["log2_shape"] == pytest.approx(distortion.log2_shape._asdict())
        assert facts[name]["folded"] == distortion.folded
        assert facts[name]["coverage"] == pytest.approx(one.coverage())
        round_trip = one.round_trip()._asdict()
        assert facts[name]["round_trip"] == pytest.approx(round_trip, abs=1e-9)
    match = found.match
    assert facts["residual"] == pytest.approx(match.residual)
    assert facts["verdict"]["kind"] == match.verdict.kind
    assert len(facts["path"]) == len(match.path)
    assert facts["changed_parameters"]["sigma"] == 1
    assert "tau" not in facts["changed_parameters"]
    log2 = found.distortion().log2_area
    for text in (f"{log2.mean:.3f}", f"{log2.maximum:.3f}", f"{match.residual:.3f}", "cooling"):
        assert text in page.text
    for text in (facts["headline"], *facts["warnings"]):
        assert text[1:] in page.text


def test_same_file_gives_same_bytes_and_json(written, page, abfm, tmp_path):
    line = f"report {{f}}/r.npz --out={{t}}/s.html --json {SMALL_PICTURES} --title"
    output = abfm(line, TITLE, f=written)
    assert json.loads(output.out) == json.loads(page.facts)
    assert (tmp_path / "s.html").read_bytes() == (written / "r.html").read_bytes()


def test_notes_and_warnings_are_on_the_page(registered, abfm, tmp_path, monkeypatch):
    recomputed = replace(registered.match, load_warning="stored residual 0.1")
    notes = ("A & B began <near> each other",)
    other = library.Registration(registered.initial, recomputed, notes)
    monkeypatch.setattr("abfm.load", lambda *_: other)
    assert "stored residual 0.1" in abfm(f"report r.npz --out {{t}}/n.html {SMALL_PICTURES}").err
    page = page_at(tmp_path / "n.html")
    assert "A & B began <near> each other." in page.text
    assert "stored residual 0.1." in page.text
    assert json.loads(page.facts)["notes"] == list(notes)


def test_map_without_functions_has_warnings(abfm, tmp_path):
    moved = B.vertices + [0, 0, 1.5] + 0.15 * np.random.default_rng(0).normal(size=B.vertices.shape)
    places = project_onto_surface(A, moved)
    found = Correspondence(PointMap(B, A, places.faces, places.barycentric))
    found.save(tmp_path / "c.npz")
    output = abfm("report {t}/c.npz --out {t}/c.html --width 40")
    folded = found.distortion().folded
    assert folded > 5
    warning = f"{folded} of {len(B.faces)} faces are folded"
    assert f"warning: {warning}" in output.err
    assert "report: drawing" in output.err
    check_names(output.err, f"{100 * found.coverage():.3g}%")
    page = page_at(tmp_path / "c.html")
    assert f"Warning: {warning}" in page.text
    assert "A map without functions" in page.text
    assert len(page.pictures) == 4 * 2 + 2
    assert json.loads(page.facts)["map"]["folded"] == folded
    assert "folded faces" in json.loads(page.facts)["topics"]
    assert "turned over by the map" in page.text


def test_match_on_one_surface_has_its_page(abfm, tmp_path):
    f, g = waves(B.vertices)[:, 0], waves(B.vertices[:, [1, 0, 2]])[:, 0]
    library.match(B, f, g, SHORT_RUN).save(tmp_path / "m.npz")
    abfm(f"report {{t}}/m.npz --out {{t}}/m.html {SMALL_PICTURES}")
    page = page_at(tmp_path / "m.html")
    assert "A match on a surface of 162 vertices" in page.text
    assert "What does this mean?" in page.text
    assert "function 1, advected, back" in page.pictures
    assert "initial_map" not in json.loads(page.facts)


def test_symmetric_registration_has_its_page(registered, abfm, tmp_path):
    functions = waves(B.vertices), waves(A.vertices)
    backward = library.register(B, A, *functions, initial="closest", parameters=SHORT_RUN)
    found = SymmetricRegistration.average(registered, backward)
    found.save(tmp_path / "s.npz")
    abfm(f"report {{t}}/s.npz --out {{t}}/s.html {SMALL_PICTURES}")
    page = page_at(tmp_path / "s.html")
    assert found.facts.headline[1:] in page.text
    assert json.loads(page.facts)["asymmetry_95"] == found.facts.numbers["asymmetry_95"]
    assert "the map, on B, front" in page.pictures


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_is_viewed_from_the_side_of_b(is_mirrored):
    """Pictures of a rotated copy A are those of B, or of its mirror image."""
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
        assert is_mirrored or off[False] < 1  # a mirror image has other light


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("{t}/none.npz --out {t}/r.html", ["none.npz"]),
        ("{r} --out {t}/r.txt", [".html"]),
        ("{r} --out {t}/no/r.html", []),
        ("{r} --out {t}/r.html --width 5", [32, 2000]),
        ("{r} --out {t}/r.html --width much", [32, 2000]),
        ("{r}", ["--out"]),
        ("{r} --out {t}/r.html --up y", ["OpenGL"]),
    ],
)
def test_bad_input_leaves_no_page(words, named, written, tmp_path, abfm, monkeypatch):
    refuse = Mock(side_effect=DrawingError("cannot draw without OpenGL"))
    monkeypatch.setattr(pictures, "registration_pictures", refuse)
    output = abfm(f"report {words} --quiet", r=written / "r.npz", status=2)
    check_message(output.err, *named)
    assert list(tmp_path.iterdir()) == []


def test_landmarks_without_functions_have_pages(tmp_path, abfm):
    found = library.register(B, B, landmarks=[[0, 20], [50, 60]])
    found.save(tmp_path / "r.npz")
    abfm(f"report {{t}}/r.npz --out={{t}}/r.html {SMALL_PICTURES}")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Matched: farthest of 2 landmarks 0." in text
    assert "largest landmark error" in text
    assert "<h2>Functions" not in text
    abfm("render {t}/r.npz --out {t}/p.html")
    text = (tmp_path / "p.html").read_text(encoding="utf-8")
    a, b = json.loads(re.search(r'id="page">(.*?)</script>', text)[1])["panels"]
    assert (a["title"], b["title"]) == ("A", "A on B")
    assert [layer["name"] for layer in b["layers"]] == ["x of A", "y of A", "z of A"]
    assert [way["name"] for way in a["paths"]] == ["landmarks"]
    assert {"landmarks", "target landmarks"} <= {way["name"] for way in b["paths"]}
