"""`abfm figure`, run in this process on small set-ups."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from unittest.mock import Mock

import pytest
import trimesh
from PIL import Image

from abfm import MeshError, experiments
from abfm.experiments import Measure
from abfm.parameters import TABLE_1, TITLES
from abfm_viewer import pictures
from abfm_viewer.cli.figure import FigureEntry
from abfm_viewer.errors import DrawingError
from abfm_viewer.reports.pages import figures_page
from tests.core.experiments.small import ran
from tests.messages import check_message, check_names, line_with


@pytest.fixture
def small(monkeypatch):
    """Make figures small, and 7 the only one."""
    real = experiments.script

    def script(figure, stage):
        if stage.mesh is not None and len(stage.mesh.vertices) < 20:
            raise MeshError("too few vertices")
        return real(figure, replace(stage, small=True))

    monkeypatch.setattr("abfm_viewer.cli.figure.FIGURES", (7,))
    monkeypatch.setattr(experiments, "script", script)


@pytest.fixture
def known(small, monkeypatch):
    """What 7 finds on its own mesh is at hand."""
    monkeypatch.setattr(experiments, "sought_by", lambda script: ())
    monkeypatch.setattr(experiments, "findings_of", lambda script, matches: ran(7)[1])


def test_a_figure_is_a_picture_and_measured_numbers(small, tmp_path, abfm):
    out = tmp_path / "new" / "figures"
    said = abfm("figure", "7", "--out", out)
    with Image.open(out / "figure-7.png") as image:
        assert image.width > 1000
    described = json.loads((out / "figure-7.json").read_text())
    assert (described["figure"], described["title"], described["notes"]) == (7, TITLES[7], [])
    for measure in described["measures"]:
        assert set(measure) == {"name", "value", "bound", "pass", "claim", "reproduces"}
        if measure["bound"] is not None:
            assert measure["pass"] == (measure["value"] <= measure["bound"])
    assert sorted(path.name for path in out.iterdir()) == ["figure-7.json", "figure-7.png"]
    assert said.out.startswith(f"figure 7: {TITLES[7]}\n")
    assert "mismatch" in said.out
    assert said.err.startswith("figure 7: ")


def test_outputs_say_what_the_sheet_does_also_without_opengl(known, tmp_path, abfm, monkeypatch):
    said = abfm("figure", "all", "--out", tmp_path, "--quiet", "--json")
    [described] = json.loads(said.out)["figures"]
    assert described == json.loads((tmp_path / "figure-7.json").read_text())
    assert said.err == ""
    assert "Figure 7" in (tmp_path / "index.html").read_text()
    found = ran(7)[1]
    noted = replace(found, sheet=replace(found.sheet, notes=("no map",)))
    monkeypatch.setattr(experiments, "findings_of", lambda script, matches: noted)
    said = abfm("figure", "all", "--out", tmp_path, "--quiet")
    assert "no map" in json.loads((tmp_path / "figure-7.json").read_text())["notes"]
    assert "no map" in (tmp_path / "index.html").read_text()
    check_message(line_with(said.err, "note: "), 7, "no map")
    refuse = Mock(side_effect=DrawingError("cannot draw without OpenGL"))
    monkeypatch.setattr(pictures, "figure_picture", refuse)
    bare = tmp_path / "bare"
    said = abfm("figure", "7", "--out", bare, "--quiet")
    check_names(said.err, "cannot draw without OpenGL")
    assert [path.name for path in bare.iterdir()] == ["figure-7.json"]


def test_all_are_matched_by_a_batch_and_nothing_twice(small, tmp_path, abfm, monkeypatch):
    monkeypatch.setattr(pictures, "figure_picture", lambda *sheet: Image.new("RGB", (4, 3)))
    words = ["figure", "all", "--out", tmp_path, "--jobs", "1"]
    first = abfm(*words)
    check_names(line_with(first.err, "1 of 1"), "figure 7")
    described = json.loads((tmp_path / "figure-7.json").read_text())
    # in this process or in another one, solved or read: the same numbers
    assert described["measures"] == [measure.to_dict() for measure in ran(7)[1].measures]
    [result] = (tmp_path / "matches").glob("*.npz")
    assert result.stem == ran(7)[0].problem.digest
    before = result.read_bytes()
    again = abfm(*words)
    check_message(line_with(again.err, "1 of 1"))
    assert again.out == first.out
    result.unlink()
    assert abfm("figure", "7", "--out", tmp_path, "--jobs", "1", "--quiet").err == ""
    assert result.read_bytes() == before
    assert json.loads((tmp_path / "figure-7.json").read_text()) == described


def test_another_mesh_stands_upright_or_is_refused_with_the_reason(small, tmp_path, abfm):
    mesh = tmp_path / "long.off"
    trimesh.creation.capsule(height=3, radius=0.5, count=(12, 12)).export(mesh)
    sizes = []
    for up in ("y", "z"):
        abfm("figure", "7", "--mesh", mesh, "--up", up, "--out", tmp_path, "--quiet")
        with Image.open(tmp_path / "figure-7.png") as image:
            sizes.append(image.size)
    assert sizes[1][1] > 1.1 * sizes[0][1]  # upright panels are narrow, so that they may be high
    assert "long.off" in json.loads((tmp_path / "figure-7.json").read_text())["setting"]
    mesh = tmp_path / "box.off"
    trimesh.creation.box().export(mesh)
    words = ["--mesh", mesh, "--out", tmp_path, "--quiet"]
    check_message(abfm("figure", "7", *words, status=2).err)
    abfm("figure", "all", *words)
    assert "Not on this mesh: too few vertices" in (tmp_path / "index.html").read_text()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["99"], "--out"),
        (["99", "--out", "x"], 99),
        (["seven", "--out", "x"], ""),
        (["7", "--out", __file__], ""),
        (["7", "--mesh", "none.off", "--out", "x"], "none.off"),
        (["7", "--up", "w", "--out", "x"], "--up"),
    ],
)
def test_bad_words_are_refused_in_one_line(words, named, abfm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check_message(abfm("figure", *words, status=2).err, named)


class Balanced(HTMLParser):
    """Checks that every tag is closed, and collects text and links."""

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.links, self.ids = [], "", [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img"):
            self.open.append(tag)
        named = dict(attributes)
        self.ids.append(named.get("id"))
        self.links += [named[name] for name in ("src", "href") if name in named]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_the_page_has_everything_and_says_what_fails():
    measures = (Measure("mismatch", 0.0123, "small", True, 0.05), Measure("drift", 0.5))
    picture, problem = Image.new("RGB", (4, 3), "red"), "Not on this mesh: no symmetry"
    entries = [
        FigureEntry(1, "two & more", "f < g", "a <sphere>", measures, picture),
        FigureEntry(9, "a symmetry", "it works", problem=problem, notes=("beyond <colours>",)),
    ]
    parsed = Balanced(figures_page(entries))
    shown = ("two & more", "f < g", "a <sphere>", "0.0123", "0.05 yes", "drift")
    for text in (*shown, problem, "beyond <colours>"):
        assert text in parsed.text
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in parsed.links)
    assert {link[1:] for link in parsed.links if link.startswith("#")} <= set(parsed.ids)
    [picture] = [link for link in parsed.links if link.startswith("data:")]
    assert base64.b64decode(picture.partition(",")[2]).startswith(b"\x89PNG")
    text = figures_page(
        [FigureEntry(3, "t", "c", measures=(Measure("mismatch", 0.2, "matches", False, 0.05),))]
    )
    assert re.search(r"0\.05 <span class=\"bad\">no</span>", text)
    assert text.count('class="bad">no') == 2
    text = Balanced(figures_page([])).text
    assert all(f"Figure {row.figure}" in text for row in TABLE_1.values())
