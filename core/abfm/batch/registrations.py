"""Rows that are registrations of one surface to another."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abfm.batch.columns import parameters_in
from abfm.batch.kind import Cost, Prepared, channels, mesh_of_row
from abfm.errors import ParameterError
from abfm.matching.match import match
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.registration import prepare, within
from abfm.registration.initial import Landmarks, read_landmarks
from abfm.workers.control import Control

if TYPE_CHECKING:
    from abfm.batch.rows import Row, Saved


def prepare_registration(row: Row) -> Prepared:
    """Name it by what the row and its files say: the problem that is matched on B is known only
    once there is an initial map, which takes long.
    """
    given = row.values()

    def solve(control: Control | None, cost: Cost, path: Path | None) -> Saved:
        a, b = (mesh_of_row(given[side], given) for side in "ab")
        sources, targets, weights = channels(given)
        prepared = prepare(
            a,
            b,
            sources or None,
            targets or None,
            initial=given.get("initial"),
            landmarks=_landmarks(a, b, given),
            mask_a=given.get("mask-a"),
            mask_b=given.get("mask-b"),
            weights=weights or None,
        )
        parameters = prepared.problem.parameters.with_values(**parameters_in(given))
        watch, problem = cost.watch(parameters.goal), prepared.problem.with_parameters(parameters)
        found = match(problem, on_iteration=watch, control=control)
        registration = prepared.matched_by(found)
        most = given.get("max-distortion")
        return registration if most is None else within(registration, most, control)

    return Prepared(row.key, solve)


def _landmarks(a: TriangleMesh, b: TriangleMesh, given: Mapping[str, Any]) -> Landmarks | None:
    if "landmarks" not in given:
        return None
    return read_landmarks(a, b, given["landmarks"], given.get("one-based", False))


def check_registration(given: Mapping[str, Any]) -> None:
    """Refuse one without functions and landmarks, and parameters that do not fit each other."""
    Parameters.of(**parameters_in(given))
    if not channels(given)[0] and "landmarks" not in given:
        raise ParameterError("a registration needs source and target, or landmarks")
