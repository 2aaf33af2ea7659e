"""The words of a figure's script: it yields its problem and what is to be matched, then computes,
measures and draws.
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
class Stage:
    """The place of a figure: its own meshes, coarse ones for tests, or another one; `report` is
    told what is being done, in a few words, and which share of the figure is behind it.
    """

    mesh: TriangleMesh | None = None
    name: str = "mesh"
    small: bool = False
    report: Callable[[str, float], None] = lambda text, share: None

    def surface(
        self, name: str, make: Callable[..., TriangleMesh], *arguments: Any
    ) -> tuple[TriangleMesh, str]:
        """Return the mesh that is given and its name, or else the figure's own."""
        return (make(*arguments), name) if self.mesh is None else (self.mesh, self.name)

    def match(self, sought: Sequence[Sought]) -> list[Match]:
        """Match one after the other, here and now, and report of it."""
        found, begin = list[Match](), 0.0
        for each in sought:
            found.append(match(each.problem, on_iteration=self._heard(each, begin)))
            begin += each.share
        return found

    def _heard(self, sought: Sought, begin: float) -> Callable[[Iteration], None]:
        limit = max(sought.problem.parameters.solver.iterations, 1)
        return lambda now: self.report(sought.text, begin + sought.share * now.iteration / limit)


@dataclass(frozen=True, eq=False)
class Sought:
    """A match that a script waits for, in a few words, and its share in the figure's work."""

    problem: Problem
    text: str = "matching"
    share: float = 0.95


@dataclass(frozen=True, eq=False)
class Example:
    """A problem that is ready to run, the name of its mesh, and the flow, if that is given and not
    sought; source and target of each channel as text, ``file:name.npy``, which need not exist, for
    a function that no text describes.
    """

    problem: Problem
    name: str
    specs: tuple[tuple[str, str], ...]
    flow: Flow | None = None

    @property
    def values(self) -> dict[str, FloatArray]:
        """Return the functions (V,) that no text describes, by their specs."""
        sources, targets = zip(*self.specs, strict=True)
        columns = [*self.problem.source.T, *self.problem.target.T]
        named = zip([*sources, *targets], columns, strict=True)
        return {spec: column for spec, column in named if spec.startswith("file:")}


@dataclass(frozen=True)
class Measure:
    """A measured number, whose `name` says its unit; what the paper claims about it, whether it
    bears that out, and the `bound` of it, if any. MeshError if it is not finite.
    """

    name: str
    value: float
    claim: str = ""
    reproduces: bool | None = None
    bound: float | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise MeshError(
                f"'{self.name}' came out as {self.value}: the mesh is too coarse or degenerate "
                "for it"
            )

    @property
    def passes(self) -> bool | None:
        """Tell whether the value keeps the bound; None without one."""
        return None if self.bound is None else bool(self.value <= self.bound)

    def to_dict(self) -> dict[str, Any]:
        """Return it as it stands in a figure's JSON."""
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
    """The findings of a script: measures, the figure to draw, and what was run, in a sentence."""

    measures: Sequence[Measure]
    sheet: Sheet
    setting: str


Script = Generator[Example | Sequence[Sought], Sequence[Match], Findings]
"""It yields its `Example` and then, unless that has a flow, all matches that it waits for, which it
is sent in their order: whoever runs it has them found, as one likes.
"""

_MODULE_OF_FIGURE = {3: 1, 10: 9, 12: 11, 13: 11}  # figures in the module of another
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


def script(figure: int, stage: Stage) -> Script:
    """Return the script of a figure of the paper."""
    module = import_module(f"abfm.experiments.figure_{_MODULE_OF_FIGURE.get(figure, figure):02}")
    found: Script = getattr(module, f"figure_{figure}")(stage)
    return found


def claim(figure: int) -> str:
    """Return what the paper shows with a figure."""
    return _CLAIMS[figure]


def example_of(script: Script) -> Example:
    """Begin a script: what it is about."""
    example = next(script)
    assert isinstance(example, Example)
    return example


def sought_by(script: Script) -> Sequence[Sought]:
    """Run a script, from its beginning, until it waits for matches."""
    if example_of(script).flow is not None:
        return ()
    sought = next(script)
    assert not isinstance(sought, Example)
    return sought


def findings_of(script: Script, matches: Sequence[Match] | None = None) -> Findings:
    """Run a script to its end: one that waits, with the matches that it waits for; without these
    from its beginning, and they are found here and now.
    """
    if matches is None:
        matches = Stage().match(sought_by(script))
    try:
        script.send(matches)
    except StopIteration as end:
        found: Findings = end.value
        return found
    raise AssertionError("a script waits once")


def stated_apart(figure: int) -> tuple[Example, Match | None]:
    """State the problem of a figure on its own mesh, in a process of its own: eigenfunctions and
    geodesics would stop a window. A given flow comes `as_match`; AbfmError if it cannot be stated.
    """
    ended = f"figure {figure} was not set up: its process has ended; try again"
    with closing(Worker(no_state, ended)) as worker:
        return worker.call(_stated, figure).result()


def _stated(_: None, figure: int) -> tuple[Example, Match | None]:
    example = example_of(script(figure, Stage()))
    return example, as_match(example)


def as_match(example: Example) -> Match | None:
    """Return the given flow as a match with its field, for a window to show; None without."""
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
        verdict=Verdict(outcome, sentence_of(Cause.GIVEN), "", cause=Cause.GIVEN),
    )


@lru_cache
def bundled(name: str) -> TriangleMesh:
    """Read a mesh that comes with abfm, once: what was computed on it is kept."""
    return load_mesh(asset_path(name))


def smoothed(name: str, times: int) -> TriangleMesh:
    """Subdivide a bundled mesh by Loop's scheme, each time into four times as many faces."""
    mesh = bundled(name)
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).subdivide_loop(times)
    return TriangleMesh(shape.vertices, shape.faces)


def sized(name: str, *meshes: TriangleMesh) -> str:
    """Return a surface in words, coarse to fine."""
    return f"{name}, {', '.join(f'{len(mesh.vertices):,}' for mesh in meshes)} vertices"


def gaussian(mesh: TriangleMesh, vertex: int, width: float) -> str:
    """Return the spec of a Gaussian."""
    return f"gaussian:vertex={mesh.vertex_ids[vertex]},width={width:g}"


def carried_example(flow: Flow, name: str, source: str, target: str) -> Example:
    """Return a function and what a given flow makes of it until tau, by the name of a file."""
    f = function(flow.mesh, source)
    problem = Problem(flow.mesh, f, flow.push(f), Parameters(tau=flow.tau))
    return Example(problem, name, ((source, target),), flow)


def affordable_iterations(mesh: TriangleMesh, most: int) -> int:
    """Return 60 to ``most``: about half a minute with three functions, for want of time."""
    return min(max(1_230_000 // len(mesh.vertices), 60), most)


def witnessed(found: Match) -> tuple[list[Measure], str, str]:
    """Verify a match: return measures, a label of the panel, and what is unknown, if anything."""
    try:
        said = found.verify()
    except ParameterError as error:
        return [], "matched", f" Not verified: {error}."
    numbers = {
        "residual by flow lines": said.flow_lines,
        "residual on the subdivided mesh": said.subdivided,
        "folded faces, as a share of all": said.folded,
    }
    measures = [Measure(name, x) for name, x in numbers.items() if math.isfinite(x)]
    label = f"matched: {found.residual:.2g}, {said.flow_lines:.2g} by flow lines"
    overflows = " On the subdivided mesh the flow overflows." if math.isinf(said.subdivided) else ""
    return measures, label, overflows


def maps_of_flow(
    found: Match, name: str, shares: Sequence[float] = (1.0,)
) -> dict[str, MapQuality]:
    """Judge the maps that a flow makes of its surface, at some shares of tau, by names to show."""
    return {
        f"{name} at {'' if share == 1 else f'{share:g} '}τ": map_quality(
            found.flow.coordinate_map(share * found.parameters.tau)
        )
        for share in shares
    }


def map_findings(qualities: Mapping[str, MapQuality]) -> tuple[list[Measure], tuple[str, ...]]:
    """Return how far maps leave the surface and fold it, and which are not to be trusted."""
    measures, faults = [], []
    for name, quality in qualities.items():
        measures += [
            Measure(f"{name}: off_surface, largest, sqrt(area)", quality.largest_distance),
            Measure(f"{name}: off_surface, RMS, sqrt(area)", quality.rms_distance),
            Measure(f"{name}: folded, % of the faces", 100 * quality.folded),
        ]
        if quality.faults:
            faults.append(f"{name} ({quality.faults})")
    return measures, (f"Not to be trusted as maps: {'; '.join(faults)}.",) if faults else ()
