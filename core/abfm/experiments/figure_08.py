"""Figure 8: optical flow, the field that made the target is found again from source and target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import averaging, gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup
from abfm.experiments.given_flow import root_mean_square, stream_field
from abfm.experiments.meshes import smoothed
from abfm.experiments.sheet import Panel, Sheet, Streaks, Values
from abfm.experiments.table_1 import TABLE_1
from abfm.experiments.witnesses import witnessed
from abfm.flow.advection import advect
from abfm.flow.flow import Flow
from abfm.functions import function
from abfm.matching.match import match
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

_MODES = {2: 1.0, 5: 0.7}
_WAY = 0.15  # root mean square over the surface, in sqrt(area)
_SIGNIFICANT = 0.2  # of the largest slope
_BOUND = 0.02
_CLOSE = 0.1  # what "very close to the original field" is taken for
_TARGET = "file:advected.npy"


@dataclass(frozen=True, eq=False, kw_only=True)
class OpticalFlowSetup(Setup):
    """The problem, and the field ``hidden`` (F, 3) that made its target and is to be found."""

    hidden: FloatArray


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> OpticalFlowSetup:
    """An eigenfunction, and what a smooth field without divergence makes of it until tau."""
    name = "mesh" if mesh else "eight.off, Loop subdivided"
    mesh = mesh or smoothed("eight.off", 1 if small else 2)
    parameters = TABLE_1[8].parameters(iterations=100 if small else 200)
    hidden = stream_field(mesh, _MODES, _WAY / parameters.tau)
    source = "eigenfunction:7"
    return OpticalFlowSetup(
        mesh=mesh,
        name=name,
        sources=(source,),
        targets=(_TARGET,),
        values={_TARGET: advect(mesh, hidden, function(mesh, source), parameters.tau)},
        parameters=parameters,
        hidden=hidden,
    )


def run(setup: OpticalFlowSetup, report: Report) -> Findings:
    """Match without knowing the field, and compare what was found with it."""
    p, mesh, given = setup.parameters, setup.mesh, setup.hidden
    f, g = setup.source[:, 0], setup.target[:, 0]
    found = match(mesh, f, g, p, on_iteration=lambda now: report("matching", 0.95 * now.iteration / p.iterations))
    report("verifying", 0.95)
    witnesses = witnessed(found)
    velocity, matched = found.velocity[0], found.advected[:, 0]
    difference = np.abs(g - matched)

    slopes = to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))
    steepness = np.linalg.norm(slopes, axis=1)
    significant = steepness > _SIGNIFICANT * steepness.max()
    directions = np.divide(slopes, steepness[:, None], out=np.zeros_like(slopes), where=significant[:, None])
    error = velocity - given
    along = root_mean_square(mesh, (error * directions).sum(axis=1)) / root_mean_square(
        mesh, (given * directions).sum(axis=1)
    )
    share = root_mean_square(mesh, significant.astype(float)) ** 2
    way = Flow(mesh, given, p.tau).push(f, np.linspace(0, p.tau, 21))
    seen = _rate(mesh, error, way) / _rate(mesh, given, way)
    whole = root_mean_square(mesh, error) / root_mean_square(mesh, given)
    where = f"where |grad f| exceeds {_SIGNIFICANT:.0%} of its maximum"
    measures = (
        Measure(
            f"error of the field along grad f, {where}, relative L2",
            along,
            None,
            "very close to the original field",
            along <= _CLOSE,
        ),
        Measure(f"share of the surface {where}", share),
        Measure("error of <v, grad f_t> over the whole way, relative L2 on the surface and in time", seen),
        Measure("error of the whole field, relative L2", whole),
        Measure(
            "largest |g - f_tau|, f and g on the scale of 1",
            float(difference.max()),
            _BOUND,
            "the error between the functions is very small",
            bool(difference.max() <= _BOUND),
        ),
        Measure("mismatch, relative L2", found.mismatch),
        *witnesses.measures,
    )
    rows = (
        (
            Panel(mesh, Streaks(given), "given field v₀", "field"),
            Panel(mesh, Values(_speed(mesh, given), "speed"), "|v₀|", "field"),
            Panel(mesh, Values(f), "source f", "source"),
            Panel(mesh, Values(g), f"target g = f at τ = {p.tau:g}", "target"),
        ),
        (
            Panel(mesh, Streaks(velocity), "found field v", "result"),
            Panel(mesh, Values(_speed(mesh, velocity), "speed"), "|v|", "result"),
            Panel(mesh, Values(matched), witnesses.label, "result"),
            Panel(mesh, Values(difference, "|g − matched|"), "|g − matched|"),
        ),
    )
    setting = (
        f"{setup.name}, {len(mesh.vertices):,} vertices; the rotated gradient of eigenfunctions "
        f"{' and '.join(map(str, _MODES))} carries eigenfunction 7 to τ = {p.tau:g}, "
        f"on average {_WAY:g} sqrt(area) far.{witnesses.note}"
    )
    return Findings(measures, Sheet(rows), setting)


def _rate(mesh: TriangleMesh, field: FloatArray, way: FloatArray) -> float:
    """Root mean square of ``<v, grad f_t>`` over the surface and the times of ``way`` (T, V)."""
    slopes = (to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2)) for f in way)
    return float(np.sqrt(np.mean([root_mean_square(mesh, (field * slope).sum(axis=1)) ** 2 for slope in slopes])))


def _speed(mesh: TriangleMesh, velocity: FloatArray) -> FloatArray:
    """The field's norm, averaged at vertices for the picture."""
    return np.asarray(averaging(mesh) @ np.linalg.norm(velocity, axis=1))


EXPERIMENT = Experiment(
    8,
    "The matched field is very close to the one that made the target, and the error between the functions very small.",
    set_up,
    run,
)
