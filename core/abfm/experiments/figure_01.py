"""Figures 1 and 3: a single field carries a Gaussian to two at the other end of a body."""

from collections.abc import Iterator

import numpy as np

from abfm import Flow, Match, Parameters, Problem, TriangleMesh, function
from abfm.baselines import linear_blend, optimal_transport
from abfm.calculus import geodesic_distance, vertex_areas
from abfm.experiments import vocabulary as words
from abfm.experiments.vocabulary import (
    Example,
    Findings,
    Measure,
    Script,
    Sought,
    Stage,
    gaussian,
)
from abfm.io.sheets import Panel, Sheet, Streaks, Values
from abfm.matching.path import as_stored
from abfm.mesh.shapes import three_arms
from abfm.parameters import TABLE_1
from abfm.types import FloatArray

_TIMES = np.linspace(0, 1, 13)  # of tau
_SHOWN_TIMES = [2, 4, 6, 8, 10]  # of these times
_BOUND = 0.05  # of the mismatch
_WIDTH = 0.2  # of the targets, as a share of the distance from the source to the nearer of them


def figure_1(stage: Stage) -> Script:
    """Match Gaussians at far ends of a body, by default a human's hand and feet."""
    name, make = "human_A.off after a Loop subdivision", lambda: words.smoothed("human_A.off", 1)
    if stage.small:
        name, make = "human_A.off", lambda: words.bundled("human_A.off")
    mesh, name = stage.surface(name, make)
    parameters = TABLE_1[1].parameters(iterations=100 if stage.small else 300)
    return one_to_two(stage, mesh, name, parameters, far_ends(mesh))


def figure_3(stage: Stage) -> Script:
    """Match Gaussians at far ends, by default of a body with one thick arm and two thin ones."""
    mesh, name, ends = stage.mesh, stage.name, None
    if mesh is None:
        (mesh, ends), name = three_arms(3 if stage.small else 5), "body with three arms"
    parameters = TABLE_1[3].parameters(iterations=60 if stage.small else 150)
    return one_to_two(stage, mesh, name, parameters, ends or far_ends(mesh))


def one_to_two(
    stage: Stage, mesh: TriangleMesh, name: str, p: Parameters, ends: tuple[int, ...]
) -> Script:
    """Match a Gaussian at the first of three vertices to two at the others, of the same mass."""
    centre, *targets = ends
    areas = vertex_areas(mesh)
    far, *near = (geodesic_distance(mesh, [end]) / mesh.length_scale for end in ends)
    distance = float(far[targets].min())
    width = round(_WIDTH * distance, 4)

    def mass(distances: FloatArray, width: float) -> float:
        return float(areas @ np.exp(-0.5 * (distances / width) ** 2))

    widths = width * np.geomspace(0.25, 8, 200)
    both = sum(mass(distances, width) for distances in near)
    wide = round(float(np.interp(both, [mass(far, w) for w in widths], widths)), 4)
    source = gaussian(mesh, centre, wide)
    target = " + ".join(gaussian(mesh, vertex, width) for vertex in targets)
    f, g = function(mesh, source), function(mesh, target)
    problem = Problem(mesh, f, g, p)
    yield Example(problem, name, ((source, target),))

    [found] = yield [Sought(problem, share=0.7)]
    path = found.advect(_TIMES * p.tau)
    stage.report("verifying", 0.7)
    witnesses, label, note = words.witnessed(found)
    stage.report("optimal transport", 0.8)
    between = _TIMES[_SHOWN_TIMES]
    ways = {
        "advection": path[_SHOWN_TIMES],
        "optimal transport": optimal_transport(mesh, f, g, between, blur=0.5 * width),
        "linear blend": np.stack([linear_blend(f, g, t) for t in between]),
    }

    error, high, low = found.mismatch, max(f.max(), g.max()), min(f.min(), g.min())
    overshoot = max(path.max() - high, low - path.min(), 0.0) / (high - low)
    masses = path @ areas
    at_tau = [float(areas @ f) for f in ends_of_stages(found)]
    drifts = [abs(mass / masses[0] - 1) for mass in at_tau]
    of_mismatch = "mismatch at tau, relative to the target in L2"
    matches = "the advected source matches the target"
    of_range = "largest over- or undershoot on the way, as a share of the functions' range"
    drift, keeps = "drift of the mass at tau", "a small sigma keeps the drift small"
    measures = [
        Measure(of_mismatch, error, matches, error <= _BOUND, _BOUND),
        *witnesses,
        Measure(of_range, overshoot, "there is no maximum principle", overshoot > 0),
    ]
    if len(drifts) > 1:
        first, last = (f"{drift}, with the {which} stage's sigma" for which in ("first", "last"))
        measures.append(Measure(first, drifts[0]))
        measures.append(Measure(last, drifts[-1], keeps, drifts[-1] < drifts[0]))
    else:
        measures.append(Measure(drift, drifts[0]))
    most = abs(masses / masses[0] - 1).max()
    measures.append(Measure("largest drift of the mass on the way", most))

    def deviation(values: FloatArray) -> float:
        mass = areas * np.maximum(values, 0)  # undershoots count as none
        mass /= mass.sum()
        return float(np.sqrt(mass @ (far - mass @ far) ** 2))

    # whether mass goes through the surface, or fades out here and in there
    shaded = np.maximum(f, g) < 0.5 * high
    heights = {way: h[:, shaded].max(initial=0.0) / high for way, h in ways.items()}
    spreads = {way: deviation(h[len(h) // 2]) / distance for way, h in ways.items()}
    deviates = "(deviation of its distance from the source)"
    for what, numbers, sign in (
        ("largest value shown where source and target are below half", heights, -1),
        (f"spread of the mass at tau/2 {deviates}, as a share of the way", spreads, 1),
    ):
        moves = sign * numbers["advection"] < sign * numbers["linear blend"]
        for way, x in numbers.items():
            claimed = ("values are displaced in space", moves) if way == "advection" else ()
            measures.append(Measure(f"{way}: {what}", x, *claimed))

    panels = (
        Panel(mesh, Values(f), "source", "source"),
        Panel(mesh, Values(g), "target", "target"),
        Panel(mesh, Streaks(found.velocity[0]), "vector field", "field"),
        Panel(mesh, Values(path[-1]), label, "result"),
    )
    rows = [
        tuple(Panel(mesh, Values(h), f"{way}, {s}/6 τ") for s, h in enumerate(values, 1))
        for way, values in ways.items()
    ]
    setting = (
        f"{words.sized(name, mesh)}: a Gaussian and two others of the same mass in all, "
        f"{distance:.2f} sqrt(area) away; {p.solver.iterations} iterations, sigma "
        f"{', '.join(format(sigma, 'g') for sigma in p.stage_sigmas())}.{note}"
    )
    return Findings(measures, Sheet((panels, *rows)), setting)


def ends_of_stages(found: Match) -> Iterator[FloatArray]:
    """Yield what the source is at tau with the fields in the end of each stage, (V,): as files keep
    those before the last, so that it does not matter whether the match was in one.
    """
    for step in found.path[:-1]:
        field = as_stored(step.velocity, found.mesh)
        yield Flow(found.mesh, field, found.parameters.tau).push(found.source[:, 0])
    yield found.advected[:, 0]


def far_ends(mesh: TriangleMesh) -> tuple[int, ...]:
    """Find three far ends by farthest point sampling; the two that are closest come last."""
    ends = [int(geodesic_distance(mesh, [0]).argmax())]
    distances = [geodesic_distance(mesh, ends)]
    for _ in range(2):
        ends.append(int(np.min(distances, axis=0).argmax()))
        distances.append(geodesic_distance(mesh, ends[-1:]))
    first = min(range(3), key=lambda i: distances[(i + 1) % 3][ends[(i + 2) % 3]])
    return (ends[first], *(end for end in ends if end != ends[first]))
