"""Autosaved copies, with an artificial clock."""

import os
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm.io.atomic import temporary_file
from abfm.sequences import checkpoints_of, defaults
from abfm.sequences.frames import check_frames
from abfm_viewer.document.document import Channel, Surface
from abfm_viewer.document.frame_sequence import FrameSequence
from abfm_viewer.document.kinds import MatchDocument, SequenceDocument
from abfm_viewer.files.autosave import Autosave, Recovery, recoverable
from abfm_viewer.files.project import load_project
from abfm_viewer.files.state_folder import StateFolder
from tests.shapes import icosphere
from tests.viewer.sessions import until

SURFACE = Surface(icosphere(1), "sphere")
DOCUMENT = MatchDocument((SURFACE,), (Channel("coordinate:x", "coordinate:y"),))
SEQUENCE = FrameSequence(
    "waves", check_frames(SURFACE.mesh, np.eye(3, len(SURFACE.mesh.vertices)), None, None, None)
)
CHANGED = replace(DOCUMENT, surfaces=(replace(SURFACE, name="changed"),))


class Clock:
    """A clock that stands still until the test moves it."""

    seconds = 0.0

    def __call__(self):
        return self.seconds


class Slow:
    """A document whose computation waits for the test."""

    def __init__(self):
        self.requested, self.may_answer = threading.Event(), threading.Event()

    def __call__(self):
        self.requested.set()
        assert self.may_answer.wait(10)
        return DOCUMENT, {}


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def autosave(tmp_path, clock):
    """Return an `Autosave` for which the first copy is due."""
    autosave = Autosave(StateFolder(tmp_path), seconds=20, clock=clock)
    clock.seconds = 21
    yield autosave
    autosave.close()


def offer(autosave, document, unsaved=True):
    """Offer a document, and wait until the copy is written."""
    autosave.offer(document, lambda: (document, {}), unsaved)
    settle(autosave)


def settle(autosave):
    until(lambda: autosave._future is None or autosave._future.done())


def copied(autosave):
    """Return the name of the document in the copy; empty if there is none."""
    return load_project(autosave.path)[0].name if autosave.path.exists() else ""


def age(path, seconds):
    """Set the time of a file's last modification back."""
    os.utime(path, (time.time() - seconds,) * 2)


def test_copy_is_written_when_due_and_changed(autosave, clock):
    for seconds, document, name in (
        (19, DOCUMENT, ""),
        (21, DOCUMENT, "sphere"),
        (42, DOCUMENT, ""),  # nothing changed
        (61, CHANGED, ""),  # not due yet
        (63, CHANGED, "changed"),
    ):
        autosave.path.unlink(missing_ok=True)
        clock.seconds = seconds
        offer(autosave, document)
        assert copied(autosave) == name
    assert load_project(autosave.path)[0].channels == DOCUMENT.channels


def test_copy_has_values_from_other_files(autosave):
    values = SURFACE.mesh.vertices[:, 0]
    autosave.offer(DOCUMENT, lambda: (DOCUMENT, {"file:a.npy": values}), True)
    autosave.close()
    assert (load_project(autosave.path)[1]["file:a.npy"] == values).all()


def test_copies_are_written_one_at_a_time(autosave, clock):
    slow = Slow()
    autosave.offer(DOCUMENT, slow, True)
    assert slow.requested.wait(10)
    for number in range(3):
        clock.seconds += 21
        autosave.offer(replace(DOCUMENT, channel=number), lambda: pytest.fail("two at once"), True)
    slow.may_answer.set()
    settle(autosave)
    assert copied(autosave) == "sphere"
    offer(autosave, CHANGED)
    assert copied(autosave) == "changed"
    assert autosave.error == ""


def test_heartbeat_lasts_until_everything_is_saved(autosave, clock, tmp_path):
    offer(autosave, DOCUMENT)
    age(autosave.path, 1000)
    assert recoverable(StateFolder(tmp_path)) != []
    changed = autosave.path.stat().st_mtime
    clock.seconds = 42
    offer(autosave, DOCUMENT)
    assert recoverable(StateFolder(tmp_path)) == []
    assert autosave.path.stat().st_mtime == changed  # the time of its content
    offer(autosave, DOCUMENT, unsaved=False)
    assert not autosave.path.exists()
    clock.seconds = 63
    offer(autosave, DOCUMENT)  # undo leads to an unsaved state
    assert copied(autosave) == "sphere"


def test_copy_discarded_while_it_is_written_is_removed(autosave, tmp_path):
    slow = Slow()
    autosave.offer(DOCUMENT, slow, True)
    assert slow.requested.wait(10)
    autosave.discard()
    slow.may_answer.set()
    autosave.close()
    assert list(tmp_path.iterdir()) == []


def test_failed_copy_is_reported_and_tried_again(tmp_path, clock):
    folder = tmp_path / "state"
    folder.touch()
    autosave = Autosave(StateFolder(folder), clock=clock)
    for seconds, has_error in ((21, True), (42, False)):
        clock.seconds = seconds
        offer(autosave, DOCUMENT)
        offer(autosave, DOCUMENT)
        assert ("state" in autosave.error) is has_error
        assert "\n" not in autosave.error
        if has_error:
            folder.unlink()
    assert autosave.error == ""
    assert copied(autosave) == "sphere"
    autosave.close()


def test_offer_without_changes_does_nothing(autosave, clock, monkeypatch):
    def offer_idly(document, unsaved):
        with monkeypatch.context() as patched:
            for name in ("utime", "unlink", "replace"):
                patched.setattr(os, name, lambda *_: pytest.fail("a file was touched"))
            patched.setattr(
                autosave._writer, "submit", lambda *_: pytest.fail("a copy was written")
            )
            autosave.offer(document, lambda: pytest.fail("the content was computed"), unsaved)

    offer_idly(DOCUMENT, unsaved=False)
    clock.seconds = 19
    offer_idly(DOCUMENT, unsaved=True)  # too early
    clock.seconds = 21
    offer(autosave, DOCUMENT)
    offer(autosave, DOCUMENT)  # notices that the copy is written
    clock.seconds = 40
    for document in (DOCUMENT, CHANGED):
        offer_idly(document, unsaved=True)


def test_copies_of_ended_processes_come_latest_first(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    numbers = (f"autosave-{number}" for number in (ended.pid, os.getpid(), "x", 10**30))
    leftover, current, *_ = paths = [tmp_path / f"{name}.abfm" for name in (*numbers, "a")]
    for path in paths:
        path.touch()
    [recovery] = recoverable(StateFolder(tmp_path))
    assert recovery.path == leftover
    assert recovery.changed == pytest.approx(time.time(), abs=60)
    # without a heartbeat the process has ended, even if another one has its number
    age(current, 1000)
    assert [found.path for found in recoverable(StateFolder(tmp_path))] == [leftover, current]
    recovery.discard()
    recovery.discard()
    assert [found.path for found in recoverable(StateFolder(tmp_path))] == [current]
    assert recoverable(StateFolder(tmp_path / "none")) == []
    Recovery(tmp_path / "none" / "autosave-1.abfm", 0).discard()


def test_copy_of_a_process_of_equal_number_is_kept(autosave, clock, tmp_path):
    """A copy is not overwritten by a launch with the same process number, as in containers."""
    offer(autosave, CHANGED)
    later = Autosave(StateFolder(tmp_path), clock=clock)
    [recovery] = recoverable(StateFolder(tmp_path))
    clock.seconds = 42
    offer(later, DOCUMENT)
    later.close()
    assert load_project(recovery.path)[0].name == "changed"
    assert copied(later) == "sphere"


def test_recovered_copy_is_removed_when_saved(autosave, tmp_path):
    (tmp_path / "autosave-1-2.abfm").touch()
    [recovery] = recoverable(StateFolder(tmp_path))
    autosave.take_over(recovery)
    assert list(tmp_path.iterdir()) == [autosave.path]
    offer(autosave, DOCUMENT, unsaved=False)
    assert list(tmp_path.iterdir()) == []
    autosave.take_over(recovery)  # another window was faster
    with temporary_file(tmp_path) as half:
        leftover = half.name
    (tmp_path / leftover).touch()
    os.utime(tmp_path / leftover, (0, 0))
    assert recoverable(StateFolder(tmp_path)) == []
    offer(autosave, DOCUMENT)
    assert list(tmp_path.iterdir()) == [autosave.path]


@pytest.fixture
def sequences():
    """Return documents of a sequence with all fields and with some of them."""
    frames, control = SEQUENCE.frames, abfm.workers.Control()
    given = frames.mesh, frames.values[:, :, 0], None, defaults(sigma=0.5), 0
    complete = abfm.sequence(*given)
    part = abfm.sequence(*given, on_interval=lambda _: control.cancel(), control=control)
    assert not part.solved.all()
    document = SequenceDocument((SURFACE,), SEQUENCE)
    return tuple(replace(document, result=replace(s, _frames=frames)) for s in (complete, part))


def checkpoint_file(autosave):
    path = autosave.path.with_name(f"{autosave.path.name}-1a2b3c4d.unfinished")
    path.touch()
    return path


def test_document_of_a_running_sequence_is_copied_once(autosave, clock):
    document, run = SequenceDocument((SURFACE,), SEQUENCE), object()
    later = replace(document, time=1.0)
    for seconds, shown, of, is_written in (
        (1, document, run, True),
        (2, later, run, False),  # as if it played meanwhile
        (22, later, run, True),
        (50, later, run, False),
        (51, document, object(), True),
    ):
        clock.seconds = seconds
        autosave.offer(shown, lambda shown=shown: (shown, {}), True, sequence_run=of)
        settle(autosave)
        assert (copied(autosave) == "waves on sphere") is is_written
        autosave.path.unlink(missing_ok=True)


def test_failed_copy_of_a_running_sequence_is_repeated(tmp_path, clock):
    (tmp_path / "state").touch()
    autosave = Autosave(StateFolder(tmp_path / "state"), seconds=20, clock=clock)
    document, run, tried = SequenceDocument((SURFACE,), SEQUENCE), object(), list[int]()
    for seconds in (1, 2, 3, 19, 22, 23):
        clock.seconds = seconds
        autosave.offer(document, lambda: (document, {}), True, sequence_run=run)
        if autosave._future is not None:
            tried.append(seconds)
        settle(autosave)
    assert tried == [1, 22]
    autosave.close()


def test_checkpoint_is_removed_when_a_copy_is_complete(autosave, clock, sequences):
    complete, part = sequences
    path = checkpoint_file(autosave)
    for document, run in ((part, None), (complete, object())):
        autosave.offer(document, lambda given=document: (given, {}), True, None, run)
        settle(autosave)
        clock.seconds += 21
        assert path.exists()
    autosave.offer(part, lambda: (part, {}), True)
    settle(autosave)
    clock.seconds += 21
    offer(autosave, complete)
    assert not path.exists()
    assert autosave.path.exists()


def test_checkpoint_is_removed_and_recovered_with_its_copy(autosave, tmp_path):
    checkpoint_file(autosave)
    offer(autosave, DOCUMENT)
    offer(autosave, DOCUMENT, unsaved=False)
    assert list(tmp_path.iterdir()) == []
    for name in ("autosave-1-2.abfm", "autosave-1-2.abfm-1a2b3c4d.unfinished"):
        (tmp_path / name).touch()
    [recovery] = recoverable(StateFolder(tmp_path))
    assert not autosave.has_checkpoint
    autosave.take_over(recovery)
    assert autosave.has_checkpoint
    [path] = checkpoints_of(autosave.path)
    assert {*tmp_path.iterdir()} == {autosave.path, path}
    later = Autosave(StateFolder(tmp_path))  # a process of the same number
    later.close()
    [recovery] = recoverable(StateFolder(tmp_path))
    assert len(checkpoints_of(recovery.path)) == 1
    recovery.discard()
    assert list(tmp_path.iterdir()) == []


def test_checkpoints_without_a_copy_are_removed(autosave, tmp_path):
    for name in ("autosave-1-2.abfm", "autosave-1-3.abfm"):
        (tmp_path / f"{name}-1a2b3c4d.unfinished").touch()
    (tmp_path / "autosave-1-2.abfm").touch()
    current = checkpoint_file(autosave)  # its copy is not there yet
    [recovery] = recoverable(StateFolder(tmp_path))
    assert {*tmp_path.iterdir()} == {recovery.path, *checkpoints_of(recovery.path), current}
    assert recovery.path.name == "autosave-1-2.abfm"
