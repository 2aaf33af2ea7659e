"""Figure 7: a match of Laplacian eigenfunctions 7 and 8 by linearised steps."""

import numpy as np

from abfm import Problem, TriangleMesh, function
from abfm.calculus import cotangent_laplacian, l2_norm, vertex_areas
from abfm.experiments import scripts
from abfm.experiments.scripts import Example, FigureSetup, Findings, Measure, RequestedMatch, Script
from abfm.io.sheets import Panel, Sheet, Values
from abfm.mesh.shapes import five_limbs
from abfm.parameters import TABLE_1
from abfm.types import FloatArray

_TIMES = (0.25, 0.5, 0.75)  # times relative to tau
_MISMATCH_MAX = 0.1
_CHANGE_MAX = 0.5  # largest difference of two consecutive steps, relative to the mean step
_ENERGY_RATIO_MAX = 1.5  # largest ratio of the Dirichlet energy of a path to that of its ends


def figure_7(setup: FigureSetup) -> Script:
    """Match eigenfunction 7 to eigenfunction 8 by linear steps; the constant has number 0."""
    mesh, name = setup.surface("five limbs", five_limbs, 800 if setup.small else 2500)
    f, g = function(mesh, "eigenfunction:7"), function(mesh, "eigenfunction:8")
    sign, target = "", "eigenfunction:8"
    # The sign of an eigenfunction is arbitrary. A flow preserves the values of the source, so use
    # the target whose values have the more similar distribution.
    if spread_gap(mesh, f, -g) < 0.99 * spread_gap(mesh, f, g):
        sign, target, g = "−", "file:eigenfunction-8-negative.npy", -g
    p = TABLE_1[7].parameters(iterations=60 if setup.small else 120)
    problem = Problem(mesh, f, g, p)
    yield Example(problem, name, (("eigenfunction:7", target),))

    [found] = yield [RequestedMatch(problem)]
    setup.report("verifying", 0.95)
    verification, notes, missing = scripts.verification_measures(found)
    path = found.advect(np.linspace(0, p.tau, p.solver.segments + 1))
    between = found.advect(np.array(_TIMES) * p.tau)
    panels = (
        Panel(mesh, Values(path[0]), "eigenfunction 7", "source"),
        *(Panel(mesh, Values(h), f"t = {s:g} τ") for s, h in zip(_TIMES, between, strict=True)),
        Panel(mesh, Values(path[-1]), "matched", "result"),
        Panel(mesh, Values(g), f"{sign}eigenfunction 8", "target"),
    )
    error, claim = found.mismatch, "highly matches"
    measures = (
        Measure("mismatch, relative L2", error, claim, error <= _MISMATCH_MAX, _MISMATCH_MAX),
        *verification,
        *smoothness(mesh, path, g),
    )
    setting = (
        f"{scripts.size_text(name, mesh)}; eigenfunction 7 to {sign}eigenfunction 8, "
        f"{p.solver.segments} linearised steps, {p.solver.iterations} iterations.{missing}"
    )
    return Findings(measures, Sheet((panels,), notes=notes), setting)


def smoothness(mesh: TriangleMesh, path: FloatArray, target: FloatArray) -> tuple[Measure, ...]:
    """Measure the smoothness of a path of functions (N + 1, V) to ``target``."""
    steps = np.diff(path, axis=0)
    lengths = np.array([l2_norm(mesh, step) for step in steps])
    turn = max(l2_norm(mesh, turn) for turn in np.diff(steps, axis=0)) / lengths.mean()
    stiffness = cotangent_laplacian(mesh)
    energy = np.array([f @ (stiffness @ f) for f in (*path, target)])
    rise = energy[:-1].max() / max(energy[0], energy[-1])
    claim, end_distance = "smooth path", l2_norm(mesh, steps.sum(axis=0))
    of_turns = "largest change from one step to the next over mean step"
    of_energy = "largest Dirichlet energy of the path over that of source or target"
    return (
        Measure("path length over distance of its ends, in L2", lengths.sum() / end_distance),
        Measure("largest step over mean step", lengths.max() / lengths.mean()),
        Measure(of_turns, turn, claim, turn <= _CHANGE_MAX),
        Measure(of_energy, rise, claim, rise <= _ENERGY_RATIO_MAX),
    )


def spread_gap(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> float:
    """Return the L1 distance between the distributions of the values of two functions (V,)."""
    areas = vertex_areas(mesh)
    shares = (np.arange(1000) + 0.5) / 1000
    quantiles = []
    for values in (f, g):
        order = np.argsort(values, kind="stable")
        quantiles.append(np.interp(shares, np.cumsum(areas[order]) / areas.sum(), values[order]))
    return float(np.abs(quantiles[0] - quantiles[1]).mean())
