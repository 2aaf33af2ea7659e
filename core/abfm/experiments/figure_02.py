"""Figure 2: a function advected along a field, against explicit flow lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import gradient, l2_norm, rotation
from abfm.calculus.vector_fields import to_ambient
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup
from abfm.experiments.given_flow import carried, feet, stream_field
from abfm.experiments.meshes import bundled, smoothed, sphere
from abfm.experiments.sheet import Curve, Panel, Plot, Sheet, Streaks, Values
from abfm.flow.advection import advect
from abfm.flow.flow import Flow
from abfm.flow.flow_lines import flow_lines
from abfm.functions import function
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray, IntArray

_MODES = {3: 1.0, 4: 1.0, 6: 0.5}
_WAY = 0.2  # root mean square over the surface, in sqrt(area)
_TIMES = np.arange(1, 9) / 8  # of tau
_LINES = 24
_CLOSE, _ORDER = 0.05, 1.0  # what "advects" is taken for: this difference at tau, and this order under refinement
_TARGET = "file:advected.npy"


@dataclass(frozen=True, eq=False, kw_only=True)
class FlowSetup(Setup):
    """The flow, and spheres to refine: `spheres` (numbers of subdivisions, coarse to fine)."""

    spheres: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Advection against flow lines at several times (T,), both relative: functions in L2, maps in sqrt(area)."""

    functions: FloatArray
    maps: FloatArray


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> FlowSetup:
    """A smooth field without divergence, and an eigenfunction that it carries away."""
    name = "mesh" if mesh else "eight.off, Loop subdivided" if small else "fandisk.off"
    mesh = mesh or (smoothed("eight.off", 1) if small else bundled(name))
    parameters = Parameters(tau=1.0)
    velocity = stream_field(mesh, _MODES, _WAY / parameters.tau)
    source = "eigenfunction:8"
    return FlowSetup(
        mesh=mesh,
        name=name,
        sources=(source,),
        targets=(_TARGET,),
        values={_TARGET: advect(mesh, velocity, function(mesh, source), parameters.tau)},
        parameters=parameters,
        velocity=velocity[None],
        spheres=(2, 3) if small else (3, 4, 5),
    )


def run(setup: FlowSetup, report: Report) -> Findings:
    """Advect, walk the flow lines through all vertices backwards, and compare; again on finer and finer spheres."""
    assert setup.velocity is not None
    mesh, field, tau = setup.mesh, setup.velocity[0], setup.parameters.tau
    f = setup.source[:, 0]
    times = _TIMES * tau
    report("flow lines", 0.0)
    here = compare(mesh, field, f, times)
    there, exact = [], []
    for share, level in enumerate(setup.spheres):
        report("flow lines on spheres", 0.4 + 0.5 * share / len(setup.spheres))
        ball = sphere(level)
        bump = _bump(ball.vertices)
        shear = _shear(ball)
        there.append(compare(ball, shear, bump, _TIMES))
        turned = _bump(_sheared_back(ball.vertices, 1.0))
        exact.append(l2_norm(ball, advect(ball, shear, bump, 1.0) - turned) / l2_norm(ball, turned))
    report("flow lines", 0.95)

    starts = _spread(mesh, _LINES)
    lines = flow_lines(mesh, field, project_onto_surface(mesh, mesh.vertices[starts]), tau)
    halfway, end = Flow(mesh, setup.velocity, tau).push(f, [tau / 2, tau])
    panels = (
        Panel(mesh, Streaks(field), "field", "field"),
        Panel(mesh, Values(f), "function", "source"),
        Panel(mesh, Values(halfway), "t = τ/2"),
        Panel(mesh, Values(end), "t = τ, flow lines", lines=tuple(line.positions for line in lines)),
    )
    sheet = Sheet((panels, (_plot(setup, here, there, _functions), _plot(setup, here, there, _maps))))
    setting = (
        f"{setup.name}, {len(mesh.vertices):,} vertices; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} carries eigenfunction 8 on average {_WAY:g} sqrt(area) far. On spheres a shear "
        "flow about an axis, whose speed of rotation grows with the height."
    )
    return Findings(_measures(setup, here, there, exact), sheet, setting)


def compare(mesh: TriangleMesh, velocity: FloatArray, f: FloatArray, times: FloatArray) -> Comparison:
    """Compare ``exp(-t D_v) f`` and the point maps with the flow lines that end in the vertices.

    Parameters
    ----------
    velocity : (F, 3) array
    f : (V,) array
    times : (T,) array
    """
    flow = Flow(mesh, velocity, float(times.max()))
    places = feet(mesh, velocity, times)
    walked = carried(mesh, places, f)
    advected = flow.push(f, times)
    coordinates = flow.push(mesh.vertices, times)
    functions = [l2_norm(mesh, a - b) / l2_norm(mesh, b) for a, b in zip(advected, walked, strict=True)]
    maps = [
        l2_norm(mesh, project_onto_surface(mesh, a).positions - b) / mesh.length_scale**2  # root mean square
        for a, b in zip(coordinates, places, strict=True)
    ]
    return Comparison(np.array(functions), np.array(maps))


def _functions(comparison: Comparison) -> FloatArray:
    return comparison.functions


def _maps(comparison: Comparison) -> FloatArray:
    return comparison.maps


def _measures(setup: FlowSetup, here: Comparison, there: list[Comparison], exact: list[float]) -> tuple[Measure, ...]:
    claim = "the flow map of a vector field is used to advect a function"
    found = [
        Measure(
            f"advected function against flow lines at t = {share:g} tau, relative L2",
            float(here.functions[k]),
            None,
            claim if share == 1 else "",
            bool(here.functions[k] <= _CLOSE) if share == 1 else None,
        )
        for k, share in enumerate(_TIMES)
        if share in (0.25, 0.5, 1)
    ]
    found.append(Measure("point map against flow lines at tau, root mean square, in sqrt(area)", float(here.maps[-1])))
    for level, comparison, error in zip(setup.spheres, there, exact, strict=True):
        count = f"sphere of {len(sphere(level).vertices):,} vertices"
        found += [
            Measure(f"{count}: advected function against flow lines, relative L2", float(comparison.functions[-1])),
            Measure(f"{count}: advected function against the exact solution, relative L2", error),
            Measure(f"{count}: point map against flow lines, in sqrt(area)", float(comparison.maps[-1])),
        ]
    for name, choose in (("function", _functions), ("point map", _maps)):
        ends = [choose(comparison)[-1] for comparison in there]
        order = float(np.log2(ends[-2] / ends[-1]))
        found.append(
            Measure(
                f"order in the edge length in which the difference of the {name} falls between the finest spheres",
                order,
                None,
                "tends to the flow under refinement",
                order >= _ORDER,
            )
        )
    return tuple(found)


def _plot(
    setup: FlowSetup, here: Comparison, there: list[Comparison], choose: Callable[[Comparison], FloatArray]
) -> Plot:
    spheres = (
        Curve(f"sphere, {len(sphere(level).vertices):,} vertices", _TIMES, choose(comparison), faint=True)
        for level, comparison in zip(setup.spheres, there, strict=True)
    )
    unit, label = ("relative L2", "advected function") if choose is _functions else ("sqrt(area)", "point map")
    curves = (Curve("this surface", _TIMES, choose(here)), *spheres)
    return Plot(curves, "t / τ", f"difference, {unit}", f"{label} against flow lines", log_y=True)


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
    return to_ambient(ball, (rotation(ball) @ gradient(ball) @ -(z + z**2 / 2)).reshape(-1, 2))


def _sheared_back(points: FloatArray, t: float) -> FloatArray:
    """Where the shear's flow lines through points (P, 3) of the sphere come from."""
    x, y, z = points.T
    cosine, sine = np.cos((1 + z) * t), np.sin((1 + z) * t)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def _bump(points: FloatArray) -> FloatArray:
    return np.asarray(np.exp(4 * (points @ [0.8, 0.0, 0.6] - 1)))


EXPERIMENT = Experiment(
    2,
    "The flow map of a vector field advects a function, without explicit flow lines.",
    set_up,
    run,
)
