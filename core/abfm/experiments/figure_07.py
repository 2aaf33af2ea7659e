"""Figure 7: eigenfunction 7 of the Laplace-Beltrami operator becomes eigenfunction 8, by linearised steps."""

import numpy as np

from abfm.calculus.operators import cotangent_laplacian, l2_norm, vertex_areas
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup, solved
from abfm.experiments.meshes import five_limbs
from abfm.experiments.sheet import Panel, Sheet, Values
from abfm.experiments.table_1 import TABLE_1
from abfm.experiments.witnesses import witnessed
from abfm.functions import function
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

_SHOWN = (0.25, 0.5, 0.75)  # of tau
_BOUND = 0.1
_SMOOTH_TURN, _SMOOTH_ENERGY = 0.5, 1.5
_NEGATIVE = "file:eigenfunction-8-negative.npy"


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> Setup:
    """Eigenfunctions 7 and 8, the constant being number 0.

    The sign of an eigenfunction is arbitrary. A flow cannot change which values there are, so the target has the sign
    with which its values are spread over the surface more like the source's.
    """
    name = "mesh" if mesh else "five limbs"
    mesh = mesh or five_limbs(800 if small else 2500)
    source, target = function(mesh, "eigenfunction:7"), function(mesh, "eigenfunction:8")
    negative = spread_gap(mesh, source, -target) < 0.99 * spread_gap(mesh, source, target)
    return Setup(
        mesh=mesh,
        name=name,
        sources=("eigenfunction:7",),
        targets=(_NEGATIVE,) if negative else ("eigenfunction:8",),
        values={_NEGATIVE: -target} if negative else {},
        parameters=TABLE_1[7].parameters(iterations=60 if small else 120),
    )


def run(setup: Setup, report: Report) -> Findings:
    """Match, verify, and look at the way between."""
    p, mesh = setup.parameters, setup.mesh
    found = solved(setup, report, "matching")
    report("verifying", 0.95)
    witnesses = witnessed(found)
    path = found.advect(np.linspace(0, p.tau, p.segments + 1))[..., 0]
    shown = found.advect(np.array(_SHOWN) * p.tau)[..., 0]
    target, sign = found.target[:, 0], "−" if setup.values else ""
    panels = (
        Panel(mesh, Values(path[0]), "eigenfunction 7", "source"),
        *(Panel(mesh, Values(f), f"t = {s:g} τ") for s, f in zip(_SHOWN, shown, strict=True)),
        Panel(mesh, Values(path[-1]), witnesses.label, "result"),
        Panel(mesh, Values(target), f"{sign}eigenfunction 8", "target"),
    )
    mismatch = Measure("mismatch, relative L2", found.mismatch, "highly matches", found.mismatch <= _BOUND, _BOUND)
    setting = (
        f"{setup.where}; eigenfunction 7 to {sign}eigenfunction 8, "
        f"{p.segments} linearised steps, {p.iterations} iterations.{witnesses.note}"
    )
    return Findings((mismatch, *witnesses.measures, *smoothness(mesh, path, target)), Sheet((panels,)), setting)


def smoothness(mesh: TriangleMesh, path: FloatArray, target: FloatArray) -> tuple[Measure, ...]:
    """How even, how straight and how free of oscillations a path of functions (N + 1, V) to a target (V,) is."""
    steps = np.diff(path, axis=0)
    lengths = np.array([l2_norm(mesh, step) for step in steps])
    turns = [l2_norm(mesh, turn) for turn in np.diff(steps, axis=0)]
    stiffness = cotangent_laplacian(mesh)
    energy = np.array([f @ (stiffness @ f) for f in (*path, target)])
    turn = float(max(turns) / lengths.mean())
    rise = float(energy[:-1].max() / max(energy[0], energy[-1]))
    claim, whole = "smooth path", l2_norm(mesh, steps.sum(axis=0))
    of_energy = "largest Dirichlet energy on the way over that of source or target"
    return (
        Measure("path length over distance of its ends, in L2", lengths.sum() / whole),
        Measure("largest step over mean step", lengths.max() / lengths.mean()),
        Measure("largest change from one step to the next over mean step", turn, claim, turn <= _SMOOTH_TURN),
        Measure(of_energy, rise, claim, rise <= _SMOOTH_ENERGY),
    )


def spread_gap(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> float:
    """L1 distance of the distributions of two functions' values over the surface (optimal transport on the line)."""
    areas = vertex_areas(mesh)
    shares = (np.arange(1000) + 0.5) / 1000
    quantiles = []
    for values in (f, g):
        order = np.argsort(values, kind="stable")
        quantiles.append(np.interp(shares, np.cumsum(areas[order]) / areas.sum(), values[order]))
    return float(np.abs(quantiles[0] - quantiles[1]).mean())


EXPERIMENT = Experiment(7, "The result highly matches the target, and the interpolation path is smooth.", set_up, run)
