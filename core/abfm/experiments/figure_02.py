"""Figure 2: a function advected along a field, against explicit flow lines."""

from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import l2_norm
from abfm.experiments.experiment import Experiment, Findings, Measure, Report
from abfm.experiments.given_flow import GivenFlow, carried, feet, relative_difference, stream_field, turned_gradient
from abfm.experiments.meshes import bundled, smoothed, sphere
from abfm.experiments.sheet import Curve, Panel, Plot, Sheet, Streaks, Values
from abfm.flow.flow import Flow
from abfm.flow.flow_lines import flow_lines
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_MODES = {3: 1.0, 4: 1.0, 6: 0.5}
_WAY = 0.2  # root mean square over the surface, in sqrt(area)
_TIMES = np.arange(1, 9) / 8  # of tau, which is 1
_LINES = 24
_CLOSE, _ORDER = 0.05, 1.0  # what "advects" is taken for: this difference at tau, and this order under refinement
FUNCTION, MAP = "function", "point map"
Differences = dict[str, FloatArray]
"""Of advection from flow lines at several times (T,), both relative: of a function in L2, of the map in sqrt(area)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FlowSetup(GivenFlow):
    """The flow, and spheres to refine: `spheres` (numbers of subdivisions, coarse to fine)."""

    spheres: tuple[int, ...]


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> FlowSetup:
    """A smooth field without divergence, and an eigenfunction that it carries away."""
    name = "mesh" if mesh else "eight.off, Loop subdivided" if small else "fandisk.off"
    mesh = mesh or (smoothed("eight.off", 1) if small else bundled(name))
    flow = Flow(mesh, stream_field(mesh, _MODES, _WAY))
    return FlowSetup.of(flow, name, "eigenfunction:8", spheres=(2, 3) if small else (3, 4, 5))


def run(setup: FlowSetup, report: Report) -> Findings:
    """Advect, walk the flow lines through all vertices backwards, and compare; again on finer and finer spheres."""
    mesh, flow, f = setup.mesh, setup.flow, setup.source[:, 0]
    report("flow lines", 0.0)
    here = differences(flow, f, _TIMES)
    there, exact = {}, []
    for share, level in enumerate(setup.spheres):
        report("flow lines on spheres", 0.4 + 0.5 * share / len(setup.spheres))
        ball = sphere(level)
        bump, shear = _bump(ball.vertices), Flow(ball, _shear(ball))
        there[f"sphere{{}} {len(ball.vertices):,} vertices"] = differences(shear, bump, _TIMES)
        exact.append(relative_difference(ball, shear.advect(bump), _bump(_sheared_back(ball.vertices, 1.0))))
    report("flow lines", 0.95)

    starts = project_onto_surface(mesh, mesh.vertices[_spread(mesh, _LINES)])
    lines = flow_lines(mesh, flow.velocity[0], starts, flow.tau)
    halfway, end = flow.push(f, [flow.tau / 2, flow.tau])
    panels = (
        Panel(mesh, Streaks(flow.velocity[0]), "field", "field"),
        Panel(mesh, Values(f), "function", "source"),
        Panel(mesh, Values(halfway), "t = τ/2"),
        Panel(mesh, Values(end), "t = τ, flow lines", lines=tuple(line.positions for line in lines)),
    )
    plots = (
        _plot(FUNCTION, "difference, relative L2", "advected function against flow lines", here, there),
        _plot(MAP, "difference, sqrt(area)", "point map against flow lines", here, there),
    )
    setting = (
        f"{setup.where}; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} carries eigenfunction 8 on average {_WAY:g} sqrt(area) far. On spheres a shear "
        "flow about an axis, whose speed of rotation grows with the height."
    )
    return Findings(_measures(here, there, exact), Sheet((panels, plots)), setting)


def differences(flow: Flow, f: FloatArray, times: FloatArray) -> Differences:
    """Compare ``exp(-t D_v) f`` (V,) and the point maps at times (T,) with the flow lines that end in the vertices."""
    mesh = flow.mesh
    places = feet(mesh, flow.velocity[0], times)
    functions = zip(flow.push(f, times), carried(mesh, places, f), strict=True)
    maps = zip(flow.push(mesh.vertices, times), places, strict=True)
    apart = [l2_norm(mesh, project_onto_surface(mesh, points).positions - walked) for points, walked in maps]
    return {
        FUNCTION: np.array([relative_difference(mesh, advected, walked) for advected, walked in functions]),
        MAP: np.array(apart) / mesh.length_scale**2,  # root mean square
    }


def _measures(here: Differences, there: dict[str, Differences], exact: list[float]) -> list[Measure]:
    name = "advected function against flow lines at t = {:g} tau, relative L2"
    quarter, half, whole = here[FUNCTION][[1, 3, 7]]
    claim = "the flow map of a vector field is used to advect a function"
    found = [
        Measure(name.format(0.25), quarter),
        Measure(name.format(0.5), half),
        Measure(name.format(1), whole, claim, whole <= _CLOSE),
        Measure("point map against flow lines at tau, root mean square, in sqrt(area)", here[MAP][-1]),
    ]
    for (ball, each), error in zip(there.items(), exact, strict=True):
        ball = ball.format(" of")
        found += [
            Measure(f"{ball}: advected function against flow lines, relative L2", each[FUNCTION][-1]),
            Measure(f"{ball}: advected function against the exact solution, relative L2", error),
            Measure(f"{ball}: point map against flow lines, in sqrt(area)", each[MAP][-1]),
        ]
    for what in (FUNCTION, MAP):
        *_, coarse, fine = (each[what][-1] for each in there.values())
        order = np.log2(coarse / fine)
        text = f"order in the edge length in which the difference of the {what} falls between the finest spheres"
        found.append(Measure(text, order, "tends to the flow under refinement", order >= _ORDER))
    return found


def _plot(what: str, y_title: str, label: str, here: Differences, there: dict[str, Differences]) -> Plot:
    spheres = (Curve(ball.format(","), _TIMES, each[what], faint=True) for ball, each in there.items())
    return Plot((Curve("this surface", _TIMES, here[what]), *spheres), "t / τ", y_title, label, log_y=True)


def _spread(mesh: TriangleMesh, count: int) -> IntArray:
    """Vertices far from each other through space, (count,)."""
    chosen = [int(np.argmax(((mesh.vertices - mesh.vertices.mean(axis=0)) ** 2).sum(axis=1)))]
    nearest = np.full(len(mesh.vertices), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, ((mesh.vertices - mesh.vertices[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(nearest)))
    return np.array(chosen)


def _shear(ball: TriangleMesh) -> FloatArray:
    """The unit sphere's rotation about z with angular velocity 1 + z: rotated gradient of -(z + z^2 / 2), (F, 3)."""
    z = ball.vertices[:, 2]
    return turned_gradient(ball, -(z + z**2 / 2))


def _sheared_back(points: FloatArray, t: float) -> FloatArray:
    """Where the shear's flow lines through points (P, 3) of the sphere come from."""
    x, y, z = points.T
    cosine, sine = np.cos((1 + z) * t), np.sin((1 + z) * t)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def _bump(points: FloatArray) -> FloatArray:
    return np.asarray(np.exp(4 * (points @ [0.8, 0.0, 0.6] - 1)))


EXPERIMENT = Experiment(
    2, "The flow map of a vector field advects a function, without explicit flow lines.", set_up, run
)
