"""Figure 2: a function advected along a field, compared with explicit flow lines."""

import numpy as np

from abfm import Flow
from abfm.calculus import l2_norm
from abfm.experiments import fields, scripts
from abfm.experiments.scripts import FigureSetup, Findings, Measure, Script
from abfm.flow import flow_lines
from abfm.io.sheets import Curve, Panel, Plot, Sheet, Streaks, Values
from abfm.maps import project_onto_surface
from abfm.mesh.shapes import sphere
from abfm.types import FloatArray

FUNCTION = "function"
MAP = "point map"

_MODES = {3: 1.0, 4: 1.0, 6: 0.5}
_RMS_DISPLACEMENT = 0.2  # displacement over the surface, in sqrt(area)
_TIMES = np.arange(1, 9) / 8  # times relative to tau, which is 1
_LINES = 24  # flow lines in the picture
# limits: difference between advected function and flow lines at tau, and order of convergence
_DIFFERENCE_MAX = 0.05
_ORDER_MIN = 1.0


def figure_2(setup: FigureSetup) -> Script:
    """Compare an advected function with flow lines, on a mesh and on increasingly fine spheres."""
    mesh, name = (
        setup.surface("eight.off, Loop subdivided", scripts.loop_subdivided, "eight.off", 1)
        if setup.small
        else setup.surface("fandisk.off", scripts.bundled, "fandisk.off")
    )
    flow = Flow(mesh, fields.stream_field(mesh, _MODES, _RMS_DISPLACEMENT))
    example = scripts.advection_example(flow, name, "eigenfunction:8", "file:advected.npy")
    yield example

    setup.report("flow lines", 0.0)
    f = example.problem.source[:, 0]
    on_surface = differences(flow, f, _TIMES)
    setup.report("flow lines on spheres", 0.4)
    against = "advected function against flow lines"
    measures: list[Measure] = []
    on_spheres = {}
    for level in (2, 3) if setup.small else (3, 4, 5):
        ball = sphere(level)
        x, y, z = ball.vertices.T
        # The shear flow rotates about z with angular velocity 1 + z. Its departure points are
        # known.
        shear = Flow(ball, fields.gradient_field(ball, -(z + z**2 / 2), turned=True))
        cosine, sine = np.cos(1 + z), np.sin(1 + z)
        departures = np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)
        before, after = (np.exp(4 * (p @ [0.8, 0.0, 0.6] - 1)) for p in (ball.vertices, departures))
        size = f"{len(x):,} vertices"
        on_spheres[f"sphere, {size}"] = by_sphere = differences(shear, before, _TIMES)
        error = fields.relative_difference(ball, shear.push(before), after)
        exact = f"sphere of {size}: advected function"
        measures += [
            Measure(f"sphere of {size}: {against}, relative L2", by_sphere[FUNCTION][-1]),
            Measure(f"{exact} against the exact solution, relative L2", error),
            Measure(
                f"sphere of {size}: point map against flow lines, in sqrt(area)", by_sphere[MAP][-1]
            ),
        ]
    setup.report("flow lines", 0.95)
    quarter, half, full = on_surface[FUNCTION][[1, 3, 7]]
    of_map = "point map against flow lines at tau, root mean square, in sqrt(area)"
    claim = "the flow map of a vector field is used to advect a function"
    measures[:0] = [
        Measure(f"{against} at t = 0.25 tau, relative L2", quarter),
        Measure(f"{against} at t = 0.5 tau, relative L2", half),
        Measure(f"{against} at t = 1 tau, relative L2", full, claim, full <= _DIFFERENCE_MAX),
        Measure(of_map, on_surface[MAP][-1]),
    ]
    for quantity in (FUNCTION, MAP):
        coarse, fine = (by_sphere[quantity][-1] for by_sphere in [*on_spheres.values()][-2:])
        order = np.log2(coarse / fine)
        text = (
            f"order in the edge length in which the difference of the {quantity} falls between the "
            "finest spheres"
        )
        measures.append(
            Measure(text, order, "tends to the flow under refinement", order >= _ORDER_MIN)
        )

    x = mesh.vertices  # flow lines begin at vertices chosen by farthest point sampling
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
                Curve("this surface", _TIMES, on_surface[quantity]),
                *(
                    Curve(name, _TIMES, by_sphere[quantity], faint=True)
                    for name, by_sphere in on_spheres.items()
                ),
            ),
            *("t / τ", axis, label),
            log_y=True,
        )
        for quantity, axis, label in (
            (FUNCTION, "difference, relative L2", against),
            (MAP, "difference, sqrt(area)", "point map against flow lines"),
        )
    )
    setting = (
        f"{scripts.size_text(name, mesh)}; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} advects eigenfunction 8 by {_RMS_DISPLACEMENT:g} "
        "sqrt(area) on average. On the spheres, a shear flow rotates about an axis; its angular "
        "velocity grows with the height."
    )
    return Findings(measures, Sheet((panels, plots)), setting)


def differences(flow: Flow, f: FloatArray, times: FloatArray) -> dict[str, FloatArray]:
    """Return two differences between a flow and exact flow lines by name, each of shape (T,).

    `FUNCTION` is the relative L2 difference between ``f`` advected by the flow and ``f`` at the
    ends of backward flow lines from the vertices. `MAP` is the root mean square distance, in
    sqrt(area), between these ends and the points to which the flow maps the vertices.
    """
    mesh = flow.mesh
    places = fields.departure_points(mesh, flow.velocity[0], times)
    functions = zip(flow.push(f, times), fields.advected_values(mesh, places, f), strict=True)
    of_functions = [fields.relative_difference(mesh, h, by_lines) for h, by_lines in functions]
    points = [project_onto_surface(mesh, x).positions for x in flow.push(mesh.vertices, times)]
    map_differences = [
        l2_norm(mesh, x - by_lines) for x, by_lines in zip(points, places, strict=True)
    ]
    return {
        FUNCTION: np.array(of_functions),
        MAP: np.array(map_differences) / mesh.length_scale**2,  # root mean square of distances
    }
