"""Prose of the project: no private idioms, no sentence above 25 words, short test names."""

import pytest

from tests.english.conftest import FOLDERS
from tests.english.patterns import HEADLESS_SUMMARY, violations
from tests.english.texts import read

TEST_NAME_LENGTH_MAX = 60


def test_prose_has_no_private_idioms(sources):
    found = [
        f"{path}:{text.line}: {name}: {excerpt!r}; write: {remedy}"
        for path, source in sources.items()
        for text in source.texts
        for name, excerpt, remedy in violations(text.words)
    ]
    assert {path.parts[0] for path in sources} >= {*FOLDERS, "README.md"}
    assert found == []


def test_docstrings_begin_with_an_action_or_a_name(sources):
    found = [each for source in sources.values() for each in source.definitions]
    assert sum(bool(docstring) for _, docstring in found) > 1000
    assert [each for each in found if HEADLESS_SUMMARY.match(each[1])] == []


def test_names_of_tests_are_short(sources):
    found = [name for source in sources.values() for name, _ in source.definitions]
    names = [name for name in found if name.startswith("test_")]
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
    found = {(text.line, text.kind, text.words) for text in read(path).texts}
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
    assert [text.words for text in read(path).texts] == ["A link and X."]
