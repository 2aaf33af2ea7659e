"""The file dialog without drawing: lists, clicks and typed names."""

import os
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from abfm_viewer.dialogs import Dialogs, file_dialog
from abfm_viewer.dialogs.file_dialog import (
    ENTRIES_MAX,
    FileChoice,
    FolderEntry,
    read_folder,
    shown,
)
from tests.messages import check_message
from tests.viewer.sessions import until

MESHES = (".off", ".obj")


@pytest.fixture
def folder(tmp_path):
    """Return a folder with meshes, other files, hidden files and folders."""
    files = ("b.off", "A.OBJ", "ünïcode ☃.off", "two words.off", "notes.txt", "c.off.bak")
    for name in (*files, ".hidden.off"):
        (tmp_path / name).write_text("")
    for name in ("zebra", "Apple", ".git"):
        (tmp_path / name).mkdir()
    return tmp_path


def listed(choice):
    """Return the labels of the entries when they are read."""
    until(lambda: choice.listing() is not None)
    return [entry.label for entry in choice.listing().entries]


def test_folders_are_first_and_hidden_files_are_omitted(folder):
    names = [entry.label for entry in read_folder(folder, MESHES).entries]
    assert names == ["Apple/", "zebra/", "A.OBJ", "b.off", "two words.off", "ünïcode ☃.off"]


def test_large_folders_are_truncated_with_a_note(tmp_path, monkeypatch):
    """Only names and kinds of entries are read; other queries are slow on remote disks."""
    names = [f"{number:05}.off" for number in range(ENTRIES_MAX + 5)]
    entries = [SimpleNamespace(name=name, is_dir=lambda: False) for name in reversed(names)]
    monkeypatch.setattr(os, "scandir", lambda folder: nullcontext(entries))
    listing = read_folder(tmp_path, MESHES)
    assert listing.entries == tuple(FolderEntry(name, False) for name in names[:ENTRIES_MAX])
    check_message(listing.note, "10,000", "10,005")


@pytest.mark.parametrize("name", ["missing", "file.off"])
def test_unreadable_folders_are_reported(tmp_path, name):
    (tmp_path / "file.off").touch()
    listing = read_folder(tmp_path / name, MESHES)
    assert listing.entries == ()
    check_message(listing.error, tmp_path / name)


@pytest.mark.skipif(sys.platform != "linux", reason="only there names may be any bytes")
def test_invalid_names_and_broken_links_are_listed(tmp_path):
    (tmp_path / os.fsdecode(b"bad\xff.off")).touch()
    (tmp_path / "gone.off").symlink_to("nowhere")
    (tmp_path / "loop").symlink_to("loop")
    labels = [entry.label for entry in read_folder(tmp_path, MESHES).entries]
    assert labels == ["bad�.off", "gone.off"]
    shown(os.fsdecode(b"\xff")).encode()
    choice = FileChoice(tmp_path, MESHES)
    assert choice.go_or_take("gone.off") is None
    check_message(choice.error)
    assert choice.go_or_take("loop/a.off") is None
    assert choice.error


def test_typed_paths_lead_to_folders_and_files(folder, monkeypatch):
    monkeypatch.setenv("HOME", str(folder / "zebra"))
    choice = FileChoice(folder, MESHES)
    assert choice.go_or_take("Apple") is None
    assert choice.folder == folder / "Apple"
    assert choice.go_or_take("../two words.off") == folder / "two words.off"
    assert choice.go_or_take(str(folder / "A.OBJ")) == folder / "A.OBJ"
    assert choice.go_or_take(" ~ ") is None
    assert choice.folder == folder / "zebra"


@pytest.mark.parametrize(
    ("saving", "typed", "named"),
    [
        (False, "notes.txt", ("notes.txt", ".off", ".obj")),
        (False, "none.off", ()),
        (False, "x" * 5000, ()),
        (False, "~nobody-of-this-name/a.off", ()),
        (False, "nul\0.off", ()),
        (True, "nowhere/work", ()),
        (True, "dir", ()),
        (True, "y" * 400, ()),
    ],
)
def test_invalid_paths_are_refused_with_the_reason(folder, saving, typed, named):
    (folder / "dir.off").mkdir()
    choice = FileChoice(folder, MESHES, saving=saving, name=typed if saving else "")
    assert (choice.confirm() if saving else choice.go_or_take(typed)) is None
    check_message(choice.error.lower(), *named)
    assert choice.folder == folder


def test_up_selects_the_previous_folder(folder):
    choice = FileChoice(folder / "Apple", MESHES)
    choice.go_up()
    assert (choice.folder, choice.selected) == (folder, "Apple")
    choice.go(Path("/"))
    choice.go_up()
    assert choice.folder == Path("/")
    choice = FileChoice(folder, MESHES)
    names = listed(choice)
    seen = []
    for step in (1, 1, 1, -1, -1, -1, -1):
        choice.move_selection(step)
        seen.append(choice.selected)
    assert seen == ["Apple", "zebra", "A.OBJ", "zebra", "Apple", "Apple", "Apple"]
    for _ in range(20):
        choice.move_selection(1)
    assert choice.selected == names[-1]
    choice.go(folder / "Apple")
    assert listed(choice) == []
    choice.move_selection(1)
    assert choice.selected == ""


def test_vanished_file_is_refused_and_the_list_read_again(folder):
    choice = FileChoice(folder, MESHES)
    assert "b.off" in listed(choice)
    choice.select(FolderEntry("b.off", False))
    (folder / "b.off").unlink()
    assert choice.confirm() is None
    check_message(choice.error, "b.off")
    assert "b.off" not in listed(choice)


@pytest.mark.parametrize(
    ("typed", "file"),
    [
        ("work", "work.npz"),
        (" work ", "work.npz"),
        ("work.html", "work.html"),
        ("work.NPZ", "work.NPZ"),
        ("work-lh.stc", "work-lh.stc"),
        ("sub-01.2", "sub-01.2.npz"),  # a valid name that is a number
        ("Apple/work", "Apple/work.npz"),
        ("work.stc", None),
        ("work.xyz", None),
    ],
)
def test_name_to_save_gets_a_suffix(folder, typed, file):
    choice = FileChoice(folder, (".npz", "-lh.stc", ".html"), saving=True, name=typed)
    assert choice.final_name == (file or typed)
    assert choice.confirm() == (file and folder / file)
    refusal = f"{typed}: expected a name that ends in .npz, -lh.stc, .html, or has no ending"
    assert choice.error == ("" if file else refusal)


def test_saving_uses_the_typed_or_selected_name(folder):
    choice = FileChoice(folder, MESHES, saving=True)
    assert choice.confirm() is None
    choice.select(FolderEntry("b.off", False))
    assert choice.name == "b.off"
    assert choice.go_or_take(str(folder / "Apple" / "new")) is None
    assert (choice.folder, choice.name) == (folder / "Apple", "new")
    choice.name = ""
    choice.go(folder)
    choice.select(FolderEntry("zebra", True))
    assert choice.confirm() is None
    assert choice.folder == folder / "zebra"


def test_slow_folder_does_not_block_the_window(folder, held):
    requested, may_answer = held(file_dialog, "read_folder")
    choice = FileChoice(folder, MESHES)
    assert choice.listing() is None
    assert requested.wait(30)
    for _ in range(10):
        assert choice.listing() is None  # polled as by the frame loop
    may_answer.set()
    assert "b.off" in listed(choice)
    choice.close()


def selections(choice, *texts):
    """Return the entry that is selected after each typed name."""
    listed(choice)
    found = []
    for text in texts:
        choice.type_name(text)
        found.append(choice.selected)
    return found


def test_a_typed_start_of_a_name_selects_its_entry(folder):
    choice = FileChoice(folder, MESHES)
    assert selections(choice, "t", "TWO", "z", "b.off", "x") == [
        "two words.off",
        "two words.off",
        "zebra",
        "b.off",
        "",
    ]
    assert choice.confirm() is None
    assert choice.error == f"{folder / 'x'} does not exist"
    assert selections(choice, "two") == ["two words.off"]
    assert choice.confirm() == folder / "two words.off"
    choice.type_name("ap")
    assert choice.confirm() is None
    assert (choice.folder, choice.name) == (folder / "Apple", "")
    choice.type_name("../b.off")
    assert choice.confirm() == folder / "b.off"


def test_a_search_lists_and_selects_names_that_contain_it(folder):
    choice = FileChoice(folder, MESHES)
    listed(choice)
    choice.look_for("E")
    assert [entry.label for entry in choice.entries()] == ["Apple/", "zebra/", "ünïcode ☃.off"]
    assert choice.name == "ünïcode ☃.off"
    choice.look_for("none")
    assert (choice.entries(), choice.selected) == ([], "")
    choice.go(folder)
    assert len(listed(choice)) == 6


def test_entries_are_sorted_by_size_and_date(folder):
    for number, name in enumerate(("two words.off", "b.off", "A.OBJ")):
        (folder / name).write_text("x" * (5 + number))
        os.utime(folder / name, (0, 1e9 - number))
    os.utime(folder / "ünïcode ☃.off", (0, 0))
    choice = FileChoice(folder, MESHES)
    until(lambda: len(choice.details()) == 6)
    assert choice.details()["b.off"] == (6, 1e9 - 1)
    by_size = ["A.OBJ", "b.off", "two words.off", "ünïcode ☃.off"]
    by_date = ["two words.off", "b.off", "A.OBJ", "ünïcode ☃.off"]
    for column, names in (("size", by_size), ("date", by_date)):
        choice.order_by(column)
        assert [entry.name for entry in choice.entries()][2:] == names
        choice.order_by(column)
        assert [entry.name for entry in choice.entries()][2:] == names[::-1]
    choice.order_by("name")
    assert [entry.label for entry in choice.entries()][:3] == ["Apple/", "zebra/", "A.OBJ"]
    choice.order_by("name")
    assert choice.entries()[0].name == "zebra"


def test_hidden_files_are_listed_on_request(folder):
    assert ".hidden.off" in [one.name for one in read_folder(folder, MESHES, True).entries]


def test_folders_are_remembered_by_the_kind_of_file(tmp_path):
    stored = {}
    dialogs = Dialogs({}, stored.update)
    for name in ("meshes", "results"):
        (tmp_path / name).mkdir()
        dialogs.remember_folder(name, tmp_path / name)
    assert dialogs._start_folder("meshes") == tmp_path / "meshes"
    assert dialogs._start_folder("results") == tmp_path / "results"
    assert dialogs._start_folder("exports") == tmp_path / "meshes"
    again = Dialogs(stored)
    again.remember_folder("meshes", tmp_path)
    assert again._recent_folders("meshes") == [tmp_path, tmp_path / "meshes"]
    dialogs.start_in(tmp_path)
    assert dialogs._start_folder("results") == tmp_path
