"""Runs of sequences that are killed and resumed."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import abfm
from abfm.sequences import (
    SequenceCheckpoint,
    checkpoint_file,
    checkpoints_of,
    defaults,
    move_checkpoints,
    remove_checkpoints,
)
from abfm.workers import Control
from abfm.workers.progress import reporting_steps
from tests.core.sequences.known_motions import SPHERE, bumps
from tests.core.sequences.rotating_sphere import MESH, TIMES, rotating_frames


class Killed(BaseException):
    """Raised instead of killing the process."""


class KilledCheckpoint(SequenceCheckpoint):
    """A checkpoint that is written after each step, and then raises `Killed` once per step."""

    steps_done = 0

    def save(self, solver, force=True):
        super().save(solver)
        checked = np.isfinite(solver.flow_line_checks).all(axis=1)
        done = np.count_nonzero(solver.found) + solver.swept_intervals + np.count_nonzero(checked)
        if done > KilledCheckpoint.steps_done:
            KilledCheckpoint.steps_done = done
            raise Killed


def solved(checkpoint=None, gamma=1.0, **more):
    return abfm.sequence(MESH, rotating_frames(), TIMES, gamma=gamma, checkpoint=checkpoint, **more)


@pytest.fixture(scope="module")
def complete():
    return solved()


def assert_same(found, expected):
    arrays = expected.arrays()
    for name, array in found.arrays().items():
        assert_array_equal(array, arrays[name], err_msg=name)


def test_run_killed_after_each_step_gives_the_same_result(tmp_path):
    """A run that is killed after each step, and resumed, gives the result of a single run.

    The frames are bumps that jump and change, for which all searches but one fail.
    """
    places, sizes, heights = [0, 3, 0, 1.6], [0.4, 0.2, 0.4, 0.4], [1, 2, 1, 1]
    frames = [h * bumps([a], w, 0)[0] for a, w, h in zip(places, sizes, heights, strict=True)]
    given = SPHERE, frames, None, defaults(order=1, alpha=1, sigma=0.3)
    resumed, kills, found = [], 0, None
    while found is None:
        checkpoint = KilledCheckpoint(tmp_path / "s.npz", resumed.append)
        try:
            found = abfm.sequence(*given, checkpoint=checkpoint)
        except Killed:
            kills += 1
    assert_same(found, abfm.sequence(*given))
    assert resumed[:2] == [1, 2]
    assert set(resumed[2:]) == {3}  # in three intervals, during the sweeps and the checks
    assert len(resumed) == kills > 3 + 2 * 3
    assert [path.name for path in tmp_path.iterdir()] == [checkpoint.path.name]
    checkpoint.remove()
    assert not any(tmp_path.iterdir())


def test_cancelled_run_resumes(complete, tmp_path):
    control, again, tasks = Control(), [], set()
    stop = {"control": control, "on_interval": lambda i: control.cancel() if i == 1 else None}
    part = solved(SequenceCheckpoint(tmp_path / "s.npz"), **stop)
    assert [np.abs(field).max() > 0 for field in part.velocity] == [True, True, False, False]
    with reporting_steps(lambda now: tasks.add(now and now.task)):
        found = solved(SequenceCheckpoint(tmp_path / "s.npz"), on_interval=again.append)
    assert_same(found, complete)
    assert again == [2, 3]
    assert "following the frames" in tasks
    assert "choosing sigma" not in tasks


def test_checked_intervals_are_not_checked_again(complete, tmp_path):
    first = SequenceCheckpoint(tmp_path / "s.npz")
    solved(first)
    arrays = dict(np.load(first.path))
    arrays["flow_line_checks"][2] = 0.5, 0.25
    with first.path.open("wb") as file:
        np.savez(file, **arrays)
    found = solved(SequenceCheckpoint(tmp_path / "s.npz"))
    assert (found.verified_residual[2], found.folded[2]) == (0.5, 0.25)
    others = [0, 1, 3]
    assert_array_equal(found.verified_residual[others], complete.verified_residual[others])


def test_other_problem_or_damaged_file_restarts(complete, tmp_path):
    first, other = (SequenceCheckpoint(tmp_path / "s.npz", pytest.fail) for _ in range(2))
    solved(first)
    solved(other, gamma=0.0)
    assert first.path.name.startswith("s.npz-")
    assert first.path != other.path
    content = first.path.read_bytes()
    for damaged in (content[:-100], b"", other.path.read_bytes()):
        first.path.write_bytes(damaged)
        none = SequenceCheckpoint(tmp_path / "s.npz", pytest.fail, solve_remaining=False)
        assert not solved(none).solved.any()
    assert_same(solved(SequenceCheckpoint(tmp_path / "s.npz", pytest.fail)), complete)
    assert first.path.read_bytes() == content


def test_earlier_results_are_returned_without_solving(complete, tmp_path):
    fields = {}
    none = solved(SequenceCheckpoint(tmp_path / "s.npz", pytest.fail, solve_remaining=False))
    assert not none.solved.any()
    assert not any(tmp_path.iterdir())
    control = Control()
    stop = {"control": control, "on_interval": lambda i: control.cancel() if i == 1 else None}
    part = solved(SequenceCheckpoint(tmp_path / "s.npz"), **stop)
    [path] = checkpoints_of(tmp_path / "s.npz")
    content_before = path.read_bytes()
    again = solved(
        SequenceCheckpoint(tmp_path / "s.npz", solve_remaining=False), on_field=fields.setdefault
    )
    assert_same(again, part)
    assert_array_equal(again.solved, [True, True, False, False])
    assert np.isfinite(again.verified_residual[:2]).all()
    assert path.read_bytes() == content_before  # preliminary fields are checked, but not stored
    assert list(fields) == [0, 1]
    assert_array_equal(np.stack([*fields.values()]), part.velocity[:2])
    assert_same(solved(SequenceCheckpoint(tmp_path / "s.npz")), complete)


def test_other_code_restarts(tmp_path, monkeypatch):
    first, other = (
        SequenceCheckpoint(tmp_path / "s.npz"),
        SequenceCheckpoint(tmp_path / "s.npz", pytest.fail),
    )
    solved(first)
    assert checkpoint_file._code() == checkpoint_file._code()
    monkeypatch.setattr(checkpoint_file, "_code", lambda: "another")
    solved(other)
    assert first.path != other.path


def test_checkpoints_move_with_their_result(tmp_path):
    for name in ("a-1.npz-1a2b3c4d.unfinished", "a-1.npz-2.unfinished", "a-1-1.npz-3.unfinished"):
        (tmp_path / name).touch()
    move_checkpoints(tmp_path / "a-1.npz", tmp_path / "b.npz")
    remaining = {path.name for path in tmp_path.iterdir()}
    names = ("b.npz-1a2b3c4d", "b.npz-2", "a-1-1.npz-3")
    assert remaining == {f"{name}.unfinished" for name in names}


def test_only_checkpoints_of_a_result_are_removed(tmp_path):
    for name in ("s[1].npz-1a2b3c4d.unfinished", "s1.npz-1a2b3c4d.unfinished", "s[1].npz"):
        (tmp_path / name).touch()
    remove_checkpoints(tmp_path / "s[1].npz")
    remaining = {path.name for path in tmp_path.iterdir()}
    assert remaining == {"s1.npz-1a2b3c4d.unfinished", "s[1].npz"}


def test_unwritable_checkpoint_does_not_stop_the_run(complete, tmp_path):
    checkpoint = SequenceCheckpoint(tmp_path / "no folder" / "s.npz")
    assert_same(solved(checkpoint), complete)
    checkpoint.remove()
