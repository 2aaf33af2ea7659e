"""Figure 2: a function advected along a field, against explicit flow lines."""

import numpy as np

from abfm import Flow
from abfm.calculus import l2_norm
from abfm.experiments import fields
from abfm.experiments import vocabulary as words
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage
from abfm.flow import flow_lines
from abfm.io.sheets import Curve, Panel, Plot, Sheet, Streaks, Values
from abfm.maps import project_onto_surface
from abfm.mesh.shapes import sphere
from abfm.types import FloatArray

FUNCTION = "function"
MAP = "point map"

_MODES = {3: 1.0, 4: 1.0, 6: 0.5}
_WAY = 0.2  # root mean square over the surface, in sqrt(area)
_TIMES = np.arange(1, 9) / 8  # of tau, which is 1
_LINES = 24
# what "advects" is taken for: this difference at tau, and this order under refinement
_DIFFERENCE_MAX = 0.05
_ORDER_MIN = 1.0


def figure_2(stage: Stage) -> Script:
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
    against = "advected function against flow lines"
    measures: list[Measure] = []
    there = {}
    for level in (2, 3) if stage.small else (3, 4, 5):
        ball = sphere(level)
        x, y, z = ball.vertices.T
        # rotates about z with angular velocity 1 + z, and so came from there within tau
        shear = Flow(ball, fields.slopes(ball, -(z + z**2 / 2), turned=True))
        cosine, sine = np.cos(1 + z), np.sin(1 + z)
        came = np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)
        before, after = (np.exp(4 * (p @ [0.8, 0.0, 0.6] - 1)) for p in (ball.vertices, came))
        size = f"{len(x):,} vertices"
        there[f"sphere, {size}"] = off = differences(shear, before, _TIMES)
        error = fields.relative_difference(ball, shear.push(before), after)
        exact = f"sphere of {size}: advected function"
        measures += [
            Measure(f"sphere of {size}: {against}, relative L2", off[FUNCTION][-1]),
            Measure(f"{exact} against the exact solution, relative L2", error),
            Measure(f"sphere of {size}: point map against flow lines, in sqrt(area)", off[MAP][-1]),
        ]
    stage.report("flow lines", 0.95)
    quarter, half, whole = here[FUNCTION][[1, 3, 7]]
    of_map = "point map against flow lines at tau, root mean square, in sqrt(area)"
    claim = "the flow map of a vector field is used to advect a function"
    measures[:0] = [
        Measure(f"{against} at t = 0.25 tau, relative L2", quarter),
        Measure(f"{against} at t = 0.5 tau, relative L2", half),
        Measure(f"{against} at t = 1 tau, relative L2", whole, claim, whole <= _DIFFERENCE_MAX),
        Measure(of_map, here[MAP][-1]),
    ]
    for what in (FUNCTION, MAP):
        coarse, fine = (off[what][-1] for off in [*there.values()][-2:])
        order = np.log2(coarse / fine)
        text = (
            f"order in the edge length in which the difference of the {what} falls between the "
            "finest spheres"
        )
        measures.append(
            Measure(text, order, "tends to the flow under refinement", order >= _ORDER_MIN)
        )

    x = mesh.vertices  # flow lines start far from each other through space
    chosen = [int(np.argmax(((x - x.mean(axis=0)) ** 2).sum(axis=1)))]
    nearest = np.full(len(x), np.inf)
    while len(chosen) < _LINES:
        nearest = np.minimum(nearest, ((x - x[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(nearest)))
    starts = project_onto_surface(mesh, x[chosen])
    lines = tuple(line.positions for line in flow_lines(mesh, flow.velocity[0], starts, flow.tau))
    halfway, end = flow.push(f, [flow.tau / 2, flow.tau])
    panels = (
        Panel(mesh, Streaks(flow.velocity[0]), "field", "field"),
        Panel(mesh, Values(f), "function", "source"),
        Panel(mesh, Values(halfway), "t = τ/2"),
        Panel(mesh, Values(end), "t = τ, flow lines", lines=lines),
    )
    plots = tuple(
        Plot(
            (
                Curve("this surface", _TIMES, here[what]),
                *(Curve(name, _TIMES, off[what], faint=True) for name, off in there.items()),
            ),
            *("t / τ", axis, label),
            log_y=True,
        )
        for what, axis, label in (
            (FUNCTION, "difference, relative L2", against),
            (MAP, "difference, sqrt(area)", "point map against flow lines"),
        )
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
    off = [fields.relative_difference(mesh, h, walked) for h, walked in functions]
    points = [project_onto_surface(mesh, x).positions for x in flow.push(mesh.vertices, times)]
    apart = [l2_norm(mesh, x - walked) for x, walked in zip(points, places, strict=True)]
    return {
        FUNCTION: np.array(off),
        MAP: np.array(apart) / mesh.length_scale**2,  # root mean square
    }
