"""Figure 2: a function advected along a field, against explicit flow lines."""

import numpy as np

from abfm import Flow, TriangleMesh
from abfm.calculus import l2_norm
from abfm.experiments import fields
from abfm.experiments import vocabulary as words
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage
from abfm.flow import flow_lines
from abfm.io.sheets import Curve, Panel, Plot, Sheet, Streaks, Values
from abfm.maps import project_onto_surface
from abfm.mesh.shapes import sphere
from abfm.types import FloatArray, IntArray

CLAIM = "The flow map of a vector field advects a function, without explicit flow lines."
FUNCTION, MAP = "function", "point map"

_MODES = {3: 1.0, 4: 1.0, 6: 0.5}
_WAY = 0.2  # root mean square over the surface, in sqrt(area)
_TIMES = np.arange(1, 9) / 8  # of tau, which is 1
_LINES = 24
# what "advects" is taken for: this difference at tau, and this order under refinement
_CLOSE, _ORDER = 0.05, 1.0


def figure(stage: Stage) -> Script:
    """Advect an eigenfunction, and follow the flow lines; again on finer and finer spheres."""
    mesh, name = (
        stage.surface("eight.off, Loop subdivided", words.smoothed, "eight.off", 1)
        if stage.small
        else stage.surface("fandisk.off", words.bundled, "fandisk.off")
    )
    flow = Flow(mesh, fields.stream_field(mesh, _MODES, _WAY))
    example = words.carried_example(flow, name, "eigenfunction:8", "file:advected.npy")
    yield example

    stage.report("flow lines", 0.0)
    f = example.problem.source[:, 0]
    here = differences(flow, f, _TIMES)
    stage.report("flow lines on spheres", 0.4)
    balls = [sphere(level) for level in ((2, 3) if stage.small else (3, 4, 5))]
    shears = [Flow(ball, shear(ball)) for ball in balls]
    there = [differences(each, bump(each.mesh.vertices), _TIMES) for each in shears]
    stage.report("flow lines", 0.95)

    against = "advected function against flow lines"
    quarter, half, whole = here[FUNCTION][[1, 3, 7]]
    of_map = "point map against flow lines at tau, root mean square, in sqrt(area)"
    claim = "the flow map of a vector field is used to advect a function"
    measures = [
        Measure(f"{against} at t = 0.25 tau, relative L2", quarter),
        Measure(f"{against} at t = 0.5 tau, relative L2", half),
        Measure(f"{against} at t = 1 tau, relative L2", whole, claim, whole <= _CLOSE),
        Measure(of_map, here[MAP][-1]),
    ]
    for ball, each, along in zip(balls, there, shears, strict=True):
        came = bump(sheared_back(ball.vertices, 1.0))
        error = fields.relative_difference(ball, along.push(bump(ball.vertices)), came)
        name_of = f"sphere of {len(ball.vertices):,} vertices"
        measures += [
            Measure(f"{name_of}: {against}, relative L2", each[FUNCTION][-1]),
            Measure(f"{name_of}: advected function against the exact solution, relative L2", error),
            Measure(f"{name_of}: point map against flow lines, in sqrt(area)", each[MAP][-1]),
        ]
    for what in (FUNCTION, MAP):
        order = np.log2(there[-2][what][-1] / there[-1][what][-1])
        text = (
            f"order in the edge length in which the difference of the {what} falls between the "
            "finest spheres"
        )
        measures.append(Measure(text, order, "tends to the flow under refinement", order >= _ORDER))

    starts = project_onto_surface(mesh, mesh.vertices[spread(mesh, _LINES)])
    lines = tuple(line.positions for line in flow_lines(mesh, flow.velocity[0], starts, flow.tau))
    halfway, end = flow.push(f, [flow.tau / 2, flow.tau])
    panels = (
        Panel(mesh, Streaks(flow.velocity[0]), "field", "field"),
        Panel(mesh, Values(f), "function", "source"),
        Panel(mesh, Values(halfway), "t = τ/2"),
        Panel(mesh, Values(end), "t = τ, flow lines", lines=lines),
    )

    def plot(what: str, axis: str, label: str) -> Plot:
        on_balls = (
            Curve(f"sphere, {len(ball.vertices):,} vertices", _TIMES, each[what], faint=True)
            for ball, each in zip(balls, there, strict=True)
        )
        curves = (Curve("this surface", _TIMES, here[what]), *on_balls)
        return Plot(curves, "t / τ", axis, label, log_y=True)

    plots = (
        plot(FUNCTION, "difference, relative L2", against),
        plot(MAP, "difference, sqrt(area)", "point map against flow lines"),
    )
    setting = (
        f"{words.sized(name, mesh)}; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} carries eigenfunction 8 on average {_WAY:g} sqrt(area) "
        "far. On spheres a shear flow about an axis, whose speed of rotation grows with the height."
    )
    return Findings(measures, Sheet((panels, plots)), setting)


def differences(flow: Flow, f: FloatArray, times: FloatArray) -> dict[str, FloatArray]:
    """Compare a function, in relative L2, and the map, in sqrt(area), with flow lines, (T,)."""
    mesh = flow.mesh
    places = fields.feet(mesh, flow.velocity[0], times)
    functions = zip(flow.push(f, times), fields.carried(mesh, places, f), strict=True)
    maps = zip(flow.push(mesh.vertices, times), places, strict=True)
    off = [fields.relative_difference(mesh, h, walked) for h, walked in functions]
    apart = [
        l2_norm(mesh, project_onto_surface(mesh, points).positions - walked)
        for points, walked in maps
    ]
    return {
        FUNCTION: np.array(off),
        MAP: np.array(apart) / mesh.length_scale**2,  # root mean square
    }


def spread(mesh: TriangleMesh, count: int) -> IntArray:
    """Choose vertices far from each other through space, (count,)."""
    chosen = [int(np.argmax(((mesh.vertices - mesh.vertices.mean(axis=0)) ** 2).sum(axis=1)))]
    nearest = np.full(len(mesh.vertices), np.inf)
    while len(chosen) < count:
        squares = ((mesh.vertices - mesh.vertices[chosen[-1]]) ** 2).sum(axis=1)
        nearest = np.minimum(nearest, squares)
        chosen.append(int(np.argmax(nearest)))
    return np.array(chosen)


def shear(ball: TriangleMesh) -> FloatArray:
    """Rotate the unit sphere about z with angular velocity 1 + z, (F, 3)."""
    z = ball.vertices[:, 2]
    return fields.slopes(ball, -(z + z**2 / 2), turned=True)


def sheared_back(points: FloatArray, t: float) -> FloatArray:
    """Find where the shear's flow lines through points (P, 3) of the sphere come from."""
    x, y, z = points.T
    cosine, sine = np.cos((1 + z) * t), np.sin((1 + z) * t)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def bump(points: FloatArray) -> FloatArray:
    """Evaluate a bump on the sphere at points (P, 3)."""
    return np.asarray(np.exp(4 * (points @ [0.8, 0.0, 0.6] - 1)))
