"""The kinds of rows that a table may have: here is where one is declared."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from os import stat
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from abfm.batch import columns
from abfm.batch.columns import Column, parameter_columns, parameters_in
from abfm.errors import ParameterError, ResultError, one_line
from abfm.functions import function
from abfm.io import results
from abfm.matching import bounded, load_match
from abfm.matching.match import match
from abfm.matching.problem import Problem, load_problem
from abfm.mesh import TriangleMesh, load_mesh
from abfm.parameters import Parameters
from abfm.registration import load_registration, prepare, within
from abfm.registration.initial import read_landmarks
from abfm.workers.control import Control

if TYPE_CHECKING:
    from abfm.batch.rows import Row, Saved

_MESHES_KEPT = 3  # by a process, with what was computed from them


class Prepared(NamedTuple):
    """What a row is when all is read: the name of its result, and what finds it."""

    digest: str
    solve: Callable[[Control | None], Saved]


@dataclass(frozen=True)
class Facts:
    """What a result came to, as its file says it; shares 0 to 1, NaN where unknown."""

    verdict: str
    reason: str
    mismatch: float
    verified_mismatch: float
    folded: float

    @property
    def confirmed(self) -> float:
        """What the worse witness leaves."""
        return max(self.mismatch, self.verified_mismatch, key=lambda x: -1 if x != x else x)


def facts_of_match(path: Path) -> Facts:
    """Return what the file of a match or of a registration says, or raise a ResultError."""
    names = ("mismatch", "verified_mismatch", "folded")
    with results.open_archive(path, results.RESULT.name, results.MEND) as archive:
        numbers = (float(archive[name]) if name in archive else math.nan for name in names)
        verdict, reason, _ = archive["verdict"].tolist()
        return Facts(verdict, reason, *numbers)


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


def kind_of_columns(given: Collection[str]) -> str:
    """Return the kind of row that fills such columns, or raise a ParameterError."""
    for name, kind in KINDS.items():
        if kind.needs[0] in given:
            return name
    ways = ", or ".join(f"{' and '.join(kind.needs)} ({name})" for name, kind in KINDS.items())
    raise ParameterError(f"it is of no kind: fill {ways}")


def _prepare_match(row: Row) -> Prepared:
    given, told = row.values(), row.written
    mesh = _mesh(given["mesh"], given)
    sources, targets, weights = _channels(given)
    start = load_match(given["start"]) if "start" in given else None
    parameters = Parameters(**parameters_in(given))
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
        mask=_weight(mesh, given.get("mask")),
        weights=weights,
        start=None if start is None else start.start_for(parameters),
    )
    return _matched(problem.with_specs(*_channels(told)[:2]), given.get("max-distortion"))


def _prepare_problem(row: Row) -> Prepared:
    given = row.values()
    return _matched(load_problem(given["problem"]), given.get("max-distortion"))


def _matched(problem: Problem, most: float | None) -> Prepared:
    def solve(control: Control | None) -> Saved:
        found = match(problem, control=control)
        return found if most is None else bounded(found, most, control=control)

    if most is None:
        return Prepared(problem.digest, solve)
    named = f"{problem.digest} max-distortion {most!r}"
    return Prepared(hashlib.sha256(named.encode()).hexdigest(), solve)


def _prepare_registration(row: Row) -> Prepared:
    given = row.values()

    def solve(control: Control | None) -> Saved:
        a, b = (_mesh(given[side], given) for side in "ab")
        sources, targets, weights = _channels(given)
        prepared = prepare(
            a,
            b,
            sources or None,
            targets or None,
            initial=given.get("initial"),
            landmarks=read_landmarks(a, b, given["landmarks"]) if "landmarks" in given else None,
            mask_a=_weight(a, given.get("mask-a")),
            mask_b=_weight(b, given.get("mask-b")),
            weights=weights or None,
        )
        usual = prepared.problem.parameters.to_dict()
        parameters = Parameters(**usual | parameters_in(given))
        found = match(prepared.problem.with_parameters(parameters), control=control)
        registration = prepared.matched_by(found)
        most = given.get("max-distortion")
        return registration if most is None else within(registration, most, control)

    return Prepared(row.key, solve)


def _check_registration(given: Mapping[str, Any]) -> None:
    Parameters(**parameters_in(given))
    if not _channels(given)[0] and "landmarks" not in given:
        raise ParameterError("a registration needs source and target, or landmarks")


def _check_match(given: Mapping[str, Any]) -> None:
    Parameters(**parameters_in(given))
    if not _channels(given)[0]:
        raise ParameterError("a match needs source and target")


def _channels(given: Mapping[str, Any]) -> tuple[list[str], list[str], list[float]]:
    """Return sources, targets and weights, (C,) each."""
    if ("source" in given) != ("target" in given):
        raise ParameterError("source and target need each other")
    first = [(given["source"], given["target"], 1.0)] if "source" in given else []
    found = [*first, *given.get("channel", ())]
    return [each[0] for each in found], [each[1] for each in found], [each[2] for each in found]


def _weight(mesh: TriangleMesh, spec: str | None) -> Any:
    return None if spec is None else function(mesh, spec)


def _mesh(path: str, given: Mapping[str, Any]) -> TriangleMesh:
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


_ANY = {
    "source": columns.SPEC,
    "target": columns.SPEC,
    "channel": columns.CHANNEL,
    "largest-component": columns.FLAG,
    "max-distortion": columns.BOUND,
}
KINDS: Mapping[str, Kind] = {
    "match": Kind(
        ("mesh",),
        {"mesh": columns.FILE, **_ANY, "mask": columns.WEIGHT, "start": columns.FILE}
        | parameter_columns(),
        _prepare_match,
        load_match,
        check=_check_match,
    ),
    "registration": Kind(
        ("a", "b"),
        {"a": columns.FILE, "b": columns.FILE, **_ANY}
        | {"mask-a": columns.WEIGHT, "mask-b": columns.WEIGHT}
        | {"landmarks": columns.FILE, "initial": columns.INITIAL}
        | parameter_columns(),
        _prepare_registration,
        load_registration,
        check=_check_registration,
    ),
    "problem": Kind(
        ("problem",),
        {"problem": columns.FILE, "max-distortion": columns.BOUND},
        _prepare_problem,
        load_match,
        check=lambda values: None,
    ),
}
"""All kinds of rows, by name."""
