"""Figure 1: a single field carries a Gaussian to two at the other end of a body."""

from collections.abc import Mapping

import numpy as np

from abfm import Iteration, Match, Parameters, Problem, TriangleMesh, function
from abfm.baselines import linear_blend, optimal_transport
from abfm.calculus import geodesic_distance, vertex_areas
from abfm.experiments import vocabulary as words
from abfm.experiments.vocabulary import Example, Findings, Measure, Script, Stage, gaussian
from abfm.io.sheets import Panel, Sheet, Streaks, Values
from abfm.parameters import TABLE_1
from abfm.types import FloatArray

CLAIM = (
    "A single vector field advects the source to a function that matches the target, and "
    "interpolates smoothly."
)

_TIMES = np.linspace(0, 1, 13)  # of tau
_SHOWN = [2, 4, 6, 8, 10]  # of these times
_BOUND = 0.05  # of the mismatch
_WIDTH = 0.2  # of the targets, as a share of the distance from the source to the nearer of them


def figure(stage: Stage) -> Script:
    """Gaussians at far ends of a body, by default a human's hand and feet."""
    body = "human_A.off"
    mesh, name = (
        stage.surface(body, words.bundled, body)
        if stage.small
        else stage.surface(f"{body} after a Loop subdivision", words.smoothed, body, 1)
    )
    parameters = TABLE_1[1].parameters(iterations=100 if stage.small else 300)
    return one_to_two(stage, mesh, name, parameters, far_ends(mesh))


def one_to_two(
    stage: Stage, mesh: TriangleMesh, name: str, p: Parameters, ends: tuple[int, ...]
) -> Script:
    """Match a Gaussian at the first of three vertices to two at the others, of the same mass."""
    centre, *targets = ends
    areas = vertex_areas(mesh)
    far = geodesic_distance(mesh, [centre]) / mesh.length_scale
    distance = float(far[targets].min())
    width = round(_WIDTH * distance, 4)

    def mass(distances: FloatArray, width: float) -> float:
        return float(areas @ np.exp(-0.5 * (distances / width) ** 2))

    masses = [mass(geodesic_distance(mesh, [v]) / mesh.length_scale, width) for v in targets]
    widths = width * np.geomspace(0.25, 8, 200)
    wide = round(float(np.interp(sum(masses), [mass(far, w) for w in widths], widths)), 4)
    source = gaussian(mesh, centre, wide)
    target = " + ".join(gaussian(mesh, vertex, width) for vertex in targets)
    f, g = function(mesh, source), function(mesh, target)
    problem = Problem(mesh, f, g, p)
    yield Example(problem, name, ((source, target),))

    at_tau: dict[int, float] = {}  # masses in the end of each stage

    def weigh(now: Iteration) -> None:
        at_tau[now.stage] = float(areas @ now.advected[:, 0])

    found = stage.match(problem, shares=(0.0, 0.7), on_iteration=weigh)
    path = found.advect(_TIMES * p.tau)
    stage.report("verifying", 0.7)
    witnesses, label, note = words.witnessed(found)
    stage.report("optimal transport", 0.8)
    between = _TIMES[_SHOWN]
    ways = {
        "advection": path[_SHOWN],
        "optimal transport": optimal_transport(mesh, f, g, between, blur=0.5 * width),
        "linear blend": np.stack([linear_blend(f, g, t) for t in between]),
    }
    top = max(f.max(), g.max())
    low = np.maximum(f, g) < 0.5 * top
    heights = {way: values[:, low].max(initial=0.0) / top for way, values in ways.items()}
    spreads = {
        way: deviation(areas, far, values[len(values) // 2]) / distance
        for way, values in ways.items()
    }
    high = "largest value shown where source and target are below half"
    spread = (
        "spread of the mass at tau/2 (deviation of its distance from the source), as a share of "
        "the way"
    )
    of_mismatch, error = "mismatch at tau, relative to the target in L2", found.mismatch
    matches = "the advected source matches the target"
    measures = [
        Measure(of_mismatch, error, matches, error <= _BOUND, _BOUND),
        *witnesses,
        *conserved(found, path, list(at_tau.values())),
        *moved(high, -1, heights),
        *moved(spread, 1, spreads),
    ]
    first = (
        Panel(mesh, Values(f), "source", "source"),
        Panel(mesh, Values(g), "target", "target"),
        Panel(mesh, Streaks(found.velocity[0]), "vector field", "field"),
        Panel(mesh, Values(path[-1]), label, "result"),
    )
    rows = [
        tuple(Panel(mesh, Values(value), f"{way}, {s}/6 τ") for s, value in enumerate(values, 1))
        for way, values in ways.items()
    ]
    sigmas = ", ".join(format(sigma, "g") for sigma in p.stage_sigmas())
    setting = (
        f"{words.sized(name, mesh)}: a Gaussian and two others of the same mass in all, "
        f"{distance:.2f} sqrt(area) away; {p.iterations} iterations, sigma {sigmas}.{note}"
    )
    return Findings(measures, Sheet((first, *rows)), setting)


def conserved(found: Match, path: FloatArray, at_tau: list[float]) -> list[Measure]:
    """Measure what the discrete advection does to a function's range and mass."""
    both = np.concatenate([found.source, found.target])
    low, high = both.min(), both.max()
    overshoot = max(path.max() - high, low - path.min(), 0.0) / (high - low)
    masses = path @ vertex_areas(found.mesh)
    drifts = [abs(mass / masses[0] - 1) for mass in at_tau]
    drift, keeps = "drift of the mass at tau", "a small sigma keeps the drift small"
    of_range = "largest over- or undershoot on the way, as a share of the functions' range"
    of_stages = [
        Measure(f"{drift}, with the first stage's sigma", drifts[0]),
        Measure(f"{drift}, with the last stage's sigma", drifts[-1], keeps, drifts[-1] < drifts[0]),
    ]
    return [
        Measure(of_range, overshoot, "there is no maximum principle", overshoot > 0),
        *(of_stages if len(at_tau) > 1 else [Measure(drift, drifts[0])]),
        Measure("largest drift of the mass on the way", abs(masses / masses[0] - 1).max()),
    ]


def moved(what: str, sign: int, numbers: Mapping[str, float]) -> list[Measure]:
    """Measure whether mass goes through the surface, or fades out here and in there."""
    moves = sign * numbers["advection"] < sign * numbers["linear blend"]
    claims = {"advection": ("values are displaced in space", bool(moves))}
    return [
        Measure(f"{way}: {what}", value, *claims.get(way, ("", None)))
        for way, value in numbers.items()
    ]


def deviation(areas: FloatArray, distances: FloatArray, values: FloatArray) -> float:
    """Return the deviation of a distance over the mass; undershoots count as none."""
    mass = areas * np.maximum(values, 0)
    mass /= mass.sum()
    return float(np.sqrt(mass @ (distances - mass @ distances) ** 2))


def far_ends(mesh: TriangleMesh) -> tuple[int, ...]:
    """Find three far ends by farthest point sampling; the two that are closest come last."""
    ends = [int(geodesic_distance(mesh, [0]).argmax())]
    distances = [geodesic_distance(mesh, ends)]
    for _ in range(2):
        ends.append(int(np.min(distances, axis=0).argmax()))
        distances.append(geodesic_distance(mesh, ends[-1:]))
    first = min(range(3), key=lambda i: distances[(i + 1) % 3][ends[(i + 2) % 3]])
    return (ends[first], *(end for end in ends if end != ends[first]))
