"""Tours of tables: a batch and a population open as a table, and a click shows a row."""

import time

import numpy as np
import polyscope.imgui as imgui
import pytest
from PIL import Image

from abfm import load
from abfm.batch import Ledger, Row
from abfm.batch.attempt import WorkItem, attempt
from abfm.io import write_surface
from abfm_viewer.appearance.samples import POPULATION
from abfm_viewer.automation import Driver
from abfm_viewer.automation.widget_search import middle
from abfm_viewer.document.kinds import SubjectDocument
from abfm_viewer.document.result_table import ResultTable
from abfm_viewer.files.project import load_project
from abfm_viewer.panels import result_table
from abfm_viewer.window import population_sample
from tests.messages import check_message
from tests.shapes import icosphere
from tests.viewer.sessions import drawn_texts

SIZE = (1180, 640)
OPTIONS = {"iterations": 15, "refine": 0, "target": "coordinate:y"}


@pytest.fixture
def folder(tmp_path):
    """Return a folder with two matches, a failed one and a pending one, with their rows."""
    folder = tmp_path / "results"
    folder.mkdir()
    write_surface(folder / "egg.ply", icosphere(2))
    given = {"mesh": folder / "egg.ply", **OPTIONS}
    rows = [
        Row("along x", {**given, "source": "coordinate:x"}),
        Row("along z", {**given, "source": "coordinate:z"}),
        Row("gone", {**given, "mesh": folder / "no.ply", "source": "coordinate:x"}),
        Row("later", {**given, "source": "gaussian:vertex=3,width=0.3"}),
    ]
    ledger = Ledger(folder)
    ledger.make()
    ledger.write_rows(rows, "three and one")
    for row in rows[:3]:
        solve(ledger, row)
    return folder, rows


def solve(ledger, row):
    ledger.record(row, attempt(WorkItem(row, str(ledger.folder), ledger.make(), {})).record)


def rows_of(gui):
    gui.frames(2)
    return [
        w.label for w in gui.window.ui.widgets if w.section == "table/rows" and w.kind == "choice"
    ]


def settle(gui):
    gui.wait(lambda session: session.loading.now is None)


def test_tour_of_a_batch(folder, tmp_path, monkeypatch):
    """The table of a folder is sorted, searched, and updated when its files change."""
    with Driver(folder[0], size=SIZE) as gui:
        open_with_the_worst_row(gui)
        show_rows_by_clicks_and_keys(gui)
        leave_and_undo(gui, tmp_path)
        copy_and_compare_rows(gui, folder[0])
        for step in (sort_and_search, omit_columns, show_complete_rows):
            with monkeypatch.context() as patched:
                step(gui, patched)
        refuse_another_folder(gui, tmp_path)
        refresh_and_reopen(gui, folder)
        scroll_hundreds_of_rows(gui, folder)


def test_tour_of_a_population(monkeypatch):
    """The sample population, its outlier, and its table from a file are shown."""
    with Driver(icosphere(1), size=SIZE) as gui:
        gui.menu("Samples", POPULATION)
        tables, end = gui.window.files.tables, time.monotonic() + 60
        while tables.table is None or not tables.table.has_comparisons:
            assert time.monotonic() < end, gui.session.notices.latest.text
            time.sleep(0.2)
            gui.frames(1)
        settle(gui)
        show_the_outlier(gui, monkeypatch)
        open_by_a_file_of_the_folder(gui)


def open_with_the_worst_row(opened):
    tables = opened.window.files.tables
    assert rows_of(opened)[:2] == ["gone", "later"]
    best = [row for row in tables.rows if row.path is not None]
    assert tables.chosen == best[0]
    assert opened.session.document.name == best[0].name
    assert opened.session.result.worse_residual == best[0].facts.worse_residual
    assert opened.errors == {}


def show_rows_by_clicks_and_keys(opened):
    tables, session = opened.window.files.tables, opened.session
    opened.click("along x", "rows")
    settle(opened)
    assert session.document.name == "along x"
    assert opened.text_of("along x", "rows") == "chosen"
    place = [row.name for row in tables.rows].index("along x")
    opened.key("up")
    settle(opened)
    assert tables.chosen.name == tables.rows[place - 1].name
    opened.click("gone", "rows")
    settle(opened)
    check_message(session.notices.latest.text, "gone")
    assert "no.ply" in session.notices.latest.text
    check_message(tables.summary, "gone", session.document.name)
    opened.menu("Edit", "Undo")
    opened.frames(2)
    assert tables.chosen.name == session.document.name
    check_message(tables.summary, tables.table.summary)


def copy_and_compare_rows(opened, folder):
    """Choose columns, and select rows that are copied and shown side by side."""
    tables, options = opened.window.files.tables, "table options"
    for head in ("verdict", "along flow lines", "folded", "|log2 J|", "residual"):
        opened.menu(options, head)
    assert [*heads_of(opened)] == ["name", "reason"]
    assert opened.window.preferences.now.columns == {"row": ("name", "reason")}
    opened.click("along x", "rows")
    settle(opened)
    with opened.input.holding(["ctrl"]):
        opened.click("along z", "rows")
    assert {row.name for row in tables.selection} == {"along x", "along z"}
    assert opened.session.document.name == "along x"
    assert tables.summary == "2 of 4 rows selected"
    opened.key("ctrl+c")
    copied = imgui.GetClipboardText().splitlines()
    assert copied[0] == "name\treason"
    assert [line.split("\t")[0] for line in copied[1:]] == [row.name for row in tables.selection]
    pictures = folder / "pictures"
    pictures.mkdir()
    path = next(row.path for row in tables.rows if row.name == "along x")
    Image.new("RGB", (60, 30), "red").save(pictures / f"{path.stem}.png")
    opened.click("Compare rows")
    opened.frames(2)
    assert rows_of(opened) == []
    assert opened.errors == {}
    opened.click("Back to rows")
    with opened.input.holding(["ctrl"]):
        opened.click("along z", "rows")
    assert not opened.is_enabled("Compare rows")
    with opened.input.holding(["shift"]):
        opened.click("along z", "rows")
    assert {row.name for row in tables.selection} == {"along x", "along z"}
    opened.menu(options, "Copy rows")
    opened.menu(options, "Copy table")
    assert len(imgui.GetClipboardText().splitlines()) == 5
    heads = "verdict", "along flow lines", "folded", "|log2 J|", "residual", "reason"
    for head in heads:
        opened.menu(options, head)
    for label in ("Copy cell", "Copy rows", "Copy table", *heads):
        opened.input.move(*middle(opened.search.find("along x", "rows"), 0.02))
        opened.input.press(1)
        opened.input.release(1)
        opened.click(label, within="cell")
        if label == "Copy cell":
            assert imgui.GetClipboardText() == "along x"
    for head in heads[:5]:
        opened.menu(options, head)


def leave_and_undo(opened, tmp_path):
    """Check that the table is shown only with its own rows."""
    tables = opened.window.files.tables
    write_surface(tmp_path / "other.ply", icosphere(1))
    opened.window.files.open(tmp_path / "other.ply")
    opened.wait(lambda s: s.document.name == "other.ply" and s.channels)
    assert rows_of(opened) == []
    assert not tables.is_of_document
    opened.key("ctrl+z")
    while opened.session.document.name == "other.ply":
        opened.key("ctrl+z")
    assert len(rows_of(opened)) == 4


def sort_and_search(opened, monkeypatch):
    lines = drawn_texts(opened, monkeypatch, "line")
    tables = opened.window.files.tables
    for head, name in (
        ("residual", "residual"),
        ("along flow lines", "verified_residual"),
        ("|log2 J|", "log2_area"),
    ):
        opened.click(head, "rows")
        known = [row.facts.number(name) for row in tables.rows if row.path is not None]
        assert known == sorted(known, reverse=True)
    for head in ("name", "reason", "folded"):
        opened.click(head, "rows")
    opened.click("name", "rows")
    assert rows_of(opened) == ["along x", "along z", "gone", "later"]
    opened.click("name", "rows")
    assert rows_of(opened) == ["later", "gone", "along z", "along x"]
    opened.type("search", "along z", enter=False)
    assert rows_of(opened) == ["along z"]
    opened.type("search", "along  Q", enter=False)
    assert rows_of(opened) == []
    assert ("no match for 'along Q' among 4 rows", "ink") in lines()
    opened.type("search", "")
    assert not [text for text, _ in lines() if text.startswith("no match for")]
    opened.click("verdict", "rows")
    assert rows_of(opened)[0] == "gone"


def heads_of(gui):
    gui.frames(2)
    found = [w for w in gui.window.ui.widgets if w.section == "table/rows" and w.kind == "item"]
    return {head.label: head.rect[2] - head.rect[0] for head in found}


def omit_columns(opened, monkeypatch):
    """Widen texts: columns without space are omitted, and are in a tooltip of the name."""
    every = heads_of(opened)
    assert len(every) == len(ResultTable.columns)
    wider = {"name": every["name"] + 5, "reason": every["reason"]}
    monkeypatch.setattr(result_table, "_TEXT_WIDTH_MIN", wider)
    heads = heads_of(opened)
    assert set(every) - set(heads) == {"folded"}
    assert heads["name"] > every["name"]
    row = next(r for r in opened.window.files.tables.rows if r.name == "along x")
    tip = next(w.tip for w in opened.window.ui.widgets if w.label == "along x")
    assert f"folded {row.cell_text('folded')}" in tip
    monkeypatch.undo()
    assert set(heads_of(opened)) == set(every)


def refresh_and_reopen(opened, folder):
    """Check that rows added by another process are shown."""
    path, rows = folder
    solve(Ledger(path), rows[3])
    opened.click("Refresh")
    opened.wait(lambda s: "1 missing" not in opened.window.files.tables.table.summary)
    opened.click("Close table")
    opened.frames(2)
    assert opened.window.files.tables.table is None
    (path / "summary.csv").touch()  # has the name of a table of results, and an ending of frames
    opened.window.files.open_dropped([path / "summary.csv"])
    settle(opened)
    assert len(rows_of(opened)) == 4


def scroll_hundreds_of_rows(opened, folder):
    """Check that only rows in view are drawn."""
    path, rows = folder
    many = [Row(f"row {i}", rows[0].options, rows[0].folder) for i in range(500)]
    Ledger(path).write_rows(many, "many")
    opened.click("Refresh")
    opened.wait(lambda s: len(opened.window.files.tables.rows) == 500)
    assert 0 < len(rows_of(opened)) < 40
    opened.window.files.tables.move(400)
    settle(opened)
    opened.frames(3)
    assert opened.window.files.tables.chosen.name in rows_of(opened)
    assert opened.errors == {}


def refuse_another_folder(opened, tmp_path):
    opened.window.files.open(tmp_path)
    opened.wait(lambda s: s.notices.latest.is_error)
    check_message(opened.session.notices.latest.text)


def texts(gui, monkeypatch):
    with monkeypatch.context() as patched:
        return [text for text, _ in drawn_texts(gui, patched, "note")()]


def show_the_outlier(opened, monkeypatch):
    tables, session = opened.window.files.tables, opened.session
    opened.click(population_sample.OUTLIER_NAME, "rows")
    settle(opened)
    assert rows_of(opened)[0] == population_sample.OUTLIER_NAME
    assert [row.verdict == "outlier" for row in tables.rows] == [True] + [False] * 8
    found = load(tables.table.place / population_sample.NAME)
    outlier = found.subject(population_sample.OUTLIER_NAME)
    opened.wait(lambda s: s.values("target") is not None)
    np.testing.assert_array_equal(session.values("source"), found.values[outlier, :, 0])
    np.testing.assert_array_equal(session.values("target"), found.mean_of_others(outlier))
    shown = {
        "mean": found.mean(),
        "deviation": found.deviation(),
        "areas": found.log2_area_deviation,
        "difference": found.values[outlier, :, 0] - found.mean_of_others(outlier),
    }
    for what, values in shown.items():
        opened.choose("compare", what)
        opened.frames(3)
        np.testing.assert_array_equal(opened.window.scene.paints["advected"].values, values)
    for head in ("correlation", "|log2 J|"):
        opened.click(head, "rows")
    # saved as a project, it is a document without a table
    path = tables.table.place / "outlier.abfm"
    opened.window.files.save(path)
    opened.wait(lambda s: not opened.window.files.saving)
    document, known = load_project(path)
    assert not isinstance(document, SubjectDocument)
    np.testing.assert_array_equal(known[document.channels[0].source], found.values[outlier, :, 0])
    assert document.display_names == session.document.display_names
    assert set(session.document.display_names.values()) == {"bands"}
    notes_now = texts(opened, monkeypatch)
    note = next(text for text in notes_now if population_sample.OUTLIER_NAME in text)
    check_message(note, "registered", "outlier")
    assert "No match yet" not in notes_now
    opened.click("subject 1", "rows")
    settle(opened)
    assert session.document.slot_title("source") == "subject 1, transferred"
    opened.click("Registration")
    settle(opened)
    assert session.document.complete_result is not None
    assert tables.chosen.name == "subject 1"
    assert opened.errors == {}


def show_complete_rows(opened, monkeypatch):
    sizes, begin = [], result_table.imgui.BeginTable

    def begun(name, columns, flags, size):
        sizes.append(size)
        return begin(name, columns, flags, size)

    monkeypatch.setattr(result_table.imgui, "BeginTable", begun)
    opened.frames(2)
    rows = [w.rect for w in opened.window.ui.widgets if w.section == "table/rows"]
    heads = rows[0]
    high = heads[3] - heads[1]
    assert min(bottom - top for _, top, _, bottom in rows) == high  # other rows have long reasons
    [(_, height)] = set(sizes)
    assert height % high == 2  # minus the border
    assert height > 3 * high


def open_by_a_file_of_the_folder(opened):
    place = opened.window.files.tables.table.place
    opened.click("Close table")
    opened.menu("File", "Open batch or population...")
    opened.type("folder", str(place), "Open a batch or population")
    name = population_sample.NAME
    opened.wait(lambda _: any(name in each.label for each in opened.window.ui.widgets))
    opened.click(name, "Open a batch or population")
    opened.click("Open", "Open a batch or population")
    settle(opened)
    assert opened.window.files.tables.table.has_comparisons
