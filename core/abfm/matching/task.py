"""The task of a match on one surface."""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from abfm.errors import AbfmWarning, ParameterError, ResultError, one_line
from abfm.io import export_energy_csv, export_ply, export_vtu, results, write_csv
from abfm.matching import report
from abfm.matching.bounded import limit_distortion
from abfm.matching.judging.facts import distortion_warnings, headline_of, known_numbers
from abfm.matching.judging.obstacles import expected_facts
from abfm.matching.judging.verdict import Verdict
from abfm.matching.match import match
from abfm.matching.path import NUMBERS, path_table
from abfm.matching.problem import Problem, load_problem
from abfm.matching.result import Match, load_match
from abfm.outcome import Facts, worse_residual
from abfm.parameters import Parameters
from abfm.tasks.inputs import (
    CHANNELS_HELP,
    FUNCTIONS_HELP,
    MESH_FORMATS,
    MESH_INPUTS,
    PARAMETERS,
    SPEC_HELP,
    channel_inputs,
    channels,
    file_input,
    mask_input,
    number_input,
    parameter_inputs,
    parameters_in,
)
from abfm.tasks.meshes import mesh_notes, mesh_of
from abfm.tasks.monitor import Monitor
from abfm.tasks.task import Export, Preview, Report, ResultFile, Table, Task, TaskInputs, preview_of
from abfm.types import FloatArray, IntArray

_RESIDUALS = ("residual", "verified_residual", "folded")
_DISTORTIONS = ("log2_area", "log2_area_95")
_ENTRIES_OF_FACTS = (
    *(*_RESIDUALS, "verdict", "registration_verdict"),
    *("warnings", "path_steps", "path_step"),
)

MAX_DISTORTION = number_input(
    "max-distortion",
    "limit |log2 J| and |log2 R|, the changes of areas and shapes, to N on 99% of the faces, "
    "without folds (default: no limit)",
    "N",
    "above 0 and at most 1000",
    lambda bound: 1e-9 <= bound <= 1000,
    group=PARAMETERS,
)


def facts_of_file(path: Path) -> Facts:
    """Return the facts of the match or registration in a file; ResultError if it is invalid."""
    entries = results.REGISTRATION.entries
    with results.open_archive(path, results.RESULT.name, results.REMEDY) as archive:
        found = results.check_arrays(archive, {name: entries[name] for name in _ENTRIES_OF_FACTS})
        # the verdict of a registration may be worse than that of its match
        verdict = Verdict.of_texts(found.get("registration_verdict", found["verdict"]).tolist())
        numbers = {name: float(found.get(name, math.nan)) for name in _RESIDUALS}
        if "path_steps" in found and "path_step" in found:
            step = found["path_steps"][int(found["path_step"])]
            numbers |= {name: float(step[NUMBERS.index(name)]) for name in _DISTORTIONS}
        stored = found["warnings"].tolist() if "warnings" in found else []
    worse = worse_residual(numbers["residual"], numbers["verified_residual"])
    warnings = distortion_warnings(verdict.kind, numbers.get("log2_area_95", math.nan))
    return Facts(
        verdict.kind,
        headline_of(verdict.kind, worse),
        verdict.reason,
        verdict.advice,
        known_numbers(numbers),
        (*warnings.values(), *stored),
        topics=(verdict.topic, *warnings),
    )


def preview(path: Path) -> Preview:
    """Return a preview of the first channel of a result; a registration shows the match on B."""
    names = ("source", "advected", "target")
    return preview_of(path, results.RESULT, lambda arrays: [arrays[name][:, 0] for name in names])


def _export_arrays(export: Callable[..., None], path: Path, found: Match) -> None:
    functions = {"source": found.source, "target": found.target, "advected": found.advected}
    on_points = {name: f if f.shape[1] > 1 else f[:, 0] for name, f in functions.items()}
    is_one = len(found.velocity) == 1
    names = ["velocity" if is_one else f"velocity_segment_{i}" for i in range(len(found.velocity))]
    export(path, found.mesh, on_points, dict(zip(names, found.velocity, strict=True)))


def _export_path(path: Path, found: Match) -> None:
    write_csv(path, [line.split(",") for line in path_table(found.path, found.mesh)])


def _advice(found: Match, result: str) -> str:
    return report.advice_in_options(found.verdict, found.facts, result)


_DESCRIPTION = f"""\
Match two functions on a triangle mesh: find the tangent vector field whose flow transports the
source function to the target function.

Examples:
  abfm match spot.obj --source gaussian:vertex=12 --target gaussian:vertex=900 --out match.npz
  abfm match spot.obj --source eigenfunction:7 --target eigenfunction:8 --tau 2 --out match.vtu
  abfm match spot.obj --channel hks:time=0.01 values.npy 2 --out match.npz --out match.html

{SPEC_HELP}
The exit status is 0 if the functions match, 3 if the target was not reached, 2 for bad input.
"""
STATUS_HELP = """\
Exit status:
  0    source and target are matched or nearly matched, or measured functions are registered
  2    bad input; nothing is written
  3    the target was not reached, or no flow can reach it; the report suggests what to try
  130  Ctrl-C ended the run (143: SIGTERM, 129: closed terminal)
The best result is written in all cases except after bad input.
"""


@dataclass(frozen=True)
class MatchTask(Task):
    """The task of finding the field whose flow advects a source to a target.

    Attributes
    ----------
    problem : Problem
    max_distortion : float, optional
        Bound of the distortion, see `abfm.matching.limit_distortion`.
    """

    problem: Problem
    max_distortion: float | None = None

    kind: ClassVar = "match"
    summary: ClassVar = "match two functions on a mesh by the flow of a vector field"
    description: ClassVar = _DESCRIPTION
    details: ClassVar = f"{FUNCTIONS_HELP}\n{CHANNELS_HELP}\n{STATUS_HELP}"
    output_help: ClassVar = (
        "result (.npz), mesh with fields for other programs (.ply, .vtu), energies (.csv), or "
        "interactive page (.html)"
    )
    needs: ClassVar = ("mesh",)
    inputs: ClassVar = (
        file_input("mesh", MESH_FORMATS, "MESH", is_argument=True),
        *channel_inputs("source function, which the flow transports", "target function"),
        mask_input("mask", "weight of the mismatch at each vertex"),
        file_input(
            "start", "initial field, from an earlier result", "RESULT.npz", group=PARAMETERS
        ),
        *parameter_inputs(),
        MAX_DISTORTION,
        *MESH_INPUTS,
    )
    main_options: ClassVar = (
        *("source", "target", "channel", "mask"),
        *("start", "tau", "alpha", "sigma", "max-distortion", "set"),
    )
    result: ClassVar = Match
    file: ClassVar = ResultFile(frozenset({"velocity"}), load_match, facts_of_file, preview)
    report: ClassVar = Report(report.details, report.lines, _advice)
    exports: ClassVar = {
        ".ply": Export(partial(_export_arrays, export_ply)),
        ".vtu": Export(partial(_export_arrays, export_vtu)),
        ".csv": Export(lambda path, it: export_energy_csv(path, it.energy_history, it.stages)),
    }
    tables: ClassVar = {"path": Table("path of the continuation, one step per line", _export_path)}

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Raise ParameterError if functions are missing or parameters are inconsistent."""
        Parameters.of(**parameters_in(values))
        if not channels(values)[0]:
            raise ParameterError(
                "source and target are missing; give a function for each, such as "
                "gaussian:vertex=12"
            )

    @classmethod
    def read(cls, given: TaskInputs) -> MatchTask:
        values = given.values()
        mesh = mesh_of(values["mesh"], values)
        sources, targets, weights = channels(values)
        parameters = Parameters.of(**parameters_in(values))
        problem = Problem(
            mesh,
            sources if len(sources) > 1 else sources[0],
            targets if len(targets) > 1 else targets[0],
            parameters,
            mask=values.get("mask"),
            weights=weights,
            start=_start(values.get("start"), mesh.faces, parameters),
        )
        # results store the specs as they were written
        problem = problem.with_specs(*channels(given.written)[:2])
        return cls(problem, values.get("max-distortion"))

    @property
    def digest(self) -> str:
        """Hash that identifies the result by its problem and any bound of distortion."""
        if self.max_distortion is None:
            return self.problem.digest
        named = f"{self.problem.digest} max-distortion {self.max_distortion!r}"
        return hashlib.sha256(named.encode()).hexdigest()

    def solve(self, monitor: Monitor) -> Match:
        control = monitor.control
        found = match(self.problem, on_iteration=monitor.on_partial, control=control)
        if self.max_distortion is None:
            return found
        return limit_distortion(found, self.max_distortion, control=control)

    def expected(self) -> Facts | None:
        return expected_facts(self.problem)

    @property
    def goal(self) -> float:
        return self.problem.parameters.goal

    def notes(self) -> list[str]:
        return mesh_notes(self.problem.mesh)


class ProblemTask(MatchTask):
    """The task of matching a problem from a file of `abfm.Problem.save`."""

    kind: ClassVar = "problem"
    needs: ClassVar = ("problem",)
    inputs: ClassVar = (file_input("problem", "file of `abfm.Problem.save`"), MAX_DISTORTION)

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Accept all values, because the file contains a complete problem."""

    @classmethod
    def read(cls, given: TaskInputs) -> ProblemTask:
        values = given.values()
        return cls(load_problem(values["problem"]), values.get("max-distortion"))


def _start(path: str | None, faces: IntArray, parameters: Parameters) -> FloatArray | None:
    """Return the field of an earlier result as a start for ``parameters``; None without a path.

    Raise ResultError if the faces of its mesh differ.
    """
    if path is None:
        return None
    earlier = load_match(path)
    if earlier.load_warning:
        text = f"{one_line(path)}: stored values were recomputed, as {earlier.load_warning}"
        warnings.warn(text, AbfmWarning, stacklevel=2)
    if not np.array_equal(earlier.mesh.faces, faces):
        raise ResultError(
            f"start {one_line(path)} is a result on another mesh; use a result on a mesh with the "
            "same faces"
        )
    return earlier.start_for(parameters)
