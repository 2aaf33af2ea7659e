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
from abfm.matching.task import MAX_DISTORTION, facts_of_file, preview
from abfm.mesh import TriangleMesh
from abfm.mesh.options import read_flag
from abfm.parameters import Parameters, as_option
from abfm.registration import report
from abfm.registration.initial import METHODS, method_of, read_landmarks
from abfm.registration.register import MEASURED_PARAMETERS, prepare
from abfm.registration.registration import Registration, load_registration
from abfm.tasks.inputs import (
    MESH_FORMATS,
    MESH_INPUTS,
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

_START = "weights and start"


def _initial(text: str) -> str:
    method_of(text)
    return text


def _renamed_initial(text: str, rename: Rename) -> str:
    """Rename in ``file:MAP`` and ``sphere:mirror,A,B``."""
    name, _, rest = text.partition(":")
    if name not in ("file", "sphere") or not rest:
        return text
    if name == "file":
        return f"file:{rename(rest)}"
    words = [word.strip() for word in rest.split(",")]
    return f"sphere:{','.join(word if word == 'mirror' else rename(word) for word in words)}"


INITIAL_INPUT = Input(
    name="initial",
    help="the initial map, see above",
    read=_initial,
    metavar="WORD[:...]",
    group=_START,
    renamed=_renamed_initial,
)
LANDMARKS = file_input(
    "landmarks",
    "pairs of vertices of A and of B, counted from 0, or of x, y, z on both, a pair a line; alone "
    "or with functions",
    "FILE.csv",
    group=_START,
)
ONE_BASED_INPUT = Input(
    name="one-based",
    help="vertex numbers of the landmarks count from 1, not from 0",
    read=read_flag,
    group=_START,
)


def _export_numbers(path: Path, found: Registration) -> None:
    """Write A's vertex for each vertex of B."""
    write_values(path, vertex_numbers(found.points))


def _export_surface(path: Path, found: Registration) -> None:
    """Write A's faces where they lie on B."""
    left_out = found.a.file_vertex_count - len(found.a.vertices)
    if left_out:
        raise ResultError(
            f"cannot write {path}: {left_out} vertices of A's file were left out or merged, so "
            "that rows would not be those of the file; write a .npz, or give A without them"
        )
    try:
        positions, structure = found.back.positions, found.a.structure
        placed = TriangleMesh(positions, found.a.faces, structure=structure)
    except AbfmError as error:
        raise ResultError(f"cannot write {path}: where A lies on B {one_line(error)}") from None
    write_surface(path, placed)


def vertex_numbers(points: PointMap) -> IntArray:
    """Return the nearest vertex for each vertex of the domain, both counted as the mesh files do;
    -1 for vertices that no face uses.
    """
    return points.domain.on_file(points.codomain.vertex_ids[points.nearest_vertices()], -1)


def _advice(found: Registration, result: str) -> str:
    # no registration starts from an earlier one
    return match_report.advice_in_options(found.verdict, found.facts)


_WORDS = "\n".join(f"  {word.form}\n      {word.about}" for word in METHODS)
_MEASURED_OPTIONS = ", ".join(
    as_option(name, value) for name, value in MEASURED_PARAMETERS.changed().items()
)
_DESCRIPTION = f"""\
Find where on surface A each point of surface B lies, so that the functions of A (--source), carried
to B, are as near to those of B (--target) as they can be: by an initial map, and then by the flow
of a vector field on B.

Examples:
  abfm register lh.sphere fsaverage.sphere.surf.gii --source file:lh.sulc --target file:avg.gii \\
      --mask-b cortex.csv --out sub-01_reg.npz
  abfm register pose1.off pose2.off --source hks:time=0.01 --target hks:time=0.01 --out reg.npz
  abfm register cat.off lion.off --landmarks pairs.csv --out reg.npz
  abfm apply sub-01_reg.npz --labels lh.aparc.annot --out aparc.label.gii

The initial map (--initial) is by default the best of the candidates that apply, which are compared
by how much they stretch the surfaces, by the descriptors and functions that they keep, and by
landmarks; a note reports the chosen one and the next one. Or it is one of
{_WORDS}
Functions that were measured, or have other units, are compared in standard deviations from their
means; one with the other sign is turned, with a note. These, and functions of two shapes whose map
was searched, are matched as far as left-out patches gain, with the parameters
{_MEASURED_OPTIONS} unless given; others with those of `abfm match`.

The exit status is as of `abfm match`. It is 3 also if the initial map may lead elsewhere (a warning
reports why) or if the complete map from A to B has a larger residual than the flow on B. Measured
functions are registered if the residual is below {SHARE_REGISTERED:g} of that of the initial map
alone, and below {RESIDUAL_REGISTERED:g}.
"""


@dataclass(frozen=True)
class RegistrationTask(Task):
    """Find where on surface A each point of surface B lies.

    Attributes
    ----------
    a, b : TriangleMesh
    key : str
        Name of the result: the problem that is matched on B is known only once there is an initial
        map.
    options : mapping of str
        Further inputs of `abfm.registration.prepare`.
    parameters : mapping of str
        Those that are given; the others depend on the functions.
    max_distortion : float, optional
        See `abfm.registration.limit_distortion`.
    """

    a: TriangleMesh
    b: TriangleMesh
    key: str
    options: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    max_distortion: float | None = None

    kind: ClassVar = "registration"
    summary: ClassVar = "register one surface to another by functions on both"
    description: ClassVar = _DESCRIPTION
    output_help: ClassVar = (
        "registration .npz; .gii or .ply with A's faces where they lie on B, such as a sphere.reg; "
        ".txt, .csv or .npy with A's vertex for each of B; .html for a browser: both surfaces, "
        "turning, with a time bar"
    )
    needs: ClassVar = ("a", "b")
    inputs: ClassVar = (
        file_input("a", f"surface A, a {MESH_FORMATS}", "A", is_argument=True),
        file_input("b", "surface B, on which the flow is", "B", is_argument=True),
        *channel_inputs("function on A to bring to B", "function on B that it should become"),
        mask_input("mask-a", "weight of each vertex of A"),
        mask_input("mask-b", "weight of each vertex of B"),
        LANDMARKS,
        ONE_BASED_INPUT,
        INITIAL_INPUT,
        *parameter_inputs(),
        MAX_DISTORTION,
        *MESH_INPUTS,
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
        """Refuse one without functions and landmarks, and parameters that do not fit each other."""
        Parameters.of(**parameters_in(values))
        if not channels(values)[0] and "landmarks" not in values:
            raise ParameterError("a registration needs source and target, or landmarks")

    @classmethod
    def read(cls, given: TaskInputs) -> RegistrationTask:
        values = given.values()
        a, b = (mesh_of(values[side], values) for side in "ab")
        sources, targets, weights = channels(values)
        landmarks = None
        if "landmarks" in values:
            is_one_based = values.get("one-based", False)
            landmarks = read_landmarks(a, b, values["landmarks"], is_one_based)
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
