"""What was found of a film that is not finished, in a file beside its result: whatever is killed
goes on.
"""

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

_WRITE_SECONDS_MIN = 5.0  # seconds, at least, from one writing to the next
_WRITE_TIME_RATIO = 20.0  # times as long as a writing takes, too, so that it costs 5% at most
_SUFFIX = ".unfinished"
_KIND = results.FileKind(
    "file of a film that is not finished",
    {
        "problem": Entry("text", ()),
        "order": Entry("integer", (), low=1),
        "alpha": Entry("real", (), low=0),
        "sigma": Entry("real", (), low=0),
        "fields": Entry("real", ("K", "F", 2)),
        "energies": Entry("real", ("K",)),
        "alone": Entry("boolean", ("K",)),
        "in_vain": Entry("integer", (), low=0),
        "swept": Entry("integer", (), low=0),
        "before": Entry("real", (), may_be_unknown=True),
        "witnessed": Entry("real", ("K", 2), low=0, may_be_unknown=True),
    },
)


class SequenceCheckpoint:
    """A file for what was found of a film, while it is solved and until its result is safe.

    It is named by the result, by all that makes the problem and by the code that solves it, so that
    only a run of the same goes on from it: that then finds the same, bit for bit, as one that was
    never killed.

    Parameters
    ----------
    result : path, optional
        Where the result will be; the file is ``RESULT-DIGEST.unfinished``. Without, there is none.
    on_found : callable
        Called with how many intervals an earlier run had found, if there are any.
    goes_on : bool
        Whether the film is solved to its end; else what there is is told as it is, like that of a
        run that was cancelled.
    """

    def __init__(
        self,
        result: str | os.PathLike[str] | None = None,
        on_found: Callable[[int], object] = lambda count: None,
        solve_remaining: bool = True,
    ) -> None:
        self._result, self._on_found, self.solve_remaining = result, on_found, solve_remaining
        self._problem, self._next = "", 0.0
        self.path: Path | None = None  # known, once a film is solved

    def restore(self, solver: SequenceSolver) -> None:
        """Have a solver go on from what there is of its problem: nothing, where that is damaged."""
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
                solver.is_uncoupled[known], solver.found[known] = found["alone"], True
                solver.flow_line_checks[known] = found["witnessed"]
                norm = Norm(int(found["order"]), float(found["alpha"]))
                solver.choose(norm, float(found["sigma"]))
                solver.before = float(found["before"])
                solver.failed_searches, solver.swept_intervals = (
                    int(found["in_vain"]),
                    int(found["swept"]),
                )
                self._on_found(len(fields))

    def keep(self, solver: SequenceSolver, at_once: bool = True) -> None:
        """Write what a solver has found; now and then only, unless at once. Where it cannot be
        written the film is solved all the same.
        """
        began = time.monotonic()
        if self.path is None or not solver.found[0] or (began < self._next and not at_once):
            return
        known = slice(int(np.count_nonzero(solver.found)))  # the first ones, one after the other
        arrays = {
            "problem": self._problem,
            "order": solver.given.order,
            "alpha": solver.given.alpha,
            "sigma": solver.sigma,
            "fields": solver.fields[known],
            "energies": solver.energies[known],
            "alone": solver.is_uncoupled[known],
            "in_vain": solver.failed_searches,
            "swept": solver.swept_intervals,
            "before": solver.before,
            "witnessed": solver.flow_line_checks[known],
        }
        with suppress(ResultError):
            results.save_arrays(self.path, arrays, _KIND)
        now = time.monotonic()
        self._next = now + max(_WRITE_SECONDS_MIN, _WRITE_TIME_RATIO * (now - began))

    def remove(self) -> None:
        """Remove the file, as the result is safe."""
        if self.path is not None:
            with suppress(OSError):
                self.path.unlink()


def checkpoints_of(result: Path) -> list[Path]:
    """Return the files of films that are not finished beside where their result will be."""
    return sorted(result.parent.glob(f"{glob.escape(result.name)}-*{_SUFFIX}"))


def remove_checkpoints(result: Path) -> None:
    """Remove what is left beside a result that is there, by a run that was killed just then."""
    for path in checkpoints_of(result):
        with suppress(OSError):
            path.unlink()


def move_checkpoints(result: Path, other: Path) -> None:
    """Have what is beside one result beside another one, where the next run is to go on."""
    for path in checkpoints_of(result):
        with suppress(OSError):
            path.replace(other.with_name(other.name + path.name.removeprefix(result.name)))


def _digest(solver: SequenceSolver) -> str:
    """Name what a solver is to find, by its content, in hexadecimal digits."""
    film = solver.frames
    told = {
        "code": _code(),
        "parameters": solver.given.to_dict(),
        "gamma": solver.gamma,
        "channels_given": film.channels_given,
    }
    arrays = results.mesh_arrays(film.mesh) | {
        "frames": film.values,
        "times": film.times,
        "weights": film.weights,
    }
    if film.mask is not None:
        arrays["mask"] = film.mask
    digest = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    for piece in results.pieces({name: np.asarray(each) for name, each in arrays.items()}):
        digest.update(piece)
    return digest.hexdigest()


@cache
def _code() -> str:
    """Name the library's code by its content: a version has many in a developer's checkout."""
    digest = hashlib.sha256()
    folder = Path(__file__).parents[1]
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
