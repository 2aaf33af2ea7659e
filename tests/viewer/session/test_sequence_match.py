"""Match of a sequence: killed and cancelled runs resume, and the session takes their results."""

import os
import signal
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

import abfm
from abfm.sequences import defaults
from abfm.sequences.frames import check_frames
from abfm_viewer.computing.run import Process, Run
from abfm_viewer.document.document import Surface
from abfm_viewer.document.frame_sequence import FrameSequence, SequenceSettings
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.panels.inputs.frames import _chosen
from abfm_viewer.session import sequence_match
from abfm_viewer.session.sequence_match import SequenceMatch
from tests.messages import check_names
from tests.shapes import icosphere
from tests.viewer.sessions import until

SPHERE = icosphere(2)

TURNED = [SPHERE.vertices[:, 0] * np.cos(a) + SPHERE.vertices[:, 1] * np.sin(a) for a in range(24)]
FRAMES = np.array([np.exp(2 * each) for each in TURNED])
DOCUMENT = SequenceDocument(
    (Surface(SPHERE, "sphere"),),
    FrameSequence("waves", check_frames(SPHERE, FRAMES, None, None, None)),
    settings=SequenceSettings(sigma=0.3, gamma=0.5),
)


@pytest.fixture(scope="module")
def complete():
    return abfm.sequence(SPHERE, FRAMES, None, defaults(sigma=0.3), 0.5)


class CollectedMatch(SequenceMatch):
    """Match of a sequence whose result is returned by `ended`."""

    def __init__(self):
        self.run = Run(Process())
        super().__init__(self.run)

    def begin(self, document, resumes_only=False):
        self.start(document, lambda began, found: setattr(self, "result", found), resumes_only)

    def ended(self):
        assert self.run.wait(60)
        self.run.collect()
        return self.result


@pytest.fixture
def match(tmp_path):
    match = CollectedMatch()
    match.checkpoint_base = lambda document: tmp_path / "copy.abfm"
    yield match
    match.run.close()


def stored(folder):
    """Return the number of fields in the checkpoint."""
    with suppress(ValueError, OSError):
        [path] = folder.glob("copy.abfm-*.unfinished")
        with np.load(path) as arrays:
            return len(arrays["fields"])
    return 0


def kill(match, folder, last=None):
    """Kill the process of a match when it has stored another field; return its number."""
    before = stored(folder)
    until(lambda: stored(folder) > before and match.run.process._worker.pid not in (None, last))
    os.kill(pid := match.run.process._worker.pid, signal.SIGKILL)
    return pid


def test_next_run_resumes_from_a_failed_one(match, complete, tmp_path, monkeypatch):
    monkeypatch.setattr(sequence_match, "_TRIES", 2)
    match.begin(DOCUMENT)
    kill(match, tmp_path, kill(match, tmp_path))
    assert match.ended() is None
    assert match.run.reason == sequence_match._ENDED_MESSAGE
    assert match.found_count(DOCUMENT) == 0
    count = stored(tmp_path)
    assert count >= 2
    match.begin(DOCUMENT)
    until(lambda: match.found_count(DOCUMENT) >= count)
    assert match.fast_speed(DOCUMENT) > 0
    found = match.ended()
    np.testing.assert_array_equal(found.velocity, complete.velocity)
    assert found.confirmed == complete.confirmed == 23


def test_checkpoint_is_returned_without_solving(match, tmp_path):
    match.begin(DOCUMENT)
    until(lambda: stored(tmp_path))
    match.run.cancel()
    match.ended()
    count = stored(tmp_path)
    assert 0 < count < 23
    match.begin(DOCUMENT, resumes_only=True)
    found = match.ended()
    assert found.solved.tolist() == [True] * count + [False] * (23 - count)
    assert found.confirmed == count
    assert found.frames is DOCUMENT.sequence.frames.values
    match.begin(replace(DOCUMENT, settings=SequenceSettings(sigma=0.4)), resumes_only=True)
    assert not match.ended().solved.any()


def test_without_a_path_there_is_no_checkpoint(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    match = CollectedMatch()
    match.begin(DOCUMENT)
    until(lambda: match.found_count(DOCUMENT) > 1)
    match.run.cancel()
    assert 0 < match.ended().solved.sum() < 23
    assert not any(tmp_path.iterdir())
    match.run.close()


@pytest.fixture
def long_sequence(session, tmp_path):
    """Return a session with a sequence of many frames."""
    session.sequence_match.checkpoint_base = lambda document: tmp_path / "copy.abfm"
    angles = 0.1 * np.arange(120)[:, None]
    x, y, _ = SPHERE.vertices.T
    frames = np.exp(2 * (x * np.cos(angles) + y * np.sin(angles)))
    many = replace(DOCUMENT.sequence, frames=check_frames(SPHERE, frames, None, None, None))
    session.restore(replace(DOCUMENT, sequence=many), {}, None)
    return session


def cancelled(session, when):
    """Cancel a run when a condition holds; return the sequence and the message."""
    session.match()
    until(lambda: when(session), session)
    session.solver.cancel()
    until(lambda: not session.solver.running, session)
    return session.document.result, session.notices.latest.text


def test_cancelled_runs_keep_their_fields_and_earlier_results(long_sequence):
    def found(count):
        return lambda session: session.sequence_match.found_count(session.document) > count

    sequence, text = cancelled(long_sequence, lambda session: session.solver.running)
    assert (sequence, text) == (None, "cancelled: 0 of 119 intervals found")
    first, text = cancelled(long_sequence, found(1))
    solved = first.solved.tolist()
    count = sum(solved)
    assert solved == [True] * count + [False] * (119 - count)
    for interval, is_found in enumerate(solved):
        field = long_sequence.sequence_match.field(long_sequence.document, interval)
        assert (field is not None) == is_found == bool(first.velocity[interval].any())
    check_names(text, "cancelled", count, 119)
    second, text = cancelled(long_sequence, found(count))  # the run resumes
    now = int(second.solved.sum())
    assert now > count
    check_names(text, "cancelled", now, 119, count)
    long_sequence.undo()
    assert long_sequence.document.result is first
    long_sequence.redo()
    assert long_sequence.document.result is second
    long_sequence.editor.set_sequence_settings(alpha=2.0)  # settings without a result
    third, text = cancelled(long_sequence, lambda session: session.solver.running)
    again = 0 if third is second else int(third.solved.sum())
    assert again < now
    check_names(text, "cancelled", again, 119)


def test_chosen_settings_are_shown_and_stay_automatic(session):
    few = replace(DOCUMENT.sequence, frames=check_frames(SPHERE, FRAMES[:5], None, None, None))
    session.restore(replace(DOCUMENT, sequence=few, settings=SequenceSettings()), {}, None)
    session.match()
    until(lambda: not session.solver.running, session)
    document = session.document
    used = document.result.parameters
    assert used.automatic == ("alpha", "order")
    assert document.settings == SequenceSettings()
    assert not document.is_outdated
    chosen = f"order {used.order}, α {used.alpha:.3g}, σ {document.result.sigma:.3g}"
    assert _chosen(document) == f"chosen: {chosen}"
