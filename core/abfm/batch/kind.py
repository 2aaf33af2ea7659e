"""What a kind of row is, and what several kinds share."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from os import stat
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from abfm.batch.columns import Column, parameters_in
from abfm.errors import ParameterError
from abfm.functions import function
from abfm.io import results
from abfm.matching.path import PathStep
from abfm.matching.solving.record import Iteration
from abfm.mesh import TriangleMesh, load_mesh
from abfm.outcome import worse_residual
from abfm.parameters import Parameters
from abfm.types import FloatArray
from abfm.workers.control import Control

if TYPE_CHECKING:
    from abfm.batch.rows import Row, Saved

_MESHES_KEPT = 3  # by a process, with what was computed from them


@dataclass
class Cost:
    """What it takes to solve a row that is a match, told while it is solved; None is unknown."""

    evaluations: int | None = None  # of energy and gradient, up to the last iterate
    seconds_to_goal: float | None = None  # until the residual on the mesh itself was the goal

    def watch(self, goal: float) -> Callable[[Iteration], None]:
        """Return what is to be called after every iteration of a match."""
        began = time.monotonic()

        def heard(now: Iteration) -> None:
            self.evaluations = now.evaluations
            there = now.level == now.levels - 1 and now.residual <= goal
            if there and self.seconds_to_goal is None:
                self.seconds_to_goal = time.monotonic() - began

        return heard


class Prepared(NamedTuple):
    """What a row is when all is read: the name of its result, and what finds it, with the path that
    this will have, beside which what is long may keep what it found so far.
    """

    digest: str
    solve: Callable[[Control | None, Cost, Path | None], Saved]


@dataclass(frozen=True)
class Facts:
    """What a result came to, as its file says it; shares 0 to 1, NaN where unknown."""

    verdict: str
    reason: str
    residual: float
    verified_residual: float
    folded: float
    log2_area: float = math.nan  # mean |log2 J|

    @property
    def confirmed(self) -> float:
        """What the worse witness leaves."""
        return worse_residual(self.residual, self.verified_residual)


def facts_of_match(path: Path) -> Facts:
    """Return what the file of a match or of a registration says, or raise a ResultError."""
    names = ("residual", "verified_residual", "folded")
    with results.open_archive(path, results.RESULT.name, results.MEND) as archive:
        residual, verified, folded = (
            float(archive[name]) if name in archive else math.nan for name in names
        )
        verdict, _, reason, _ = archive["verdict"].tolist()
        return Facts(verdict, reason, residual, verified, folded, _log2_area(archive))


def _log2_area(archive: Mapping[str, Any]) -> float:
    """Return what a match's path tells of its own step; NaN where it has none."""
    if "path_steps" not in archive or "path_step" not in archive:
        return math.nan
    place = [each.name for each in fields(PathStep) if each.name != "velocity"].index("log2_area")
    return float(archive["path_steps"][int(archive["path_step"])][place])


class Kind(NamedTuple):
    """A kind of row."""

    needs: tuple[str, ...]
    """Columns that such rows fill; the first ones tell which kind a row is of."""
    columns: Mapping[str, Column]
    prepare: Callable[[Row], Prepared]
    load: Callable[[Path], Any]
    facts: Callable[[Path], Facts] = facts_of_match
    check: Callable[[Mapping[str, Any]], object] = lambda values: Parameters(
        **parameters_in(values)
    )
    """Refuses, by an AbfmError, values that do not fit together."""


def channels(given: Mapping[str, Any]) -> tuple[list[str], list[str], list[float]]:
    """Return sources, targets and weights, (C,) each; a ParameterError says that one is missing."""
    if ("source" in given) != ("target" in given):
        raise ParameterError("source and target need each other")
    first = [(given["source"], given["target"], 1.0)] if "source" in given else []
    found = [*first, *given.get("channel", ())]
    return [each[0] for each in found], [each[1] for each in found], [each[2] for each in found]


def weight(mesh: TriangleMesh, spec: str | None) -> FloatArray | None:
    """Return how much vertices count, (V,), by a function."""
    return None if spec is None else function(mesh, spec)


def mesh_of_row(path: str, given: Mapping[str, Any]) -> TriangleMesh:
    """Read a mesh, unless this process has it of the row before."""
    largest = given.get("largest-component", False)
    try:
        status = stat(path)
        changed = status.st_size, status.st_mtime_ns
    except OSError:
        changed = 0, 0  # it cannot be loaded, which tells why
    return _loaded(path, changed, largest)


@lru_cache(maxsize=_MESHES_KEPT)
def _loaded(path: str, changed: tuple[int, int], largest: bool) -> TriangleMesh:
    return load_mesh(path, largest_component=largest)
