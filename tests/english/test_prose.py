"""Prose of the project: no private idioms, no sentence above 25 words, short test names."""

import ast
from itertools import chain
from pathlib import Path

import pytest

from tests.english.patterns import HEADLESS_SUMMARY, violations
from tests.english.texts import texts_of

ROOT = Path(__file__).parents[2]
FOLDERS = ("core", "abfm_viewer", "benchmarks", "tests", "docs")
SUFFIXES = {".py", ".pyi", ".md", ".html", ".js"}
BUILT = {"_build", "gallery", "generated", "__pycache__", "english"}
TEST_NAME_LENGTH_MAX = 60


def files_in(folder):
    """Files with prose in a folder, except built ones and these tests, which contain idioms."""
    paths = (path for path in (ROOT / folder).rglob("*") if path.suffix in SUFFIXES)
    return [path for path in paths if not BUILT & set(path.relative_to(ROOT).parts)]


@pytest.mark.parametrize("folder", [*FOLDERS, "."])
def test_prose_has_no_private_idioms(folder):
    paths = ROOT.glob("*.md") if folder == "." else files_in(folder)
    found = [
        f"{path.relative_to(ROOT)}:{text.line}: {name}: {excerpt!r}; write: {remedy}"
        for path in paths
        for text in texts_of(path)
        for name, excerpt, remedy in violations(text.words)
    ]
    assert found == []


@pytest.fixture(scope="module")
def definitions():
    """Return the place, name and docstring of each module, class and function."""
    found = []
    for path in chain.from_iterable(map(files_in, FOLDERS)):
        if path.suffix == ".py":
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                    found.append((path, getattr(node, "name", ""), ast.get_docstring(node) or ""))
    return found


def test_docstrings_begin_with_an_action_or_a_name(definitions):
    assert sum(bool(docstring) for _, _, docstring in definitions) > 1000
    assert [found for found in definitions if HEADLESS_SUMMARY.match(found[2])] == []


def test_names_of_tests_are_short(definitions):
    names = [name for _, name, _ in definitions if name.startswith("test_")]
    assert len(names) > 1000
    assert [name for name in names if len(name) > TEST_NAME_LENGTH_MAX] == []


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("This tells the user.", "tell"),
        ("It returns what is left.", "headless clause"),
        ("Faces turn, too.", "too at the end"),
        ("A limit of .05 holds.", "leading zero"),
        ("The value is no number.", "is no"),
        (" ".join(["word"] * 26), "long sentence"),
    ],
)
def test_idioms_are_found(text, name):
    assert name in [found for found, _, _ in violations(text)]


def test_plain_sentences_pass():
    text = "Return the residual of each channel. There is no mesh, so 0.05 is used instead of 0.5."
    assert list(violations(text)) == []


def test_texts_of_a_module_are_read(tmp_path):
    path = tmp_path / "module.py"
    path.write_text(
        '"""Module of x."""\n\n# A comment\n# on two lines.\n\n\n'
        'def f(n):\n    """Return n."""\n    raise ValueError(f"the value {n} is bad")\n'
    )
    found = {(text.line, text.kind, text.words) for text in texts_of(path)}
    assert found == {
        (1, "docstring", "Module of x."),
        (3, "comment", "A comment on two lines."),
        (8, "docstring", "Return n."),
        (9, "message", "the value X is bad"),
    }


def test_code_and_tables_are_not_prose(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(
        "# Title\n\nA [link](x.md) and `tells`.\n\n    told\n\n| told |\n\n```\ntold\n```\n"
    )
    assert [text.words for text in texts_of(path)] == ["A link and X."]
