import json
import os
import sys
from pathlib import Path

import pytest

from abfm_viewer.files.autosave import recoverable
from abfm_viewer.files.preferences import PreferenceFile, Preferences
from abfm_viewer.files.project import load_origin, load_project
from abfm_viewer.files.state_folder import STATE_VARIABLE, StateFolder
from tests.core.reading.hostile import refusal
from tests.messages import check_message


@pytest.fixture
def folder(tmp_path):
    return StateFolder(tmp_path / "not there yet" / "state")


def test_recent_files_are_listed_once_latest_first(folder, tmp_path, monkeypatch):
    files = [tmp_path / f"mesh {number}.off" for number in range(12)]
    for file in files:
        file.touch()
        folder.add_recent(file)
    folder.add_recent(files[5])
    names = [files[5], *reversed(files[6:]), *reversed(files[2:5])]
    assert folder.recent() == [(name,) for name in names]
    files[11].unlink()
    assert (files[11],) not in folder.recent()
    folder.clear_recent()
    assert folder.recent() == []
    (tmp_path / "a.off").touch()
    monkeypatch.chdir(tmp_path)
    folder.add_recent(Path("a.off"))
    recent = folder.path / "recent.json"
    known = json.loads(recent.read_text())
    recent.write_text(json.dumps([None, {}, "", "a\0b", "x" * 5000, str(tmp_path), *known]))
    assert folder.recent() == [(tmp_path / "a.off",)]


def test_two_files_opened_together_are_one_recent_entry(folder, tmp_path):
    a, b, waves = (tmp_path / name for name in ("a.off", "b.off", "waves.npy"))
    for path in (a, b, waves):
        path.touch()
        folder.add_recent(path)
    folder.add_recent(a, b)
    folder.add_recent(a, waves)
    assert folder.recent() == [(a, waves), (a, b), (waves,), (b,)]
    waves.unlink()
    assert folder.recent() == [(a, b), (b,)]


def test_preferences_are_kept(folder, tmp_path):
    preferences, other = PreferenceFile(folder), PreferenceFile(folder)
    assert preferences.now == Preferences()
    preferences.change(theme="dark", columns={"batch": ("residual", "seconds")})
    other.change(ui_scale=1.5, folders={"meshes": ("/a", "/b")})
    assert PreferenceFile(StateFolder(folder.path)).now == Preferences(
        theme="dark",
        ui_scale=1.5,
        folders={"meshes": ("/a", "/b")},
        columns={"batch": ("residual", "seconds")},
    )
    (tmp_path / "file").touch()
    folder = StateFolder(tmp_path / "file" / "state")
    folder.add_recent(tmp_path / "file")
    preferences = PreferenceFile(folder)
    preferences.change(theme="dark")
    assert (folder.recent(), preferences.now.theme) == ([], "dark")
    assert PreferenceFile(folder).now == Preferences()


@pytest.mark.parametrize(
    "content", ["", "{", "[1, 2", "null", "3", '{"a": 1}', "[" * 100_000, "[null, 3]"]
)
def test_damaged_files_count_as_empty(folder, content):
    folder.path.mkdir(parents=True)
    for name in ("recent.json", "preferences.json"):
        (folder.path / name).write_text(content)
    assert folder.recent() == []
    assert PreferenceFile(folder).now == Preferences()


def test_only_damaged_preferences_have_defaults(folder):
    damaged = {"theme": "pink", "ui_scale": 1e9, "follow": "maybe", "folders": {"mesh": 3}}
    damaged |= {"columns": {"batch": "all"}, "unknown": 1}
    folder.write("preferences.json", damaged | {"tour_seen": True})
    assert PreferenceFile(folder).now == Preferences(tour_seen=True)


def test_the_environment_names_the_folder(monkeypatch, tmp_path):
    monkeypatch.setenv(STATE_VARIABLE, str(tmp_path))
    assert StateFolder().path == tmp_path
    monkeypatch.delenv(STATE_VARIABLE)
    assert StateFolder().path.name == "abfm"


@pytest.mark.skipif(sys.platform != "linux", reason="each system has its own place")
def test_default_is_the_system_s_folder_for_state(monkeypatch, tmp_path):
    for name in (STATE_VARIABLE, "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, place in (("HOME", ".local/state/abfm"), ("XDG_STATE_HOME", "abfm")):
        monkeypatch.setenv(name, str(tmp_path))
        assert StateFolder().path == tmp_path / place


def test_a_state_folder_of_pipes_and_devices_is_empty(tmp_path):
    folder = StateFolder(tmp_path)
    os.mkfifo(tmp_path / "recent.json")
    (tmp_path / "preferences.json").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "autosave-1-left.abfm")
    assert folder.recent() == []
    assert PreferenceFile(folder).now == Preferences()
    [copy] = recoverable(folder)
    assert load_origin(copy.path) is None
    check_message(refusal(load_project, copy.path))
    (tmp_path / "recent.json").unlink()
    (tmp_path / "recent.json").write_text("[" + '"a",' * 300_000 + '"a"]')
    assert folder.recent() == []
