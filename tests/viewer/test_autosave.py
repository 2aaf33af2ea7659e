"""Copies of unsaved work, with a clock of our own."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from abfm_viewer.autosave import Autosave, recoverable
from abfm_viewer.document import Channel, Document
from abfm_viewer.project import load_project
from abfm_viewer.state_folder import StateFolder
from tests.shapes import icosphere

DOCUMENT = Document(icosphere(1), "sphere", channels=(Channel("coordinate:x", "coordinate:y"),))


class Clock:
    seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def autosave(tmp_path: Path, clock: Clock) -> Iterator[Autosave]:
    autosave = Autosave(StateFolder(tmp_path), seconds=20, clock=clock)
    yield autosave
    autosave.close()


def offer(autosave: Autosave, document: Document, unsaved: bool = True) -> None:
    """Offer a document, and let what is then written be written."""
    autosave.offer(document, dict, unsaved)
    end = time.monotonic() + 10
    while autosave._future is not None and not autosave._future.done():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_a_copy_is_written_when_it_is_time_and_something_changed(autosave: Autosave, clock: Clock) -> None:
    offer(autosave, DOCUMENT)
    assert not autosave.path.exists()
    clock.seconds = 21
    offer(autosave, DOCUMENT)
    assert load_project(autosave.path)[0].channels == DOCUMENT.channels
    autosave.path.unlink()
    clock.seconds = 42
    offer(autosave, DOCUMENT)
    assert not autosave.path.exists()  # nothing changed
    clock.seconds = 63
    offer(autosave, replace(DOCUMENT, name="changed"))
    assert load_project(autosave.path)[0].name == "changed"


def test_the_copy_goes_when_everything_is_saved(autosave: Autosave, clock: Clock) -> None:
    clock.seconds = 21
    offer(autosave, DOCUMENT)
    clock.seconds = 42
    offer(autosave, DOCUMENT, unsaved=False)
    assert not autosave.path.exists()


def test_a_copy_that_cannot_be_written_is_an_error_in_one_line(tmp_path: Path, clock: Clock) -> None:
    (tmp_path / "file").touch()
    autosave = Autosave(StateFolder(tmp_path / "file"), clock=clock)
    clock.seconds = 21
    offer(autosave, DOCUMENT)
    autosave.offer(DOCUMENT, dict, True)
    assert autosave.error
    assert "\n" not in autosave.error
    autosave.close()


def test_copies_of_ended_processes_can_be_recovered(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    folder = StateFolder(tmp_path)
    left, own = tmp_path / f"autosave-{ended.pid}.abfm", tmp_path / f"autosave-{os.getpid()}.abfm"
    for path in (left, own, tmp_path / "autosave-x.abfm", tmp_path / "other.abfm"):
        path.touch()
    [recovery] = recoverable(folder)
    assert recovery.path == left
    recovery.discard()
    assert recoverable(folder) == []
    assert recoverable(folder, now=time.time() + 1000)[0].path == own  # without a heartbeat for so long, it is gone


def test_no_folder_no_copies(tmp_path: Path) -> None:
    assert recoverable(StateFolder(tmp_path / "none")) == []
