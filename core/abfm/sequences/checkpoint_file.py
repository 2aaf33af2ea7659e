"""Checkpoint files of sequences, from which an interrupted run resumes."""

from __future__ import annotations

import glob
import hashlib
import json
import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

from abfm.errors import ResultError
from abfm.io import results
from abfm.io.results import Entry
from abfm.sequences.solving.choosing import Norm
from abfm.sequences.solving.solve import SequenceSolver

_WRITE_SECONDS_MIN = 5.0  # smallest time between two writes
_WRITE_TIME_RATIO = 20.0  # time between two writes, in units of one write: they take at most 5%
_SUFFIX = ".unfinished"
_KIND = results.FileKind(
    "checkpoint of a sequence",
    {
        "problem": Entry("text", ()),
        "order": Entry("integer", (), low=1),
        "alpha": Entry("real", (), low=0),
        "sigma": Entry("real", (), low=0),
        "fields": Entry("real", ("K", "F", 2)),
        "energies": Entry("real", ("K",)),
        "is_uncoupled": Entry("boolean", ("K",)),
        "failed_searches": Entry("integer", (), low=0),
        "swept_intervals": Entry("integer", (), low=0),
        "energy_before_sweep": Entry("real", (), allow_missing=True),
        "flow_line_checks": Entry("real", ("K", 2), low=0, allow_missing=True),
    },
)


class SequenceCheckpoint:
    """A file with the intermediate results of a sequence until its result is saved.

    Its name contains the name of the result, and a digest of the problem and of the code. Only a
    run of the same problem by the same code resumes from it. The result of the resumed run is the
    same, bit for bit, as that of an uninterrupted run.

    Parameters
    ----------
    result : path, optional
        Path of the result; the checkpoint is ``RESULT-DIGEST.unfinished``. Without a path, there is
        no checkpoint.
    on_found : callable
        Function that is called with the count of intervals that an earlier run solved, if any.
    solve_remaining : bool
        Whether to solve the remaining intervals. If false, the result is that of a cancelled run.
    """

    def __init__(
        self,
        result: str | os.PathLike[str] | None = None,
        on_found: Callable[[int], object] = lambda count: None,
        solve_remaining: bool = True,
    ) -> None:
        self._result, self._on_found, self.solve_remaining = result, on_found, solve_remaining
        self._problem, self._next_write = "", 0.0
        self.path: Path | None = None  # path, set by `restore`

    def restore(self, solver: SequenceSolver) -> None:
        """Restore a solver from the checkpoint of its problem, if there is an undamaged one."""
        if self._result is None:
            return
        self._problem = _digest(solver)
        self.path = Path(f"{os.fspath(self._result)}-{self._problem[:8]}{_SUFFIX}")
        with suppress(ResultError):
            found = results.load_arrays(self.path, _KIND)
            fields = found["fields"]
            fits = fields.shape[1:] == solver.fields.shape[1:] and len(fields) <= len(solver.fields)
            if found["problem"] == self._problem and fits:
                known = slice(len(fields))
                solver.fields[known], solver.energies[known] = fields, found["energies"]
                solver.is_uncoupled[known], solver.found[known] = found["is_uncoupled"], True
                solver.flow_line_checks[known] = found["flow_line_checks"]
                norm = Norm(int(found["order"]), float(found["alpha"]))
                solver.choose(norm, float(found["sigma"]))
                solver.energy_before = float(found["energy_before_sweep"])
                solver.failed_searches = int(found["failed_searches"])
                solver.swept_intervals = int(found["swept_intervals"])
                self._on_found(len(fields))

    def save(self, solver: SequenceSolver, force: bool = True) -> None:
        """Write the state of a solver; without ``force``, at most once every few seconds.

        A failed write is ignored.
        """
        began = time.monotonic()
        if self.path is None or not solver.found[0] or (began < self._next_write and not force):
            return
        known = slice(int(np.count_nonzero(solver.found)))  # intervals are solved in order
        arrays = {
            "problem": self._problem,
            "order": solver.given.order,
            "alpha": solver.given.alpha,
            "sigma": solver.sigma,
            "fields": solver.fields[known],
            "energies": solver.energies[known],
            "is_uncoupled": solver.is_uncoupled[known],
            "failed_searches": solver.failed_searches,
            "swept_intervals": solver.swept_intervals,
            "energy_before_sweep": solver.energy_before,
            "flow_line_checks": solver.flow_line_checks[known],
        }
        with suppress(ResultError):
            results.save_arrays(self.path, arrays, _KIND)
        now = time.monotonic()
        self._next_write = now + max(_WRITE_SECONDS_MIN, _WRITE_TIME_RATIO * (now - began))

    def remove(self) -> None:
        """Remove the checkpoint after the result is saved."""
        if self.path is not None:
            with suppress(OSError):
                self.path.unlink()


def checkpoints_of(result: Path) -> list[Path]:
    """Return the checkpoints next to the path of a result."""
    return sorted(result.parent.glob(f"{glob.escape(result.name)}-*{_SUFFIX}"))


def remove_checkpoints(result: Path) -> None:
    """Remove the checkpoints of earlier, killed runs next to a saved result."""
    for path in checkpoints_of(result):
        with suppress(OSError):
            path.unlink()


def move_checkpoints(result: Path, other: Path) -> None:
    """Rename the checkpoints of one result for another, whose next run then finds them."""
    for path in checkpoints_of(result):
        with suppress(OSError):
            path.replace(other.with_name(other.name + path.name.removeprefix(result.name)))


def _digest(solver: SequenceSolver) -> str:
    frames = solver.frames
    values = {
        "code": _code(),
        "parameters": solver.given.to_dict(),
        "gamma": solver.gamma,
        "channels_given": frames.channels_given,
    }
    arrays = results.mesh_arrays(frames.mesh) | {
        "frames": frames.values,
        "times": frames.times,
        "weights": frames.weights,
    }
    if frames.mask is not None:
        arrays["mask"] = frames.mask
    digest = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
    for piece in results.pieces({name: np.asarray(each) for name, each in arrays.items()}):
        digest.update(piece)
    return digest.hexdigest()


@cache
def _code() -> str:
    """Return a digest of the library's code, which can change without its version (development)."""
    digest = hashlib.sha256()
    folder = Path(__file__).parents[1]
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
