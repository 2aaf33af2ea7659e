"""Rows whose task is a sequence of frames."""

from pathlib import Path

import numpy as np
import pytest

import abfm
from abfm.assets import asset_path
from abfm.batch import Ledger, Row, run
from abfm.batch.attempt import WorkItem, attempt
from abfm.batch.run import with_contents
from abfm.sequences import defaults, export_pvd
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import reporting_steps
from tests.core.batch.rows import ONE
from tests.messages import check_message
from tests.spare_processes import reused_processes

EIGHT = abfm.load_mesh(asset_path("eight.off"))
X = EIGHT.vertices[:, 0] / EIGHT.length_scale
FRAMES = np.array([np.sin(6 * (X - 0.02 * t)) for t in range(3)])


@pytest.fixture(scope="module", autouse=True)
def _batches_reuse_one_process():
    with reused_processes():
        yield


@pytest.fixture
def folder(tmp_path):
    np.save(tmp_path / "f.npy", FRAMES)
    return tmp_path


def sequence_row(folder, **more):
    given = {"mesh": asset_path("eight.off"), "frames": "f.npy", "dt": 0.5, "sigma": 0.5}
    return Row("sequence", given | more, folder)


def test_killed_row_resumes_to_equal_bytes(folder):
    row, control = sequence_row(folder), Control()
    single, ledger = Ledger(folder / "a"), Ledger(folder / "b")
    attempt(WorkItem(row, str(single.folder), single.make()))
    task = WorkItem(row, str(ledger.folder), ledger.make())

    def stop(now):
        if now is not None and now.task == "smoothing in time":
            control.cancel()

    with reporting_steps(stop), controlled(control), pytest.raises(CancelledError):
        attempt(task)
    [unfinished] = ledger.folder.glob("*.unfinished")
    content = unfinished.read_bytes()
    assert not ledger.result_path(row.key).exists()
    attempt(task)
    assert ledger.result_path(row.key).read_bytes() == single.result_path(row.key).read_bytes()
    assert not unfinished.exists()
    unfinished.write_bytes(content)  # as if the process was killed before it removed the checkpoint
    attempt(task)
    assert not unfinished.exists()


def test_row_cancelled_while_reading_is_missing(folder):
    np.save(folder / "f.npy", np.where(np.arange(FRAMES.shape[1]) < 9, np.nan, FRAMES))
    row, control, ledger = sequence_row(folder), Control(), Ledger(folder / "out")

    def stop(now):
        if now is not None and now.task == "filling in missing values":
            control.cancel()

    with reporting_steps(stop), controlled(control), pytest.raises(CancelledError):
        attempt(WorkItem(row, str(ledger.folder), ledger.make()))
    assert ledger.entry(row).state == "missing"


def test_row_equals_sequence_in_python(folder):
    np.save(folder / "f.npy", np.stack([FRAMES, FRAMES[::-1]], axis=2))
    [entry] = run([sequence_row(folder, channel="1 0", gamma=2)], folder / "out", ONE)
    found = entry.load()
    np.testing.assert_array_equal(found[0].weights, [1, 0])
    assert found.confirmed == 2
    frames, given = np.load(folder / "f.npy"), defaults(sigma=0.5)
    by_hand = abfm.sequence(EIGHT, frames, [0, 0.5, 1], given, 2.0, weights=[1, 0])
    np.testing.assert_array_equal(found.velocity, by_hand.velocity)
    assert entry.facts == by_hand.facts


def test_files_of_a_pvd_series_are_sent(folder):
    found = abfm.sequence(EIGHT, FRAMES, parameters=defaults(sigma=0.5))
    export_pvd(folder / "s.pvd", found)
    options = {"mesh": asset_path("eight.off"), "frames": "s.pvd", "array": "frame", "sigma": 0.5}
    row = Row("sequence", options, folder)
    parts = [Path(name) for name in row.files() if name.endswith(".vtu")]
    assert len(parts) == 3
    task = WorkItem(row, str(folder / "nowhere"), "somewhere else")
    answer = attempt(with_contents(task))
    assert answer.record.reason == ""
    assert answer.record.digest == row.key
    assert answer.result
    content = bytearray(parts[0].read_bytes())
    content[-30] ^= 1
    parts[0].write_bytes(content)
    assert Row("sequence", options, folder).key != row.key


def test_changed_file_fails_the_row(folder):
    row = sequence_row(folder)
    assert row.key
    np.save(folder / "f.npy", FRAMES[:1].repeat(3, axis=0))
    [entry] = run([row], folder / "out", ONE)
    check_message(entry.reason)
