"""One Gaussian becomes two at the other end of the surface: what figures 1 and 3 share."""

from dataclasses import dataclass

import numpy as np

from abfm.baselines import linear_blend, optimal_transport
from abfm.calculus.geodesics import geodesic_distance
from abfm.calculus.operators import vertex_areas
from abfm.experiments.experiment import Findings, Measure, Report, Setup
from abfm.experiments.sheet import Panel, Sheet, Streaks, Values
from abfm.experiments.witnesses import Witnessed, witnessed
from abfm.matching.match import Iteration, match
from abfm.matching.result import Match
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray

_WAY = np.linspace(0, 1, 13)
_SHOWN = [2, 4, 6, 8, 10]  # of these times
_BOUND = 0.05
_WIDTH = 0.2  # of the targets, as a fraction of the distance between the source and the nearer of them


@dataclass(frozen=True, eq=False, kw_only=True)
class OneToTwo(Setup):
    """One Gaussian of the mass of two others, far away.

    Attributes
    ----------
    centre : int
        Vertex of the source.
    way : float
        Geodesic distance from it to the nearer target, as a fraction of sqrt(area).
    width : float
        Of the targets, in the same unit.
    """

    centre: int
    way: float
    width: float


def one_to_two(
    mesh: TriangleMesh, name: str, parameters: Parameters, places: tuple[int, int, int] | None = None
) -> OneToTwo:
    """Gaussians at three places, the source as wide as gives it the targets' mass.

    Places are the vertices of the source and the two targets: by default far ends by farthest point sampling, of which
    the two that are closest to each other are the targets.
    """
    centre, *targets = places or _far_ends(mesh)
    distances = geodesic_distance(mesh, [centre])
    way = float(distances[targets].min()) / mesh.length_scale
    wide = round(_WIDTH * way, 4)
    areas, lengths = vertex_areas(mesh), mesh.length_scale
    mass = sum(areas @ _gaussian(geodesic_distance(mesh, [target]) / lengths, wide) for target in targets)
    widths = wide * np.geomspace(0.25, 8, 200)
    masses = [areas @ _gaussian(distances / lengths, width) for width in widths]
    source = round(float(np.interp(mass, masses, widths)), 4)
    return OneToTwo(
        mesh=mesh,
        name=name,
        sources=(_spec(mesh, centre, source),),
        targets=(" + ".join(_spec(mesh, target, wide) for target in targets),),
        parameters=parameters,
        centre=centre,
        way=way,
        width=wide,
    )


def run(setup: OneToTwo, report: Report) -> Findings:
    """Match, follow and verify the flow, and do the same with optimal transport and the linear blend."""
    mesh, p, areas = setup.mesh, setup.parameters, vertex_areas(setup.mesh)
    masses_at_tau: dict[int, float] = {}  # of each stage, in the end

    def on_iteration(now: Iteration) -> None:
        masses_at_tau[now.stage] = float(areas @ now.advected[:, 0])
        report("matching", 0.7 * now.iteration / max(p.iterations, 1))

    found = match(mesh, setup.source, setup.target, p, on_iteration=on_iteration)
    f, g = found.source[:, 0], found.target[:, 0]
    flow = found.advect(_WAY * p.tau)[..., 0]
    report("verifying", 0.7)
    witnesses = witnessed(found)
    report("optimal transport", 0.8)
    ways = {
        "advection": flow[_SHOWN],
        "optimal transport": optimal_transport(mesh, f, g, _WAY[_SHOWN], blur=0.5 * setup.width),
        "linear blend": np.stack([linear_blend(f, g, t) for t in _WAY[_SHOWN]]),
    }
    measures = [*_quality(found, witnesses, flow, list(masses_at_tau.values())), *_movement(setup, f, g, ways)]
    rows = [
        tuple(Panel(mesh, Values(value), f"{name}, {s}/6 τ") for s, value in enumerate(values, 1))
        for name, values in ways.items()
    ]
    first = (
        Panel(mesh, Values(f), "source", "source"),
        Panel(mesh, Values(g), "target", "target"),
        Panel(mesh, Streaks(found.velocity[0]), "vector field", "field"),
        Panel(mesh, Values(flow[-1]), witnesses.label, "result"),
    )
    setting = (
        f"{setup.where}: a Gaussian and two others of the same mass in all, "
        f"{setup.way:.2f} sqrt(area) away; {p.iterations} iterations, sigma "
        f"{', '.join(format(sigma, 'g') for sigma in p.stage_sigmas())}.{witnesses.note}"
    )
    return Findings(measures, Sheet((first, *rows)), setting)


def _quality(found: Match, witnesses: Witnessed, flow: FloatArray, at_tau: list[float]) -> list[Measure]:
    """How well the target is matched, and what the discrete advection does to a function's range and mass."""
    low, high = (extreme([extreme(found.source), extreme(found.target)]) for extreme in (np.min, np.max))
    overshoot = max(flow.max() - high, low - flow.min(), 0.0) / (high - low)
    masses = flow @ vertex_areas(found.mesh)
    drifts = [abs(mass / masses[0] - 1) for mass in at_tau]
    drift, error, matches = "drift of the mass at tau", found.mismatch, "the advected source matches the target"
    beyond = "largest over- or undershoot on the way, as a share of the functions' range"
    measures = [
        Measure("mismatch at tau, relative to the target in L2", error, matches, error <= _BOUND, _BOUND),
        *witnesses.measures,
        Measure(beyond, overshoot, "there is no maximum principle", overshoot > 0),
    ]
    if len(drifts) > 1:
        claim = "a small sigma keeps the drift small"
        measures += [
            Measure(f"{drift}, with the first stage's sigma", drifts[0]),
            Measure(f"{drift}, with the last stage's sigma", drifts[-1], claim, drifts[-1] < drifts[0]),
        ]
    else:
        measures.append(Measure(drift, drifts[0]))
    return [*measures, Measure("largest drift of the mass on the way", abs(masses / masses[0] - 1).max())]


def _movement(setup: OneToTwo, f: FloatArray, g: FloatArray, ways: dict[str, FloatArray]) -> list[Measure]:
    """Whether mass goes through the surface, or fades out here and in there."""
    areas, top = vertex_areas(setup.mesh), max(f.max(), g.max())
    between = np.maximum(f, g) < 0.5 * top
    distances = geodesic_distance(setup.mesh, [setup.centre]) / setup.mesh.length_scale
    heights = {name: values[:, between].max(initial=0.0) / top for name, values in ways.items()}
    spreads = {
        name: _deviation(areas, distances, values[len(values) // 2]) / setup.way for name, values in ways.items()
    }
    measures = []
    for what, sign, numbers in (
        ("largest value shown where source and target are below half", -1, heights),
        ("spread of the mass at tau/2 (deviation of its distance from the source), as a share of the way", 1, spreads),
    ):
        moves = sign * numbers["advection"] < sign * numbers["linear blend"]
        said = {"advection": ("values are displaced in space", bool(moves))}
        measures += [Measure(f"{name}: {what}", value, *said.get(name, ("", None))) for name, value in numbers.items()]
    return measures


def _deviation(areas: FloatArray, distances: FloatArray, values: FloatArray) -> float:
    """Of a distance over the mass; undershoots count as none."""
    mass = areas * np.maximum(values, 0)
    mass /= mass.sum()
    return float(np.sqrt(mass @ (distances - mass @ distances) ** 2))


def _gaussian(distances: FloatArray, width: float) -> FloatArray:
    return np.exp(-0.5 * (distances / width) ** 2)


def _spec(mesh: TriangleMesh, vertex: int, width: float) -> str:
    return f"gaussian:vertex={mesh.vertex_ids[vertex]},width={width:g}"


def _far_ends(mesh: TriangleMesh) -> tuple[int, ...]:
    """A source and two targets, three far ends by farthest point sampling."""
    places = [int(geodesic_distance(mesh, [0]).argmax())]
    distances = [geodesic_distance(mesh, places)]
    for _ in range(2):
        places.append(int(np.min(distances, axis=0).argmax()))
        distances.append(geodesic_distance(mesh, places[-1:]))
    source = min(range(3), key=lambda i: distances[(i + 1) % 3][places[(i + 2) % 3]])
    return (places[source], *(place for place in places if place != places[source]))
