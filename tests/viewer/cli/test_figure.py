"""`abfm figure`, run in this process on small set-ups."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
import trimesh
from PIL import Image

from abfm import MeshError, experiments
from abfm.parameters import TITLES
from abfm_viewer import pictures
from abfm_viewer.cli import main
from abfm_viewer.errors import DrawingError
from tests.core.experiments.small import ran


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
    monkeypatch.setattr(experiments, "findings_of", lambda script: ran(7)[1])


def test_a_figure_is_a_picture_and_measured_numbers(small, tmp_path, capsys):
    out = tmp_path / "new" / "figures"
    assert main(["figure", "7", "--out", str(out)]) == 0
    with Image.open(out / "figure-7.png") as image:
        assert image.width > 1000
    described = json.loads((out / "figure-7.json").read_text())
    assert described["figure"] == 7
    assert described["title"] == TITLES[7]
    assert described["notes"] == []
    for measure in described["measures"]:
        assert set(measure) == {"name", "value", "bound", "pass", "claim", "reproduces"}
        if measure["bound"] is not None:
            assert measure["pass"] == (measure["value"] <= measure["bound"])
    assert sorted(path.name for path in out.iterdir()) == ["figure-7.json", "figure-7.png"]
    said = capsys.readouterr()
    assert said.out.startswith(f"figure 7: {TITLES[7]}\n")
    assert "mismatch" in said.out
    assert said.err.startswith("figure 7: ")


def test_what_the_sheet_says_stands_in_every_output(known, tmp_path, capsys, monkeypatch):
    found = ran(7)[1]
    noted = replace(found, sheet=replace(found.sheet, notes=("no map",)))
    monkeypatch.setattr(experiments, "findings_of", lambda script: noted)
    assert main(["figure", "all", "--out", str(tmp_path), "--quiet"]) == 0
    assert "no map" in json.loads((tmp_path / "figure-7.json").read_text())["notes"]
    assert "no map" in (tmp_path / "index.html").read_text()
    assert "note: figure 7: no map\n" in capsys.readouterr().err


def test_all_figures_make_a_page_and_json_tells_everything(known, tmp_path, capsys):
    assert main(["figure", "all", "--out", str(tmp_path), "--quiet", "--json"]) == 0
    said = capsys.readouterr()
    [described] = json.loads(said.out)["figures"]
    assert described == json.loads((tmp_path / "figure-7.json").read_text())
    assert said.err == ""
    assert "Figure 7" in (tmp_path / "index.html").read_text()


def test_another_mesh_is_named_and_stands_upright(small, tmp_path):
    mesh = tmp_path / "long.off"
    trimesh.creation.capsule(height=3, radius=0.5, count=(12, 12)).export(mesh)
    sizes = []
    for up in ("y", "z"):
        assert (
            main(
                ["figure", "7", "--mesh", str(mesh), "--up", up, "--out", str(tmp_path), "--quiet"]
            )
            == 0
        )
        with Image.open(tmp_path / "figure-7.png") as image:
            sizes.append(image.size)
    assert sizes[1][1] > 1.1 * sizes[0][1]  # upright panels are narrow, so that they may be high
    assert "long.off" in json.loads((tmp_path / "figure-7.json").read_text())["setting"]


def test_what_a_mesh_does_not_allow_is_refused_or_told_on_the_page(small, tmp_path, capsys):
    mesh = tmp_path / "box.off"
    trimesh.creation.box().export(mesh)
    words = ["--mesh", str(mesh), "--out", str(tmp_path), "--quiet"]
    assert main(["figure", "7", *words]) == 2
    assert capsys.readouterr().err == "abfm: too few vertices\n"
    assert main(["figure", "all", *words]) == 0
    assert "Not on this mesh: too few vertices" in (tmp_path / "index.html").read_text()


def test_without_opengl_the_numbers_are_there(known, tmp_path, monkeypatch, capsys):
    def refuse(sheet, notes):
        raise DrawingError("cannot draw without OpenGL")

    monkeypatch.setattr(pictures, "figure_picture", refuse)
    assert main(["figure", "7", "--out", str(tmp_path), "--quiet"]) == 0
    assert "cannot draw without OpenGL" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["figure-7.json"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["figure", "99"], "--out"),
        (["figure", "99", "--out", "x"], "there is no figure '99'; expected a number from"),
        (["figure", "seven", "--out", "x"], "or all"),
        (["figure", "7", "--out", __file__], "cannot make the folder"),
        (["figure", "7", "--mesh", "none.off", "--out", "x"], "none.off"),
        (["figure", "7", "--up", "w", "--out", "x"], "--up"),
    ],
)
def test_bad_words_are_refused_in_one_line(words, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert expected in error
