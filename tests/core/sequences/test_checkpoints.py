"""Films whose runs are killed, and go on."""

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
from tests.core.sequences.films import SPHERE, bumps
from tests.core.sequences.turning_film import MESH, TIMES, film


class Killed(BaseException):
    """The end of a process."""


class Deadly(SequenceCheckpoint):
    """Writes after each step, and is killed then, unless it came so far before."""

    been = 0

    def save(self, solver, force=True):
        super().save(solver)
        checked = np.isfinite(solver.flow_line_checks).all(axis=1)
        come = np.count_nonzero(solver.found) + solver.swept_intervals + np.count_nonzero(checked)
        if come > Deadly.been:
            Deadly.been = come
            raise Killed


def solved(checkpoint=None, gamma=1.0, **more):
    return abfm.sequence(MESH, film(), TIMES, gamma=gamma, checkpoint=checkpoint, **more)


@pytest.fixture(scope="module")
def whole():
    return solved()


def assert_same(found, wanted):
    arrays = wanted.arrays()
    for name, array in found.arrays().items():
        assert_array_equal(array, arrays[name], err_msg=name)


def test_one_that_is_killed_after_each_step_finds_the_same_bit_for_bit(tmp_path):
    """Of bumps that jump and change, which are searched for in vain, and one that is found."""
    places, sizes, heights = [0, 3, 0, 1.6], [0.4, 0.2, 0.4, 0.4], [1, 2, 1, 1]
    frames = [h * bumps([a], w, 0)[0] for a, w, h in zip(places, sizes, heights, strict=True)]
    given = SPHERE, frames, None, defaults(order=1, alpha=1, sigma=0.3)
    taken_up, kills, found = [], 0, None
    while found is None:
        checkpoint = Deadly(tmp_path / "s.npz", taken_up.append)
        try:
            found = abfm.sequence(*given, checkpoint=checkpoint)
        except Killed:
            kills += 1
    assert_same(found, abfm.sequence(*given))
    assert taken_up[:2] == [1, 2]
    assert set(taken_up[2:]) == {3}  # of three intervals, in sweeps and when they are checked
    assert len(taken_up) == kills > 3 + 2 * 3
    assert [path.name for path in tmp_path.iterdir()] == [checkpoint.path.name]
    checkpoint.remove()
    assert not any(tmp_path.iterdir())


def test_one_that_is_cancelled_goes_on_where_it_was(whole, tmp_path):
    control, again, tasks = Control(), [], set()
    stop = {"control": control, "on_interval": lambda i: control.cancel() if i == 1 else None}
    part = solved(SequenceCheckpoint(tmp_path / "s.npz"), **stop)
    assert [np.abs(field).max() > 0 for field in part.velocity] == [True, True, False, False]
    with reporting_steps(lambda now: tasks.add(now and now.task)):
        found = solved(SequenceCheckpoint(tmp_path / "s.npz"), on_interval=again.append)
    assert_same(found, whole)
    assert again == [2, 3]
    assert "following the frames" in tasks
    assert "choosing sigma" not in tasks


def test_what_is_checked_by_flow_lines_is_not_checked_again(whole, tmp_path):
    first = SequenceCheckpoint(tmp_path / "s.npz")
    solved(first)
    arrays = dict(np.load(first.path))
    arrays["witnessed"][2] = 0.5, 0.25
    with first.path.open("wb") as file:
        np.savez(file, **arrays)
    found = solved(SequenceCheckpoint(tmp_path / "s.npz"))
    assert (found.verified_residual[2], found.folded[2]) == (0.5, 0.25)
    others = [0, 1, 3]
    assert_array_equal(found.verified_residual[others], whole.verified_residual[others])


def test_another_problem_or_a_damaged_file_begins_anew(whole, tmp_path):
    first, other = (SequenceCheckpoint(tmp_path / "s.npz", pytest.fail) for _ in range(2))
    solved(first)
    solved(other, gamma=0.0)
    assert first.path.name.startswith("s.npz-")
    assert first.path != other.path
    content = first.path.read_bytes()
    for damaged in (content[:-100], b"", other.path.read_bytes()):
        first.path.write_bytes(damaged)
        assert_same(solved(SequenceCheckpoint(tmp_path / "s.npz", pytest.fail)), whole)
    assert first.path.read_bytes() == content


def test_what_an_earlier_run_found_is_told_without_going_on(whole, tmp_path):
    told = {}
    none = solved(SequenceCheckpoint(tmp_path / "s.npz", pytest.fail, solve_remaining=False))
    assert not none.solved.any()
    assert not any(tmp_path.iterdir())
    control = Control()
    stop = {"control": control, "on_interval": lambda i: control.cancel() if i == 1 else None}
    part = solved(SequenceCheckpoint(tmp_path / "s.npz"), **stop)
    [path] = checkpoints_of(tmp_path / "s.npz")
    kept = path.read_bytes()
    again = solved(
        SequenceCheckpoint(tmp_path / "s.npz", solve_remaining=False), on_field=told.setdefault
    )
    assert_same(again, part)
    assert_array_equal(again.solved, [True, True, False, False])
    assert np.isfinite(again.verified_residual[:2]).all()
    assert path.read_bytes() == kept  # nothing is told there of fields that are not final
    assert list(told) == [0, 1]
    assert_array_equal(np.stack([*told.values()]), part.velocity[:2])
    assert_same(solved(SequenceCheckpoint(tmp_path / "s.npz")), whole)


def test_other_code_begins_anew(tmp_path, monkeypatch):
    first, other = (
        SequenceCheckpoint(tmp_path / "s.npz"),
        SequenceCheckpoint(tmp_path / "s.npz", pytest.fail),
    )
    solved(first)
    assert checkpoint_file._code() == checkpoint_file._code()
    monkeypatch.setattr(checkpoint_file, "_code", lambda: "another")
    solved(other)
    assert first.path != other.path


def test_what_is_beside_one_result_is_moved_beside_another(tmp_path):
    for name in ("a-1.npz-1a2b3c4d.unfinished", "a-1.npz-2.unfinished", "a-1-1.npz-3.unfinished"):
        (tmp_path / name).touch()
    move_checkpoints(tmp_path / "a-1.npz", tmp_path / "b.npz")
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"b.npz-1a2b3c4d.unfinished", "b.npz-2.unfinished", "a-1-1.npz-3.unfinished"}


def test_what_is_left_beside_a_result_is_removed_and_nothing_else(tmp_path):
    for name in ("s[1].npz-1a2b3c4d.unfinished", "s1.npz-1a2b3c4d.unfinished", "s[1].npz"):
        (tmp_path / name).touch()
    remove_checkpoints(tmp_path / "s[1].npz")
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"s1.npz-1a2b3c4d.unfinished", "s[1].npz"}


def test_where_it_cannot_be_written_the_film_is_solved_all_the_same(whole, tmp_path):
    checkpoint = SequenceCheckpoint(tmp_path / "no folder" / "s.npz")
    assert_same(solved(checkpoint), whole)
    checkpoint.remove()
