"""Checks that the README is correct."""

import re
import shutil
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from abfm import load, load_mesh
from abfm.assets import asset_path
from abfm.functions import Circular, families, function, parse
from abfm.parameters import FIELDS, FIGURES, PAPER
from abfm_viewer.cli import main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


def table(heading):
    """Return the cells of the first table below a heading, without its header lines."""
    rows = re.search(rf"\n## {heading}\n.*?((?:\n\|[^\n]*)+)", README, re.DOTALL)
    lines = rows[1].strip().splitlines()[2:]
    return [
        [cell.strip().strip("`") for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines
    ]


def test_python_examples_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    alone, pair = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    names = {}
    exec(alone, names)
    assert re.match(r"matched .*residual 0\.0\d+, 0\.0", capsys.readouterr().out)
    assert names["halfway"].shape == (6475,)
    assert names["match"].verdict.kind == "matched"
    assert load("match.npz").residual == names["match"].residual
    exec(pair, names)
    assert re.match(r"(registered|matched|nearly) .*log2 J", capsys.readouterr().out)
    np.testing.assert_array_equal(load("reg.npz").to_vertices(), names["found"].to_vertices())


def test_table_has_all_parameters():
    def text_of(default):
        return f"{float(default):g}" if str(default)[0].isdigit() else str(default)

    rows = [(name, symbol, text_of(default)) for name, symbol, _, default in table("Parameters")]
    assert rows == [(f.name, f.metadata["symbol"], text_of(f.default)) for f in FIELDS.values()]


def test_table_has_all_families(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("values.npy", np.arange(1229.0))
    np.save("angle.npy", np.arange(1229.0))
    shutil.copy(asset_path("human.symperm.txt"), "mirror.txt")
    mesh = load_mesh(asset_path("human_A.off"))
    rows = table("Functions as text")
    assert [family for family, _, _ in rows] == [family.family for family in families()]
    for _, example, _ in rows:
        spec = parse(example)
        for part in spec.parts if isinstance(spec, Circular) else (spec,):
            assert np.ptp(function(mesh, part)) > 0


def test_shown_commands_exist(capsys):
    shown = set(re.findall(r"^    abfm (\S+)", README, re.MULTILINE))
    with pytest.raises(SystemExit):
        main(["--help"])
    assert shown == set(re.findall(r"^    (\w+)(?:  |$)", capsys.readouterr().out, re.MULTILINE))


def test_linked_files_and_pages_of_figures_exist():
    linked = {}
    for page in PAGES:
        links = re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text("utf-8"))
        linked[page] = {(page.parent / link).resolve() for link in links if "://" not in link}
        assert {link for link in linked[page] if not link.exists()} == set()
    assert ROOT / "docs/images/demo.png" in linked[ROOT / "README.md"]
    figures = ROOT / "docs/figures"
    listed = (figures / "README.md").read_text("utf-8")
    for name in (f"figure-{figure:02}" for figure in FIGURES):
        assert f"../images/{name}.png" in (figures / f"{name}.md").read_text("utf-8")
        assert f"({name}.md)" in listed


def test_parameters_of_the_paper_are_listed():
    words = "the paper's energy and course"
    found = [part for part in README.split("\n\n") if words in part.replace("\n", " ").lower()]
    assert len(found) == 1
    for part in found:
        assert [name for name in PAPER if f"`{name}" not in part] == []


def test_names_in_the_pages_exist():
    names = {
        name
        for page in PAGES
        for name in re.findall(r"`(abfm(?:_viewer)?(?:\.\w+)+)", page.read_text("utf-8"))
    }
    assert len(names) > 20
    for name in names:
        found, *parts = name.split(".")
        value = import_module(found)
        for part in parts:
            found += f".{part}"
            value = getattr(value, part) if hasattr(value, part) else import_module(found)
