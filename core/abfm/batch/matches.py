"""Rows that are matches on one surface."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abfm.batch.columns import parameters_in
from abfm.batch.kind import Cost, Prepared, channels, mesh_of_row
from abfm.errors import ParameterError, ResultError, one_line
from abfm.matching import bounded, foreseen, load_match
from abfm.matching.match import match
from abfm.matching.problem import Problem, load_problem
from abfm.parameters import Parameters
from abfm.workers.control import Control

if TYPE_CHECKING:
    from abfm.batch.rows import Row, Saved


def prepare_match(row: Row) -> Prepared:
    """Read a mesh and functions; the digest is that of the `abfm.Problem` they make."""
    given, told = row.values(), row.written
    mesh = mesh_of_row(given["mesh"], given)
    sources, targets, weights = channels(given)
    start = load_match(given["start"]) if "start" in given else None
    parameters = Parameters.of(**parameters_in(given))
    if start is not None and not np.array_equal(start.mesh.faces, mesh.faces):
        raise ResultError(
            f"start {one_line(given['start'])} is a result on another mesh; give one on a mesh "
            "with the same faces"
        )
    problem = Problem(
        mesh,
        sources if len(sources) > 1 else sources[0],
        targets if len(targets) > 1 else targets[0],
        parameters,
        mask=given.get("mask"),
        weights=weights,
        start=None if start is None else start.start_for(parameters),
    )
    return _matched(problem.with_specs(*channels(told)[:2]), given.get("max-distortion"))


def prepare_problem(row: Row) -> Prepared:
    """Read what `abfm.Problem.save` wrote."""
    given = row.values()
    return _matched(load_problem(given["problem"]), given.get("max-distortion"))


def check_match(given: Mapping[str, Any]) -> None:
    """Refuse a match without functions, and parameters that do not fit each other."""
    Parameters.of(**parameters_in(given))
    if not channels(given)[0]:
        raise ParameterError("a match needs source and target")


def _matched(problem: Problem, most: float | None) -> Prepared:
    def solve(control: Control | None, cost: Cost, path: Path | None) -> Saved:
        watch = cost.watch(problem.parameters.goal)
        found = match(problem, on_iteration=watch, control=control)
        return found if most is None else bounded(found, most, control=control)

    expected = partial(foreseen, problem)
    if most is None:
        return Prepared(problem.digest, solve, expected)
    named = f"{problem.digest} max-distortion {most!r}"
    return Prepared(hashlib.sha256(named.encode()).hexdigest(), solve, expected)
