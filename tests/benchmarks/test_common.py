"""Tables of benchmarks, and their insertion into pages."""

import sys

import pytest

from benchmarks import common
from benchmarks.common import Table, decimals, markdown


def test_markdown_aligns_cells():
    lines = markdown(("a", "name"), [("1", "x"), ("22", "long name")]).splitlines()
    assert lines == [
        "| a   | name      |",
        "| --- | --------- |",
        "| 1   | x         |",
        "| 22  | long name |",
    ]


def test_missing_numbers_are_printed_as_none():
    assert decimals(0.12345) == "0.123"
    assert [decimals(value) for value in (None, float("inf"), float("nan"))] == 3 * ["none"]


@pytest.mark.parametrize("jobs", [1, 2])
def test_mapped_keeps_order(jobs):
    assert list(common.mapped(abs, [-3, 1, -2], jobs)) == [3, 1, 2]


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "page.md"
    path.write_text("before\n<!-- table: one -->\nold\n<!-- end: one -->\nafter\n")
    return path


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["benchmark", *map(str, words)])
    rows = {"one": iter([("1", "2")]), "two": iter([("3", "4")])}
    common.main("About", lambda _: {name: Table(("a", "b"), cells) for name, cells in rows.items()})
    return [name for name, cells in rows.items() if next(cells, None) is None]


def test_main_computes_and_writes_requested_tables(monkeypatch, page, capsys):
    assert run(monkeypatch, "--only", "one", "--write", page) == ["one"]
    text = page.read_text()
    assert text.startswith("before\n<!-- table: one -->\n\n| a   | b   |")
    assert text.endswith("| 1   | 2   |\n\n<!-- end: one -->\nafter\n")
    assert "| 1   | 2   |" in capsys.readouterr().out


def test_main_refuses_unknown_tables_and_pages(monkeypatch, page):
    with pytest.raises(SystemExit):
        run(monkeypatch, "--only", "three")
    with pytest.raises(SystemExit, match="two"):
        run(monkeypatch, "--only", "two", "--write", page)
