"""Copies of unsaved work, with a clock of our own."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from abfm.io.atomic import temporary_file
from abfm.types import FloatArray
from abfm_viewer.document.document import Channel, Document, Surface
from abfm_viewer.files.autosave import Autosave, Recovery, recoverable
from abfm_viewer.files.project import load_project
from abfm_viewer.files.state_folder import StateFolder
from tests.shapes import icosphere

SURFACE = Surface(icosphere(1), "sphere")
DOCUMENT = Document((SURFACE,), (Channel("coordinate:x", "coordinate:y"),))
CHANGED = replace(DOCUMENT, surfaces=(replace(SURFACE, name="changed"),))


class Clock:
    """Stands still."""

    seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


class Known:
    """Values that take as long to compute as the test likes."""

    def __init__(self) -> None:
        self.asked, self.may_answer = threading.Event(), threading.Event()

    def __call__(self) -> Mapping[str, FloatArray]:
        self.asked.set()
        assert self.may_answer.wait(10)
        return {}


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
    autosave.offer(document, lambda: (document, {}), unsaved)
    settle(autosave)


def settle(autosave: Autosave) -> None:
    """Wait until nothing is being written."""
    end = time.monotonic() + 10
    while autosave._future is not None and not autosave._future.done():
        assert time.monotonic() < end
        time.sleep(0.001)


def copied(autosave: Autosave) -> str:
    """The name of the document in the copy; empty if there is none."""
    return load_project(autosave.path)[0].name if autosave.path.exists() else ""


def age(path: Path, seconds: float) -> None:
    """Let a file be written some time ago."""
    os.utime(path, (time.time() - seconds,) * 2)


class TestCopies:
    def test_a_copy_is_written_when_it_is_time_and_something_changed(
        self, autosave: Autosave, clock: Clock
    ) -> None:
        clock.seconds = 19
        offer(autosave, DOCUMENT)
        assert not autosave.path.exists()
        clock.seconds = 21
        offer(autosave, DOCUMENT)
        assert load_project(autosave.path)[0].channels == DOCUMENT.channels
        autosave.path.unlink()
        clock.seconds = 42
        offer(autosave, DOCUMENT)
        assert not autosave.path.exists()  # nothing changed
        clock.seconds = 61
        offer(autosave, CHANGED)
        assert not autosave.path.exists()  # not yet
        clock.seconds = 63
        offer(autosave, CHANGED)
        assert copied(autosave) == "changed"

    def test_values_from_other_files_are_in_it(self, autosave: Autosave, clock: Clock) -> None:
        values = SURFACE.mesh.vertices[:, 0]
        clock.seconds = 21
        autosave.offer(DOCUMENT, lambda: (DOCUMENT, {"file:a.npy": values}), True)
        autosave.close()
        assert (load_project(autosave.path)[1]["file:a.npy"] == values).all()

    def test_never_two_at_once_and_the_newest_wins(self, autosave: Autosave, clock: Clock) -> None:
        known = Known()
        clock.seconds = 21
        autosave.offer(DOCUMENT, lambda: (DOCUMENT, known()), True)
        assert known.asked.wait(10)
        for number in range(3):
            clock.seconds += 21
            autosave.offer(
                replace(DOCUMENT, channel=number), lambda: pytest.fail("two at once"), True
            )
        known.may_answer.set()
        settle(autosave)
        assert copied(autosave) == "sphere"
        offer(autosave, CHANGED)
        assert copied(autosave) == "changed"
        assert autosave.error == ""

    def test_a_heartbeat_tells_that_the_process_lives(
        self, autosave: Autosave, clock: Clock
    ) -> None:
        clock.seconds = 21
        offer(autosave, DOCUMENT)
        age(autosave.path, 1000)
        assert recoverable(StateFolder(autosave.path.parent)) != []
        clock.seconds = 42
        offer(autosave, DOCUMENT)
        assert recoverable(StateFolder(autosave.path.parent)) == []

    def test_the_copy_goes_as_soon_as_everything_is_saved(
        self, autosave: Autosave, clock: Clock
    ) -> None:
        clock.seconds = 21
        offer(autosave, DOCUMENT)
        offer(autosave, DOCUMENT, unsaved=False)
        assert not autosave.path.exists()
        clock.seconds = 42
        offer(autosave, DOCUMENT)  # undone to what was not saved
        assert copied(autosave) == "sphere"

    def test_a_copy_that_is_discarded_while_it_is_written_goes_too(
        self, autosave: Autosave, clock: Clock
    ) -> None:
        known = Known()
        clock.seconds = 21
        autosave.offer(DOCUMENT, lambda: (DOCUMENT, known()), True)
        assert known.asked.wait(10)
        autosave.discard()
        known.may_answer.set()
        autosave.close()
        assert list(autosave.path.parent.iterdir()) == []

    def test_a_copy_that_cannot_be_written_is_an_error_in_one_line_and_tried_again(
        self, tmp_path: Path, clock: Clock
    ) -> None:
        (tmp_path / "state").touch()
        autosave = Autosave(StateFolder(tmp_path / "state"), clock=clock)
        clock.seconds = 21
        offer(autosave, DOCUMENT)
        offer(autosave, DOCUMENT)
        assert "state" in autosave.error
        assert "\n" not in autosave.error
        (tmp_path / "state").unlink()
        clock.seconds = 42
        offer(autosave, DOCUMENT)
        offer(autosave, DOCUMENT)
        assert autosave.error == ""
        assert copied(autosave) == "sphere"
        autosave.close()

    def test_an_offer_where_nothing_is_to_be_done_does_nothing(
        self, autosave: Autosave, clock: Clock, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def offer_idly(document: Document, unsaved: bool) -> None:
            with monkeypatch.context() as patched:
                for name in ("utime", "unlink", "replace"):
                    patched.setattr(os, name, lambda *_: pytest.fail("a file was touched"))
                patched.setattr(
                    autosave._writer, "submit", lambda *_: pytest.fail("a copy was begun")
                )
                autosave.offer(document, lambda: pytest.fail("the content was asked for"), unsaved)

        offer_idly(DOCUMENT, unsaved=False)
        clock.seconds = 19
        offer_idly(DOCUMENT, unsaved=True)  # too early
        clock.seconds = 21
        offer(autosave, DOCUMENT)
        offer(autosave, DOCUMENT)  # takes in that it is written
        clock.seconds = 40
        for document in (DOCUMENT, CHANGED):
            offer_idly(document, unsaved=True)


class TestRecovery:
    def test_copies_of_ended_processes_come_latest_first(self, tmp_path: Path) -> None:
        ended = subprocess.Popen([sys.executable, "-c", ""])
        ended.wait()
        folder = StateFolder(tmp_path)
        left, own = (
            tmp_path / f"autosave-{ended.pid}.abfm",
            tmp_path / f"autosave-{os.getpid()}.abfm",
        )
        for path in (
            left,
            own,
            tmp_path / "autosave-x.abfm",
            tmp_path / f"autosave-{10**30}.abfm",
            tmp_path / "a.abfm",
        ):
            path.touch()
        [recovery] = recoverable(folder)
        assert recovery.path == left
        assert recovery.written == pytest.approx(time.time(), abs=60)
        age(own, 1000)  # without a heartbeat for so long, it is gone, whatever has its number now
        assert [found.path for found in recoverable(folder)] == [left, own]
        recovery.discard()
        recovery.discard()
        assert [found.path for found in recoverable(folder)] == [own]

    def test_what_an_earlier_process_of_the_same_number_left_is_not_overwritten(
        self, tmp_path: Path, clock: Clock
    ) -> None:
        """In a container every launch may have the same number."""
        folder = StateFolder(tmp_path)
        earlier = Autosave(folder, clock=clock)
        clock.seconds = 21
        offer(earlier, CHANGED)
        earlier.close()
        autosave = Autosave(folder, clock=clock)
        [recovery] = recoverable(folder)
        clock.seconds = 42
        offer(autosave, DOCUMENT)
        autosave.close()
        assert load_project(recovery.path)[0].name == "changed"
        assert copied(autosave) == "sphere"

    def test_what_is_taken_over_goes_when_it_is_saved(
        self, autosave: Autosave, tmp_path: Path
    ) -> None:
        left = tmp_path / "autosave-1-2.abfm"
        left.touch()
        [recovery] = recoverable(StateFolder(tmp_path))
        autosave.take_over(recovery)
        assert list(tmp_path.iterdir()) == [autosave.path]
        offer(autosave, DOCUMENT, unsaved=False)
        assert list(tmp_path.iterdir()) == []
        autosave.take_over(recovery)  # another window was faster

    def test_halves_of_killed_processes_are_removed_by_the_next_copy(
        self, autosave: Autosave, clock: Clock, tmp_path: Path
    ) -> None:
        with temporary_file(tmp_path) as half:
            left = half.name
        (tmp_path / left).touch()
        assert recoverable(StateFolder(tmp_path)) == []
        clock.seconds = 21
        offer(autosave, DOCUMENT)
        assert list(tmp_path.iterdir()) == [autosave.path]

    def test_no_folder_no_copies(self, tmp_path: Path) -> None:
        assert recoverable(StateFolder(tmp_path / "none")) == []
        Recovery(tmp_path / "none" / "autosave-1.abfm", 0).discard()
