"""Building blocks of the scripts of figures.

A script is a generator. It yields an example and then the matches that it requests. At the end it
returns its measurements and the picture to draw.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np
import trimesh

from abfm import Flow, Match, MatchingEnergy, Parameters, Problem, match
from abfm.assets import asset_path
from abfm.calculus import to_frame
from abfm.errors import MeshError, ParameterError
from abfm.functions import function
from abfm.io.sheets import Sheet
from abfm.maps import MapQuality, map_quality
from abfm.matching import Iteration, StopReason
from abfm.matching.judging.cause import Cause, sentence_of
from abfm.matching.judging.verdict import Verdict
from abfm.mesh import TriangleMesh, load_mesh
from abfm.outcome import outcome_of
from abfm.types import FloatArray
from abfm.workers.worker import Worker, no_state


@dataclass(frozen=True, eq=False)
class FigureSetup:
    """Options of a figure: another mesh, small meshes for tests, and progress reports.

    ``report`` is a function that takes a short text and the finished fraction of the figure.
    """

    mesh: TriangleMesh | None = None
    name: str = "mesh"
    small: bool = False
    report: Callable[[str, float], None] = lambda text, share: None

    def surface(
        self, name: str, make: Callable[..., TriangleMesh], *arguments: Any
    ) -> tuple[TriangleMesh, str]:
        """Return the mesh of the options and its name or, without one, the mesh of the figure.

        The latter is ``make(*arguments)``, with the name ``name``.
        """
        return (make(*arguments), name) if self.mesh is None else (self.mesh, self.name)

    def match(self, requested: Sequence[RequestedMatch]) -> list[Match]:
        """Solve the requested matches one by one in this process, and report the progress."""
        found, start = list[Match](), 0.0
        for each in requested:
            found.append(match(each.problem, on_iteration=self._reporter(each, start)))
            start += each.share
        return found

    def _reporter(self, requested: RequestedMatch, start: float) -> Callable[[Iteration], None]:
        limit = max(requested.problem.parameters.solver.iterations, 1)
        return lambda now: self.report(
            requested.text, start + requested.share * now.iteration / limit
        )


@dataclass(frozen=True, eq=False)
class RequestedMatch:
    """A match that a script requests, with a short text and its fraction of the figure's work."""

    problem: Problem
    text: str = "matching"
    share: float = 0.95


@dataclass(frozen=True, eq=False)
class Example:
    """A problem with the name of its mesh, and a flow if the figure has one instead of a match.

    ``specs`` has the specifications of source and target for each channel, as texts. A function
    that has no other specification is ``file:name.npy``, a file that need not exist.
    """

    problem: Problem
    name: str
    specs: tuple[tuple[str, str], ...]
    flow: Flow | None = None

    @property
    def values(self) -> dict[str, FloatArray]:
        """Functions (V,) by specification, for specifications of the form ``file:name.npy``."""
        sources, targets = zip(*self.specs, strict=True)
        columns = [*self.problem.source.T, *self.problem.target.T]
        named = zip([*sources, *targets], columns, strict=True)
        return {spec: column for spec, column in named if spec.startswith("file:")}


@dataclass(frozen=True)
class Measure:
    """A measured number, with its unit in the name, compared with a statement of the paper.

    ``claim`` is the statement of the paper. ``reproduces`` is true if the number supports it, and
    None if there is no statement. ``bound`` is an upper bound, if there is one. A number that is
    not finite raises MeshError.
    """

    name: str
    value: float
    claim: str = ""
    reproduces: bool | None = None
    bound: float | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise MeshError(
                f"the measurement '{self.name}' is {self.value}, because the mesh is too "
                "coarse or degenerate; use another mesh"
            )

    @property
    def passes(self) -> bool | None:
        """Whether the value is at most the bound; None if there is no bound."""
        return None if self.bound is None else bool(self.value <= self.bound)

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the measure in the JSON file of the figure."""
        return {
            "name": self.name,
            "value": float(self.value),
            "bound": None if self.bound is None else float(self.bound),
            "pass": self.passes,
            "claim": self.claim,
            "reproduces": None if self.reproduces is None else bool(self.reproduces),
        }


@dataclass(frozen=True, eq=False)
class Findings:
    """Results of a figure's script: measures, the picture to draw, and a text about the setup."""

    measures: Sequence[Measure]
    sheet: Sheet
    setting: str


Script = Generator[Example | Sequence[RequestedMatch], Sequence[Match], Findings]
"""Generator of a figure. It yields its `Example` and then, unless the example has a flow, the list
of all matches that it requests. The caller solves them and sends the results in the same order.
"""

_MODULE_OF_FIGURE = {3: 1, 10: 9, 12: 11, 13: 11}  # figures in the module of another figure
_CLAIMS = {
    1: "A single vector field advects the source to a function that matches the target, and "
    "interpolates smoothly.",
    2: "The flow map of a vector field advects a function, without explicit flow lines.",
    3: "The result matches the target, and values are displaced in space, as by optimal transport.",
    4: "Linear advection works well for short times and oscillates for longer ones; nonlinear "
    "advection stays smooth.",
    5: "The kernel of ad_v consists of many fields that commute with v, of which the smoothest is "
    "shown.",
    6: "exp(t ad_v) transports a field u over the flow lines of v, here to t = 0.125 and 0.25.",
    7: "The result highly matches the target, and the interpolation path is smooth.",
    8: "The matched field is very close to the one that made the target, and the error between the "
    "functions very small.",
    9: "One field's flow is the continuous symmetry map; at 2 τ some drift is noticeable, yet it "
    "is relatively small.",
    10: "A smooth field generates a continuous symmetric mapping although the geometry contains "
    "creases.",
    11: "Two non-smooth functions are matched to smooth versions of them at once, and the required "
    "functions are achieved.",
    12: "Matching one coordinate function or all three brings the target functions about.",
    13: "Matching only three functions reconstructs the map better than the method [COC15] in a "
    "reduced basis.",
}


def script(figure: int, setup: FigureSetup) -> Script:
    """Return the script that computes a figure of the paper."""
    module = import_module(f"abfm.experiments.figure_{_MODULE_OF_FIGURE.get(figure, figure):02}")
    found: Script = getattr(module, f"figure_{figure}")(setup)
    return found


def claim(figure: int) -> str:
    """Return the statement of the paper about a figure."""
    return _CLAIMS[figure]


def example_of(script: Script) -> Example:
    """Run the script of a figure until it yields its example, and return the example."""
    example = next(script)
    assert isinstance(example, Example)
    return example


def requested_matches(script: Script) -> Sequence[RequestedMatch]:
    """Run a script until it requests matches, and return these; none if its example has a flow."""
    if example_of(script).flow is not None:
        return ()
    requested = next(script)
    assert not isinstance(requested, Example)
    return requested


def findings_of(script: Script, matches: Sequence[Match] | None = None) -> Findings:
    """Run a script to its end, and return its findings.

    Parameters
    ----------
    script : Script
    matches : sequence of Match, optional
        Matches that the script has requested. Without them, the script is run from its start and
        the matches are solved in this process.
    """
    if matches is None:
        matches = FigureSetup().match(requested_matches(script))
    try:
        script.send(matches)
    except StopIteration as end:
        found: Findings = end.value
        return found
    raise AssertionError("a script requests matches only once")


def example_in_subprocess(figure: int) -> tuple[Example, Match | None]:
    """Create the example of a figure on its default mesh, in a subprocess.

    In this process, computing eigenfunctions and geodesics would block a window. Also return the
    flow of the example as a match, if it has one (see `match_of_flow`). Raise an AbfmError if this
    fails.
    """
    ended = f"figure {figure} could not be set up because its process ended; try again"
    with closing(Worker(no_state, ended)) as worker:
        return worker.call(_example_and_match, figure).result()


def _example_and_match(_: None, figure: int) -> tuple[Example, Match | None]:
    example = example_of(script(figure, FigureSetup()))
    return example, match_of_flow(example)


def match_of_flow(example: Example) -> Match | None:
    """Return the flow of an example as a match, for display; None if it has no flow."""
    if example.flow is None:
        return None
    problem, velocity = example.problem, example.flow.velocity
    fields = to_frame(problem.mesh, velocity / problem.mesh.length_scale)
    energy = MatchingEnergy(problem)
    evaluated = energy.objective(problem.parameters.last_sigma).evaluate(fields)
    residual = energy.residual(evaluated.advected)
    outcome = outcome_of(residual, Parameters.goal)
    return Match(
        problem=problem,
        fine_velocity=velocity,
        advected=np.ascontiguousarray(evaluated.advected.T),
        energy_history=np.array([[evaluated.energy, evaluated.regularity, evaluated.mismatch]]),
        stages=np.zeros(1, dtype=np.int64),
        residual=residual,
        verified_residual=math.nan,
        folded=math.nan,
        stop_reason=StopReason.GIVEN,
        verdict=Verdict(outcome, sentence_of(Cause.FIELD_GIVEN), "", cause=Cause.FIELD_GIVEN),
    )


@lru_cache
def bundled(name: str) -> TriangleMesh:
    return load_mesh(asset_path(name))


def loop_subdivided(name: str, times: int) -> TriangleMesh:
    """Return a bundled mesh after ``times`` Loop subdivisions of each face into four."""
    mesh = bundled(name)
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).subdivide_loop(times)
    return TriangleMesh(shape.vertices, shape.faces)


def size_text(name: str, *meshes: TriangleMesh) -> str:
    return f"{name}, {', '.join(f'{len(mesh.vertices):,}' for mesh in meshes)} vertices"


def gaussian(mesh: TriangleMesh, vertex: int, width: float) -> str:
    return f"gaussian:vertex={mesh.vertex_ids[vertex]},width={width:g}"


def advection_example(flow: Flow, name: str, source: str, target: str) -> Example:
    """Return the example whose target is the source advected by a flow; see `Example`."""
    f = function(flow.mesh, source)
    problem = Problem(flow.mesh, f, flow.push(f), Parameters(tau=flow.tau))
    return Example(problem, name, ((source, target),), flow)


def affordable_iterations(mesh: TriangleMesh, iterations_max: int) -> int:
    """Return a number of iterations, from 60 up, that takes about 30 s with three functions."""
    return min(max(1_230_000 // len(mesh.vertices), 60), iterations_max)


def verification_measures(found: Match) -> tuple[list[Measure], tuple[str, ...], str]:
    """Verify a match; return measures, notes for the picture, and a text on missing checks."""
    try:
        verification = found.verify()
    except ParameterError as error:
        return [], (), f" Not verified: {error}."
    numbers = {
        "residual along flow lines": verification.flow_lines,
        "residual on the subdivided mesh": verification.subdivided,
        "folded faces, as a share of all": verification.folded,
    }
    measures = [Measure(name, x) for name, x in numbers.items() if math.isfinite(x)]
    note = (
        f"Residual of the matched function: {found.residual:.2g}; "
        f"along flow lines: {verification.flow_lines:.2g}."
    )
    is_infinite = math.isinf(verification.subdivided)
    overflows = " The flow on the subdivided mesh overflows." if is_infinite else ""
    return measures, (note,), overflows


def flow_map_measures(
    found: Match, name: str, shares: Sequence[float] = (1.0,)
) -> dict[str, MapQuality]:
    """Measure the maps of a match's flow at ``shares`` of tau; return them by name and time."""
    return {
        f"{name} at {'' if share == 1 else f'{share:g} '}τ": map_quality(
            found.flow.coordinate_map(share * found.parameters.tau)
        )
        for share in shares
    }


def quality_measures(qualities: Mapping[str, MapQuality]) -> tuple[list[Measure], tuple[str, ...]]:
    """Return measures of named maps, and a note with the maps that are unreliable."""
    measures, faults = [], []
    for name, quality in qualities.items():
        measures += [
            Measure(f"{name}: off_surface, largest, sqrt(area)", quality.largest_distance),
            Measure(f"{name}: off_surface, RMS, sqrt(area)", quality.rms_distance),
            Measure(f"{name}: folded, % of the faces", 100 * quality.folded),
        ]
        if quality.faults:
            faults.append(f"{name} ({quality.faults})")
    return measures, (f"Unreliable as maps: {'; '.join(faults)}.",) if faults else ()
