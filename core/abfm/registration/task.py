"""The task of registering one surface to another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from abfm.errors import AbfmError, ParameterError, ResultError, one_line
from abfm.io import check_surface_name, write_surface, write_values
from abfm.maps.point_maps import PointMap
from abfm.matching import RESIDUAL_REGISTERED, SHARE_REGISTERED
from abfm.matching import report as match_report
from abfm.matching.task import MAX_DISTORTION, STATUS_HELP, facts_of_file, preview
from abfm.mesh import TriangleMesh
from abfm.mesh.options import read_flag
from abfm.parameters import Parameters, as_option
from abfm.registration import report
from abfm.registration.initial import METHODS, method_of, read_landmarks
from abfm.registration.register import MEASURED_PARAMETERS, prepare
from abfm.registration.registration import Registration, load_registration
from abfm.tasks.inputs import (
    CHANNELS_HELP,
    FUNCTIONS_HELP,
    MESH_FORMATS,
    MESH_INPUTS,
    SPEC_HELP,
    Input,
    Rename,
    channel_inputs,
    channels,
    file_input,
    mask_input,
    parameter_inputs,
    parameters_in,
)
from abfm.tasks.meshes import mesh_notes, mesh_of
from abfm.tasks.monitor import Monitor
from abfm.tasks.task import Export, Report, ResultFile, Task, TaskInputs
from abfm.types import IntArray

_INITIAL_GROUP = "initial map and landmarks"


def _initial(text: str) -> str:
    method_of(text)
    return text


def _renamed_initial(text: str, rename: Rename) -> str:
    """Replace the file names in the text of an initial map, ``file:MAP`` or ``sphere:A,B``."""
    name, _, rest = text.partition(":")
    if name not in ("file", "sphere") or not rest:
        return text
    if name == "file":
        return f"file:{rename(rest)}"
    parts = [part.strip() for part in rest.split(",")]
    return f"sphere:{','.join(part if part == 'mirror' else rename(part) for part in parts)}"


INITIAL_INPUT = Input(
    name="initial",
    help="method for the initial map, such as auto, sphere, closest, spectral or landmarks; "
    "--help-all explains them (default: auto)",
    read=_initial,
    metavar="METHOD[:...]",
    group=_INITIAL_GROUP,
    renamed=_renamed_initial,
)
LANDMARKS = file_input(
    "landmarks",
    "corresponding points, one pair per line: a vertex of A and one of B (counted from 0), or "
    "x, y, z on both",
    "FILE.csv",
    group=_INITIAL_GROUP,
)
ONE_BASED_INPUT = Input(
    name="one-based",
    help="count the vertices of the landmarks from 1 instead of 0",
    read=read_flag,
    group=_INITIAL_GROUP,
)


def _export_numbers(path: Path, found: Registration) -> None:
    write_values(path, vertex_numbers(found.points))


def _export_surface(path: Path, found: Registration) -> None:
    missing = found.a.file_vertex_count - len(found.a.vertices)
    if missing:
        raise ResultError(
            f"cannot write {path}: {missing} of the vertices of A's file were removed or merged, "
            "so the moved surface would have other vertices than that file. Write a .npz file, or "
            "use a mesh file for A that needs no repair"
        )
    try:
        positions, structure = found.back.positions, found.a.structure
        moved = TriangleMesh(positions, found.a.faces, structure=structure)
    except AbfmError as error:
        raise ResultError(
            f"cannot write {path}: surface A moved to B is not a valid mesh: {one_line(error)}"
        ) from None
    write_surface(path, moved)


def vertex_numbers(points: PointMap) -> IntArray:
    """Return the nearest vertex of the codomain for each vertex of the domain's file.

    Vertices are numbered as in their files; the result is -1 for vertices without a face.
    """
    return points.domain.on_file(points.codomain.vertex_ids[points.nearest_vertices()], -1)


def _advice(found: Registration, result: str) -> str:
    # a registration cannot resume an earlier one
    return match_report.advice_in_options(found.verdict, found.facts)


_METHODS = "\n".join(f"  {method.form}\n      {method.about}" for method in METHODS)
_MEASURED_OPTIONS = ", ".join(
    as_option(name, value) for name, value in MEASURED_PARAMETERS.changed().items()
)
_DESCRIPTION = f"""\
Register surface A to surface B: find the point of A that corresponds to each vertex of B. An
initial map transfers the functions of A (--source) to B. The flow of a vector field on B then
brings them as close as possible to the functions of B (--target).

Examples:
  abfm register lh.sphere fsaverage.sphere.surf.gii --source lh.sulc --target avg.gii \\
      --mask-b cortex.csv --out sub-01_reg.npz
  abfm register pose1.off pose2.off --source hks:time=0.01 --target hks:time=0.01 --out reg.npz
  abfm register cat.off lion.off --landmarks pairs.csv --out reg.npz
  abfm apply sub-01_reg.npz --labels lh.aparc.annot --out aparc.label.gii

{SPEC_HELP}
The exit status is 0 if the functions match, and 2 for bad input. It is 3 if the target was not
reached, or if the initial map may be wrong.
"""
_DETAILS = f"""\
{FUNCTIONS_HELP}
{CHANNELS_HELP}
Initial maps (--initial):
{_METHODS}
The default is the best of the candidates that apply. They are compared by their distortion, by the
descriptors and functions that they preserve, and by landmarks. A note reports the best two.

Measured functions:
  Functions that were measured, or that have different units, are compared in standard deviations
  from their means. A function with the opposite sign is negated, with a note. Measured functions,
  and functions of two shapes with a searched initial map, are matched as closely as held-out
  patches allow. Their default parameters are:
    {_MEASURED_OPTIONS}
  All other functions are matched with the parameters of `abfm match`.

{STATUS_HELP}
The status is also 3 if the initial map may be wrong; a warning explains why. It is also 3 if the
complete map from A to B has a larger residual than the flow on B. Measured functions are registered
if their residual is below {RESIDUAL_REGISTERED:g} and below {SHARE_REGISTERED:g} of that of the
initial map.
"""


@dataclass(frozen=True)
class RegistrationTask(Task):
    """Task of registering surface A to surface B."""

    a: TriangleMesh
    b: TriangleMesh
    key: str  # name of the result; a digest of the problem on B would need the initial map
    # other arguments of `abfm.registration.prepare`
    options: Mapping[str, Any] = field(default_factory=dict)
    # parameters that the user set; the defaults of the others depend on the functions
    parameters: Mapping[str, Any] = field(default_factory=dict)
    max_distortion: float | None = None  # argument of `abfm.registration.limit_distortion`

    kind: ClassVar = "registration"
    summary: ClassVar = "register one surface to another by functions or landmarks on both"
    description: ClassVar = _DESCRIPTION
    details: ClassVar = _DETAILS
    output_help: ClassVar = (
        "registration (.npz); faces of A on B, such as sphere.reg (.gii, .ply); vertices of A "
        "for those of B (.txt, .csv, .npy); or page (.html)"
    )
    needs: ClassVar = ("a", "b")
    inputs: ClassVar = (
        file_input("a", f"surface A, a {MESH_FORMATS}", "A", is_argument=True),
        file_input("b", "surface B, which has the vector field", "B", is_argument=True),
        *channel_inputs("source function, on A", "target function, on B"),
        mask_input("mask-a", "weight of each vertex of A"),
        mask_input("mask-b", "weight of each vertex of B"),
        LANDMARKS,
        ONE_BASED_INPUT,
        INITIAL_INPUT,
        *parameter_inputs(),
        MAX_DISTORTION,
        *MESH_INPUTS,
    )
    main_options: ClassVar = (
        *("source", "target", "channel", "mask-a", "mask-b", "landmarks", "initial"),
        *("alpha", "sigma", "max-distortion", "set"),
    )
    result: ClassVar = Registration
    file: ClassVar = ResultFile(
        frozenset({"a_vertices", "velocity"}), load_registration, facts_of_file, preview
    )
    report: ClassVar = Report(report.details, report.lines, _advice)
    exports: ClassVar = {
        **dict.fromkeys((".gii", ".ply", ".reg"), Export(_export_surface, check_surface_name)),
        **dict.fromkeys((".txt", ".csv", ".npy"), Export(_export_numbers)),
    }

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Check the parameters; ParameterError if neither functions nor landmarks are given."""
        Parameters.of(**parameters_in(values))
        if not channels(values)[0] and "landmarks" not in values:
            raise ParameterError(
                "functions and landmarks are missing; expected source and target, or landmarks"
            )

    @classmethod
    def read(cls, given: TaskInputs) -> RegistrationTask:
        values = given.values()
        a, b = (mesh_of(values[side], values) for side in "ab")
        sources, targets, weights = channels(values)
        landmarks = None
        if "landmarks" in values:
            landmarks = read_landmarks(a, b, values["landmarks"], values.get("one-based", False))
        options = {
            "f": sources or None,
            "g": targets or None,
            "initial": values.get("initial"),
            "landmarks": landmarks,
            "mask_a": values.get("mask-a"),
            "mask_b": values.get("mask-b"),
            "weights": weights or None,
        }
        return cls(a, b, given.key, options, parameters_in(values), values.get("max-distortion"))

    def solve(self, monitor: Monitor) -> Registration:
        prepared = prepare(self.a, self.b, **self.options)
        if [each.name for each in prepared.initial.candidates] == ["connectivity"]:
            monitor.on_note("initial map: connectivity, as both meshes have the same faces")
        for note in (*prepared.notes, *(f"warning: {text}" for text in prepared.warnings)):
            monitor.on_note(note)
        parameters = prepared.problem.parameters.with_values(**self.parameters)
        prepared = prepared._replace(problem=prepared.problem.with_parameters(parameters))
        found = prepared.solve(self.max_distortion, monitor.on_partial, monitor.control)
        for note in found.notes[len(prepared.notes) :]:
            monitor.on_note(note)
        return found

    @property
    def goal(self) -> float:
        return Parameters.of(**self.parameters).goal

    def notes(self) -> list[str]:
        return mesh_notes(self.a, self.b)
