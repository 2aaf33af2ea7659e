"""Read matches from files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.errors import AbfmError, one_line
from abfm.io import results
from abfm.maps.distortion import Bound
from abfm.matching.judging.remedies import Remedy
from abfm.matching.judging.verdict import Verdict
from abfm.matching.path import path_of
from abfm.matching.problem import problem_of
from abfm.matching.result import Match
from abfm.matching.solving.record import StopReason
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import times_subdivided
from abfm.parameters import Parameters
from abfm.reading import from_json
from abfm.types import File


def match_of(
    mesh: TriangleMesh,
    arrays: Mapping[str, NDArray[Any]],
    parameters: Parameters,
) -> Match:
    """Return the match of `match_arrays`; ValueError if its fields do not fit."""
    remedies = _remedies(str(arrays.get("remedies", "[]")))
    verdict = Verdict.of_texts(arrays["verdict"].tolist(), remedies)
    given = {name: arrays[name] for name in arrays.keys() & results.PROBLEM_ENTRIES.keys()}
    parts: dict[str, Any] = {"verified_residual": math.nan, "folded": math.nan}
    parts |= {
        name: array if array.ndim else array.item()
        for name, array in arrays.items()
        # landmark errors follow from the rest
        if name not in (*results.PROBLEM_ENTRIES, "landmark_errors", "remedies")
    }
    velocity = parts.pop("velocity")
    if parameters.solver.segments not in (0, len(velocity)):
        raise ValueError(f"{len(velocity)} fields, but parameters say {parameters.solver.segments}")
    parts.setdefault("fine_velocity", velocity)
    if "bound" in parts:
        parts["bound"] = Bound.of(parts["bound"])
    times_subdivided(parts["fine_velocity"].shape[1], mesh)
    fastest = np.abs(parts["fine_velocity"]).max()
    if fastest > results.SIZE_MAX * mesh.length_scale:
        raise ValueError(
            f"velocity has the value {fastest:.3g}; expected up to {results.SIZE_MAX:g} length "
            "scales of the mesh"
        )
    if any(name.startswith("path_") for name in arrays):
        parts["path"], parts["step"] = path_of(arrays, parts["fine_velocity"], mesh)
    parts = {name: part for name, part in parts.items() if not name.startswith("path_")}
    reason = StopReason(parts["stop_reason"])
    problem = problem_of(mesh, given, parameters)
    return Match(problem=problem, **parts | {"stop_reason": reason, "verdict": verdict})


def load_match(path: File) -> Match:
    """Read a file of `Match.save`; ResultError if it is missing, damaged, or not a result.

    Values that disagree with the field are recomputed, with a warning in ``match.doubt``.
    """

    def made(arrays: results.Arrays) -> Match:
        return loaded_match(results.mesh_of(arrays), arrays)

    return results.loaded(path, results.RESULT, made).borne_out()


def loaded_match(mesh: TriangleMesh, arrays: results.Arrays) -> Match:
    """Return the match of a file's arrays; any error if they do not fit."""
    own = {name: array for name, array in arrays.items() if name not in results.MESH_ENTRIES}
    parameters = Parameters.of(**from_json(str(own["parameters"])))
    return match_of(mesh, own, parameters)


def _remedies(text: str) -> tuple[Remedy, ...]:
    """Return the remedies of `match_arrays`."""
    try:
        found = tuple(Remedy(**remedy) for remedy in from_json(text))
    except AbfmError:
        raise
    except (TypeError, ValueError) as error:
        names = ", ".join(field.name for field in fields(Remedy))
        raise ValueError(
            f"the remedies are {one_line(text, 60)!r}; expected a list in JSON of what has {names}"
        ) from error
    kinds = {"label": str, "words": str, "parameters": dict, "goes_on": bool}
    for remedy in found:
        for name, kind in kinds.items():
            if not isinstance(getattr(remedy, name), kind):
                raise ValueError(f"the {name} of a remedy is no {kind.__name__}")
    return found
