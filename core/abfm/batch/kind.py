"""What a kind of row is, and what several kinds share."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from os import stat
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from abfm.batch.columns import Column, mesh_options, parameters_in
from abfm.errors import ParameterError
from abfm.functions.circular import checked_period, split_channels
from abfm.io import results
from abfm.matching.judging.facts import distortion_warnings, headline_of, known_numbers
from abfm.matching.judging.verdict import Verdict
from abfm.matching.path import NUMBERS
from abfm.matching.solving.record import Iteration
from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.options import MeshOptions
from abfm.outcome import Facts, worse_residual
from abfm.parameters import Parameters
from abfm.workers.control import Control

if TYPE_CHECKING:
    from abfm.batch.rows import Row, Saved

_MESHES_KEPT = 3  # by a process, with what was computed from them
_RESIDUALS = {"residual", "verified_residual", "folded"}


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
    """A row whose files are read."""

    digest: str
    """Name of the result."""
    solve: Callable[[Control | None, Cost, Path | None], Saved]
    """Find the result. Long work may keep a checkpoint next to the path that the result will have.
    """
    foreseen: Callable[[], Facts | None] = lambda: None
    """Return what the functions alone say of the result; None if nothing prevents a match."""


def facts_of_match(path: Path) -> Facts:
    """Return the facts that the file of a match or a registration holds.

    Raises
    ------
    ResultError
        If the file is missing or damaged, or holds values that no match has.
    """
    entries = results.RESULT.entries
    with results.open_archive(path, results.RESULT.name, results.MEND) as archive:
        numbers = dict.fromkeys(_RESIDUALS, math.nan)
        for name in _RESIDUALS & archive.keys():
            numbers[name] = float(entries[name].check(name, archive[name], {}))
        # of a registration, which may be worse than that of its match
        name = "registration_verdict" if "registration_verdict" in archive else "verdict"
        texts = entries["verdict"].check(name, archive[name], {})
        warnings = list[str]()
        if "warnings" in archive:
            entry = results.REGISTRATION.entries["warnings"]
            warnings = entry.check("warnings", archive["warnings"], {}).tolist()
        verdict = Verdict.of_texts(texts.tolist())
        numbers |= _distortion(archive)
    worse = worse_residual(numbers["residual"], numbers["verified_residual"])
    return Facts(
        verdict.kind,
        headline_of(verdict.kind, worse),
        verdict.reason,
        verdict.advice,
        known_numbers(numbers),
        (
            *distortion_warnings(verdict.kind, numbers.get("log2_area_95", math.nan)),
            *warnings,
        ),
    )


def _distortion(archive: Mapping[str, Any]) -> dict[str, float]:
    """Return how much the step of the path that the match is changes areas; empty if unknown."""
    if "path_steps" not in archive or "path_step" not in archive:
        return {}
    entries = results.RESULT.entries
    steps = entries["path_steps"].check("path_steps", archive["path_steps"], {})
    step = int(entries["path_step"].check("path_step", archive["path_step"], {}))
    return {name: float(steps[step][NUMBERS.index(name)]) for name in ("log2_area", "log2_area_95")}


class Kind(NamedTuple):
    """A kind of row."""

    needs: tuple[str, ...]
    """Columns that such rows fill; the first ones tell which kind a row is of."""
    columns: Mapping[str, Column]
    prepare: Callable[[Row], Prepared]
    load: Callable[[Path], Any]
    facts: Callable[[Path], Facts] = facts_of_match
    check: Callable[[Mapping[str, Any]], object] = lambda values: Parameters.of(
        **parameters_in(values)
    )
    """Refuses, by an AbfmError, values that do not fit together."""


def channels(given: Mapping[str, Any]) -> tuple[list[str], list[str], list[float]]:
    """Return sources, targets and weights, (C,) each; a ParameterError says that one is missing."""
    if ("source" in given) != ("target" in given):
        raise ParameterError("source and target need each other")
    first = [(given["source"], given["target"], 1.0)] if "source" in given else []
    found = [*first, *given.get("channel", ())]
    sources, targets, weights = ([each[part] for each in found] for part in range(3))
    period = checked_period(given.get("circular", False))
    return split_channels(sources, targets, weights, period)


def mesh_of_row(path: str, given: Mapping[str, Any]) -> TriangleMesh:
    """Read a mesh, unless this process has it of the row before."""
    try:
        status = stat(path)
        changed = status.st_size, status.st_mtime_ns
    except (OSError, ValueError):
        changed = 0, 0  # it cannot be loaded, which tells why
    return _loaded(path, changed, mesh_options(given))


@lru_cache(maxsize=_MESHES_KEPT)
def _loaded(path: str, changed: tuple[int, int], options: MeshOptions) -> TriangleMesh:
    return load_mesh(path, **options.given)
