import json
import re
from dataclasses import replace
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
from tests.viewer.cli.page import Page


@pytest.fixture
def small(monkeypatch):
    """Compute small figures, and only figure 7."""
    real = experiments.script

    def script(figure, stage):
        if stage.mesh is not None and len(stage.mesh.vertices) < 20:
            raise MeshError("too few vertices")
        return real(figure, replace(stage, small=True))

    monkeypatch.setattr("abfm_viewer.cli.figure.FIGURES", (7,))
    monkeypatch.setattr(experiments, "script", script)


def described(folder):
    return json.loads((folder / "figure-7.json").read_text())


def test_figure_has_a_picture_and_numbers(small, tmp_path, abfm):
    out = tmp_path / "new" / "figures"
    output = abfm("figure 7 --out {t}/new/figures")
    with Image.open(out / "figure-7.png") as image:
        assert image.width > 1000
    found = described(out)
    assert (found["figure"], found["title"]) == (7, TITLES[7])
    residuals = found["notes"][0]
    check_message(residuals, "matched", "along flow lines")
    check_message(line_with(output.err, "note: figure 7"), residuals)
    for measure in found["measures"]:
        assert set(measure) == {"name", "value", "bound", "pass", "claim", "reproduces"}
        if measure["bound"] is not None:
            assert measure["pass"] == (measure["value"] <= measure["bound"])
    assert sorted(path.name for path in out.iterdir()) == ["figure-7.json", "figure-7.png"]
    assert output.out.startswith(f"figure 7: {TITLES[7]}\n")
    assert "mismatch" in output.out
    assert re.search(r"wrote \S+figure-7.png, \S+figure-7.json\n$", output.out)
    assert output.err.startswith("figure 7: ")


def test_notes_are_in_all_outputs(small, tmp_path, abfm, monkeypatch):
    """A figure's note is in its JSON, page and message; without OpenGL only JSON is written."""
    found = ran(7)[1]
    noted = replace(found, sheet=replace(found.sheet, notes=("no map",)))
    monkeypatch.setattr(pictures, "figure_picture", lambda *sheet: Image.new("RGB", (4, 3)))
    monkeypatch.setattr(experiments, "requested_matches", lambda script: ())
    monkeypatch.setattr(experiments, "findings_of", lambda script, matches: noted)
    output = abfm("figure all --out {t} --quiet --json")
    assert json.loads(output.out)["figures"] == [described(tmp_path)]
    output = abfm("figure all --out {t} --quiet")
    assert "no map" in described(tmp_path)["notes"]
    assert "no map" in (tmp_path / "index.html").read_text()
    check_message(line_with(output.err, "note: "), 7, "no map")
    refuse = Mock(side_effect=DrawingError("cannot draw without OpenGL"))
    monkeypatch.setattr(pictures, "figure_picture", refuse)
    output = abfm("figure 7 --out {t}/bare --quiet")
    check_names(output.err, "cannot draw without OpenGL")
    assert [path.name for path in (tmp_path / "bare").iterdir()] == ["figure-7.json"]


def test_matches_are_solved_once_by_a_batch(small, tmp_path, abfm, monkeypatch):
    monkeypatch.setattr(pictures, "figure_picture", lambda *sheet: Image.new("RGB", (4, 3)))
    first = abfm("figure all --out {t} --jobs 1")
    check_names(line_with(first.err, "1 of 1"), "figure 7")
    before = described(tmp_path)
    # numbers from a worker equal those from this process
    assert before["measures"] == [measure.to_dict() for measure in ran(7)[1].measures]
    [result] = (tmp_path / "matches").glob("*.npz")
    assert result.stem == ran(7)[0].problem.digest
    content = result.read_bytes()
    again = abfm("figure all --out {t} --jobs 1")
    check_message(line_with(again.err, "1 of 1"))
    assert again.out == first.out
    result.unlink()
    quiet = abfm("figure 7 --out {t} --jobs 1 --quiet")
    assert all(line.startswith("note: ") for line in quiet.err.splitlines())
    assert result.read_bytes() == content
    assert described(tmp_path) == before


def test_figures_use_another_mesh_if_it_fits(small, tmp_path, abfm):
    trimesh.creation.capsule(height=3, radius=0.5, count=(12, 12)).export(tmp_path / "long.off")
    sizes = []
    for up in ("y", "z"):
        abfm(f"figure 7 --mesh {{t}}/long.off --up {up} --out {{t}} --quiet")
        with Image.open(tmp_path / "figure-7.png") as image:
            sizes.append(image.size)
    assert sizes[1][1] > 1.1 * sizes[0][1]  # upright panels are narrow and high
    assert "long.off" in described(tmp_path)["setting"]
    trimesh.creation.box().export(tmp_path / "box.off")
    line = "figure {} --mesh {{t}}/box.off --out {{t}} --quiet"
    check_message(abfm(line.format(7), status=2).err)
    abfm(line.format("all"))
    assert "Not possible on this mesh: too few vertices" in (tmp_path / "index.html").read_text()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("99", "--out"),
        ("99 --out x", 99),
        ("seven --out x", ""),
        ("7 --out {file}", ""),
        ("7 --mesh none.off --out x", "none.off"),
        ("7 --up w --out x", "--up"),
    ],
)
def test_bad_input_is_refused(words, named, abfm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check_message(abfm(f"figure {words}", file=__file__, status=2).err, named)


def test_page_has_all_figures():
    measures = (
        Measure("mismatch", 0.0123, "small", True, 0.05),
        Measure("mismatch", 0.2, "matches", False, 0.05),
        Measure("drift", 0.5),
    )
    picture, problem = Image.new("RGB", (4, 3), "red"), "Not possible on this mesh: no symmetry"
    entries = [
        FigureEntry(1, "two & more", "f < g", "a <sphere>", measures, picture),
        FigureEntry(9, "a symmetry", "it works", problem=problem, notes=("beyond <colours>",)),
    ]
    text = figures_page(entries)
    page = Page(text)
    shown = ("two & more", "f < g", "a <sphere>", "0.0123", "0.05 yes", "drift", problem)
    for each in (*shown, "beyond <colours>"):
        assert each in page.text
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert len(page.pictures) == 1
    assert re.search(r"0\.05 <span class=\"bad\">no</span>", text)
    assert text.count('class="bad">no') == 2
    assert all(f"Figure {row.figure}" in page.text for row in TABLE_1.values())
