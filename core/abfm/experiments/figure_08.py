"""Figure 8: optical flow, the field that made the target is found again from source and target."""

from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import gradient
from abfm.calculus.vector_fields import to_ambient
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup, solved
from abfm.experiments.given_flow import root_mean_square, speed, stream_field
from abfm.experiments.meshes import smoothed
from abfm.experiments.sheet import Panel, Sheet, Streaks, Values
from abfm.experiments.table_1 import TABLE_1
from abfm.experiments.witnesses import witnessed
from abfm.flow.flow import Flow
from abfm.functions import function
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

_MODES = {2: 1.0, 5: 0.7}
_WAY = 0.15  # root mean square over the surface, in sqrt(area)
_SIGNIFICANT = 0.2  # of the largest slope
_BOUND = 0.02
_CLOSE = 0.1  # what "very close to the original field" is taken for
_SOURCE, _TARGET = "eigenfunction:7", "file:advected.npy"


@dataclass(frozen=True, eq=False, kw_only=True)
class OpticalFlowSetup(Setup):
    """The problem, and the flow that made its target and is to be found."""

    hidden: Flow


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> OpticalFlowSetup:
    """An eigenfunction, and what a smooth field without divergence makes of it until tau."""
    name = "mesh" if mesh else "eight.off, Loop subdivided"
    mesh = mesh or smoothed("eight.off", 1 if small else 2)
    parameters = TABLE_1[8].parameters(iterations=100 if small else 200)
    hidden = Flow(mesh, stream_field(mesh, _MODES, _WAY / parameters.tau), parameters.tau)
    return OpticalFlowSetup(
        mesh=mesh,
        name=name,
        sources=(_SOURCE,),
        targets=(_TARGET,),
        values={_TARGET: hidden.advect(function(mesh, _SOURCE))},
        parameters=parameters,
        hidden=hidden,
    )


def run(setup: OpticalFlowSetup, report: Report) -> Findings:
    """Match without knowing the field, and compare what was found with it."""
    tau, mesh, given = setup.parameters.tau, setup.mesh, setup.hidden.velocity[0]
    f, g = setup.source[:, 0], setup.target[:, 0]
    found = solved(setup, report, "matching")
    report("verifying", 0.95)
    witnesses = witnessed(found)
    velocity, matched = found.velocity[0], found.advected[:, 0]
    difference = np.abs(g - matched)

    slopes = _slopes(mesh, f)
    steepness = np.linalg.norm(slopes, axis=1)
    significant = steepness > _SIGNIFICANT * steepness.max()
    directions = np.divide(slopes, steepness[:, None], out=np.zeros_like(slopes), where=significant[:, None])
    error = velocity - given
    along, along_given = (root_mean_square(mesh, (field * directions).sum(axis=1)) for field in (error, given))
    off = along / along_given
    way = setup.hidden.push(f, np.linspace(0, tau, 21))
    seen = seen_rate(mesh, error, way) / seen_rate(mesh, given, way)
    whole = root_mean_square(mesh, error) / root_mean_square(mesh, given)
    where = f"where |grad f| exceeds {_SIGNIFICANT:.0%} of its maximum"
    close, small = "very close to the original field", "the error between the functions is very small"
    largest = difference.max()
    measures = (
        Measure(f"error of the field along grad f, {where}, relative L2", off, close, off <= _CLOSE),
        Measure(f"share of the surface {where}", root_mean_square(mesh, significant.astype(float)) ** 2),
        Measure("error of <v, grad f_t> over the whole way, relative L2 on the surface and in time", seen),
        Measure("error of the whole field, relative L2", whole),
        Measure("largest |g - f_tau|, f and g on the scale of 1", largest, small, largest <= _BOUND, _BOUND),
        Measure("mismatch, relative L2", found.mismatch),
        *witnesses.measures,
    )
    rows = (
        (
            Panel(mesh, Streaks(given), "given field v₀", "field"),
            Panel(mesh, Values(speed(mesh, given), "speed"), "|v₀|", "field"),
            Panel(mesh, Values(f), "source f", "source"),
            Panel(mesh, Values(g), f"target g = f at τ = {tau:g}", "target"),
        ),
        (
            Panel(mesh, Streaks(velocity), "found field v", "result"),
            Panel(mesh, Values(speed(mesh, velocity), "speed"), "|v|", "result"),
            Panel(mesh, Values(matched), witnesses.label, "result"),
            Panel(mesh, Values(difference, "|g − matched|"), "|g − matched|"),
        ),
    )
    setting = (
        f"{setup.where}; the rotated gradient of eigenfunctions "
        f"{' and '.join(map(str, _MODES))} carries eigenfunction 7 to τ = {tau:g}, "
        f"on average {_WAY:g} sqrt(area) far.{witnesses.note}"
    )
    return Findings(measures, Sheet(rows), setting)


def seen_rate(mesh: TriangleMesh, field: FloatArray, way: FloatArray) -> float:
    """Root mean square of ``<v, grad f_t>`` over the surface and the times of ``way`` (T, V)."""
    squares = [root_mean_square(mesh, (field * _slopes(mesh, f)).sum(axis=1)) ** 2 for f in way]
    return float(np.sqrt(np.mean(squares)))


def _slopes(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    return to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))


EXPERIMENT = Experiment(
    8,
    "The matched field is very close to the one that made the target, and the error between the functions very small.",
    set_up,
    run,
)
