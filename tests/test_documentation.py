import doctest
import re
import runpy
import shutil
from importlib import import_module
from importlib.metadata import version
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

from abfm import load, load_mesh, match, register
from abfm.assets import asset_path
from abfm.functions import Circular, families, function, parse
from abfm.parameters import FIELDS, FIGURES
from abfm_viewer.cli import main

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [*ROOT.glob("*.md"), *(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)]
START_PAGES = sorted((DOCS / "start").glob("*.md"))
README_LINES_MAX = 110
EXAMPLES = [
    ".".join(path.relative_to(top).with_suffix("").parts)
    for top, package in ((ROOT / "core", "abfm"), (ROOT, "abfm_viewer"))
    for path in sorted((top / package).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


def python_blocks(text):
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def test_readme_is_short():
    assert len(README.splitlines()) <= README_LINES_MAX


def test_readme_example_prints_its_comment(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (block,) = python_blocks(README)
    names = {}
    exec(block, names)
    assert capsys.readouterr().out.strip() == re.search(r"print.*# (.*)", block)[1]
    assert names["halfway"].shape == (6475,)
    assert load("match.npz").residual == names["match"].residual


@pytest.mark.parametrize("page", START_PAGES, ids=lambda page: page.stem)
def test_python_blocks_of_introduction_run(page, tmp_path, monkeypatch):
    """All blocks of a page form one program."""
    monkeypatch.chdir(tmp_path)
    exec("\n".join(python_blocks(page.read_text(encoding="utf-8"))), {})


@pytest.mark.parametrize("module", EXAMPLES)
def test_examples_in_docstrings_run(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(asset_path("eight.off"), "mesh.off")
    result = doctest.testmod(import_module(module))
    assert result.attempted > 0
    assert result.failed == 0


def test_every_family_has_a_working_example(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("values.npy", np.arange(1229.0))
    np.save("angle.npy", np.arange(1229.0))
    mesh = load_mesh(asset_path("human_A.off"))
    examples = runpy.run_path(str(DOCS / "generated_pages.py"))["EXAMPLES"]
    assert list(examples) == [family.family for family in families()]
    for name, example in examples.items():
        spec = parse(example)
        assert name in example
        for part in spec.parts if isinstance(spec, Circular) else (spec,):
            assert np.ptp(function(mesh, part)) > 0


def test_commands_in_readme_exist(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    _, _, listed = capsys.readouterr().out.partition("commands:\n")
    commands = set(re.findall(r"^  (\w+)  ", listed, re.MULTILINE))
    shown = set(re.findall(r"^    abfm (\w+)", README, re.MULTILINE))
    assert len(shown) > 2
    assert shown <= commands


def test_links_between_pages_exist():
    """No page links to one that only the build generates, because a checkout lacks it."""
    generated = {
        DOCS / "reference" / f"{name}.md" for name in ("commands", "functions", "parameters")
    }
    for page in {*PAGES} - generated:
        links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text("utf-8"))
        paths = [(page.parent / link).resolve() for link in links if "://" not in link]
        assert [path for path in paths if path in generated or not path.exists()] == []


def test_every_figure_has_a_page():
    listed = (DOCS / "figures" / "README.md").read_text("utf-8")
    for name in (f"figure-{figure:02}" for figure in FIGURES):
        assert f"../images/{name}.png" in (DOCS / "figures" / f"{name}.md").read_text("utf-8")
        assert f"({name}.md)" in listed


def test_every_picture_is_made_by_the_script_and_used():
    text = "".join(page.read_text("utf-8") for page in PAGES)
    names = {path.name for path in (DOCS / "images").iterdir()}
    assert names == runpy.run_path(str(DOCS / "pictures.py"))["PICTURES"].keys()
    assert [name for name in names if f"images/{name}" not in text] == []


def test_citation_has_the_version():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", citation, re.MULTILINE)[1] == version("abfm")


def test_names_of_the_library_in_the_pages_exist():
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


EXPLANATIONS = "\n\n".join(
    (DOCS / "howto" / page).read_text(encoding="utf-8")
    for page in ("troubleshooting.md", "numbers.md")
)


def test_options_in_explanations_exist(capsys):
    options = set(re.findall(r"`(--[a-z-]+)", EXPLANATIONS))
    settings = set(re.findall(r"`--set (\w+)=", EXPLANATIONS))
    helps = []
    for command in ("match", "register", "sequence", "population"):
        with pytest.raises(SystemExit):
            main([command, "--help-all"])
        helps.append(capsys.readouterr().out)
    text = "\n".join(helps)
    assert len(options) > 10
    assert {name for name in options if not re.search(rf"^  {name}\b", text, re.MULTILINE)} == set()
    assert settings <= {*FIELDS}


def test_parameters_in_explanations_exist():
    """Names in code are parameters, or arguments of functions."""
    functions = match, register, load_mesh
    known = {*FIELDS, *(name for each in functions for name in signature(each).parameters)}
    names = set(re.findall(r"`([a-z_]+)(?:=[^`]*)?`", EXPLANATIONS))
    assert names - known == {"kind", "cause", "verdict"}


def test_labels_in_explanations_exist():
    """Names in bold are labels of the window."""
    code = "".join(path.read_text("utf-8") for path in (ROOT / "abfm_viewer").rglob("*.py"))
    code += (ROOT / "core/abfm/matching/judging/remedies.py").read_text("utf-8")
    labels = set(re.findall(r"\*\*([^*]+)\*\*", " ".join(EXPLANATIONS.split())))
    assert len(labels) > 10
    assert {label for label in labels if f'"{label}' not in code} == set()
