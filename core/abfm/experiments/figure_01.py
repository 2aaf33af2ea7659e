"""Figures 1 and 3: matches of a Gaussian to two distant Gaussians."""

from collections.abc import Iterator

import numpy as np

from abfm import Flow, Match, Parameters, Problem, TriangleMesh, function
from abfm.baselines import linear_blend, optimal_transport
from abfm.calculus import geodesic_distance, vertex_areas
from abfm.experiments import scripts
from abfm.experiments.scripts import Example, FigureSetup, Findings, Measure, RequestedMatch, Script
from abfm.io.sheets import Panel, Sheet, Streaks, Values
from abfm.matching.path import as_stored
from abfm.mesh.shapes import three_arms
from abfm.parameters import TABLE_1
from abfm.types import FloatArray

_TIMES = np.linspace(0, 1, 13)  # relative to tau
_SHOWN_TIMES = [2, 4, 6, 8, 10]  # indices into _TIMES
_MISMATCH_MAX = 0.05
_TARGET_WIDTH = 0.2  # relative to the distance between the source and the closer target


def figure_1(setup: FigureSetup) -> Script:
    """Match a Gaussian to two distant ones on a body, by default from a hand to the feet."""
    name, make = (
        "human_A.off after a Loop subdivision",
        lambda: scripts.loop_subdivided("human_A.off", 1),
    )
    if setup.small:
        name, make = "human_A.off", lambda: scripts.bundled("human_A.off")
    mesh, name = setup.surface(name, make)
    parameters = TABLE_1[1].parameters(iterations=100 if setup.small else 300)
    return match_one_to_two(setup, mesh, name, parameters, distant_vertices(mesh))


def figure_3(setup: FigureSetup) -> Script:
    """Match a Gaussian to two distant ones, by default from a thick arm to two thin arms."""
    mesh, name, ends = setup.mesh, setup.name, None
    if mesh is None:
        (mesh, ends), name = three_arms(3 if setup.small else 5), "body with three arms"
    parameters = TABLE_1[3].parameters(iterations=60 if setup.small else 150)
    return match_one_to_two(setup, mesh, name, parameters, ends or distant_vertices(mesh))


def match_one_to_two(
    setup: FigureSetup, mesh: TriangleMesh, name: str, p: Parameters, ends: tuple[int, ...]
) -> Script:
    """Match a Gaussian at the first vertex of ``ends`` to two of equal total mass at the others."""
    centre, *targets = ends
    areas = vertex_areas(mesh)
    from_source, *from_targets = (
        geodesic_distance(mesh, [end]) / mesh.length_scale for end in ends
    )
    distance = float(from_source[targets].min())
    width = round(_TARGET_WIDTH * distance, 4)

    def mass(distances: FloatArray, width: float) -> float:
        return float(areas @ np.exp(-0.5 * (distances / width) ** 2))

    widths = width * np.geomspace(0.25, 8, 200)
    both = sum(mass(distances, width) for distances in from_targets)
    source_width = round(float(np.interp(both, [mass(from_source, w) for w in widths], widths)), 4)
    source = scripts.gaussian(mesh, centre, source_width)
    target = " + ".join(scripts.gaussian(mesh, vertex, width) for vertex in targets)
    f, g = function(mesh, source), function(mesh, target)
    problem = Problem(mesh, f, g, p)
    yield Example(problem, name, ((source, target),))

    [found] = yield [RequestedMatch(problem, share=0.7)]
    path = found.advect(_TIMES * p.tau)
    setup.report("verifying", 0.7)
    verification, notes, missing = scripts.verification_measures(found)
    setup.report("optimal transport", 0.8)
    between = _TIMES[_SHOWN_TIMES]
    methods = {
        "advection": path[_SHOWN_TIMES],
        "optimal transport": optimal_transport(mesh, f, g, between, blur=0.5 * width),
        "linear blend": np.stack([linear_blend(f, g, t) for t in between]),
    }

    error, high, low = found.mismatch, max(f.max(), g.max()), min(f.min(), g.min())
    overshoot = max(path.max() - high, low - path.min(), 0.0) / (high - low)
    masses = path @ areas
    at_tau = [float(areas @ f) for f in advected_by_stage(found)]
    drifts = [abs(mass / masses[0] - 1) for mass in at_tau]
    of_mismatch = "mismatch at tau, relative to the target in L2"
    matches = "the advected source matches the target"
    of_range = "largest over- or undershoot until tau, as a share of the functions' range"
    drift, drift_claim = "drift of the mass at tau", "a small sigma keeps the drift small"
    measures = [
        Measure(of_mismatch, error, matches, error <= _MISMATCH_MAX, _MISMATCH_MAX),
        *verification,
        Measure(of_range, overshoot, "there is no maximum principle", overshoot > 0),
    ]
    if len(drifts) > 1:
        first, last = (f"{drift}, with the {which} stage's sigma" for which in ("first", "last"))
        measures.append(Measure(first, drifts[0]))
        measures.append(Measure(last, drifts[-1], drift_claim, drifts[-1] < drifts[0]))
    else:
        measures.append(Measure(drift, drifts[0]))
    drift_max = abs(masses / masses[0] - 1).max()
    measures.append(Measure("largest drift of the mass until tau", drift_max))

    def deviation(values: FloatArray) -> float:
        mass = areas * np.maximum(values, 0)  # undershoots have no mass
        mass /= mass.sum()
        return float(np.sqrt(mass @ (from_source - mass @ from_source) ** 2))

    # Between source and target, an advected bump keeps its height, but a linear blend is low.
    shaded = np.maximum(f, g) < 0.5 * high
    heights = {method: h[:, shaded].max(initial=0.0) / high for method, h in methods.items()}
    spreads = {method: deviation(h[len(h) // 2]) / distance for method, h in methods.items()}
    deviates = "(standard deviation of its distance from the source)"
    for measure_name, numbers, sign in (
        ("largest value shown where source and target are below half", heights, -1),
        (f"spread of the mass at tau/2 {deviates}, relative to the distance", spreads, 1),
    ):
        moves = sign * numbers["advection"] < sign * numbers["linear blend"]
        for method, x in numbers.items():
            claimed = ("values are displaced in space", moves) if method == "advection" else ()
            measures.append(Measure(f"{method}: {measure_name}", x, *claimed))

    panels = (
        Panel(mesh, Values(f), "source", "source"),
        Panel(mesh, Values(g), "target", "target"),
        Panel(mesh, Streaks(found.velocity[0]), "vector field", "field"),
        Panel(mesh, Values(path[-1]), "matched", "result"),
    )
    rows = [
        tuple(Panel(mesh, Values(h), f"{method}, {s}/6 τ") for s, h in enumerate(values, 1))
        for method, values in methods.items()
    ]
    setting = (
        f"{scripts.size_text(name, mesh)}: a Gaussian and two others of the same total mass, "
        f"{distance:.2f} sqrt(area) away; {p.solver.iterations} iterations, sigma "
        f"{', '.join(format(sigma, 'g') for sigma in p.stage_sigmas())}.{missing}"
    )
    return Findings(measures, Sheet((panels, *rows), notes=notes), setting)


def advected_by_stage(found: Match) -> Iterator[FloatArray]:
    """Yield the source (V,), advected until tau along the field of each stage of sigma.

    All fields except the last one are rounded as in result files, so that stored and new matches
    give equal numbers.
    """
    for step in found.path[:-1]:
        field = as_stored(step.velocity, found.mesh)
        yield Flow(found.mesh, field, found.parameters.tau).push(found.source[:, 0])
    yield found.advected[:, 0]


def distant_vertices(mesh: TriangleMesh) -> tuple[int, ...]:
    """Return three distant vertices by farthest point sampling, the closest two last."""
    ends = [int(geodesic_distance(mesh, [0]).argmax())]
    distances = [geodesic_distance(mesh, ends)]
    for _ in range(2):
        ends.append(int(np.min(distances, axis=0).argmax()))
        distances.append(geodesic_distance(mesh, ends[-1:]))
    first = min(range(3), key=lambda i: distances[(i + 1) % 3][ends[(i + 2) % 3]])
    return (ends[first], *(end for end in ends if end != ends[first]))
