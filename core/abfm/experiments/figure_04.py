"""Figure 4: linear against nonlinear advection, for a short and a long time."""

from __future__ import annotations

import math

import numpy as np

from abfm.advection import advect
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup
from abfm.experiments.given_flow import carried, feet, stream_field
from abfm.experiments.meshes import bundled, sphere
from abfm.experiments.sheet import Curve, Panel, Plot, Sheet, Values
from abfm.functions import function
from abfm.match_result import push
from abfm.mesh import FloatArray, TriangleMesh
from abfm.operators import Matrix, face_areas, gradient, l2_norm
from abfm.parameters import Parameters
from abfm.vector_fields import directional_derivative, to_frame

_MODES = {2: 1.0, 3: 0.6, 5: 0.6}
_WAY = 0.3  # root mean square over the surface until tau, in sqrt(area)
_SHORT = 0.2  # of tau
_TIMES = np.arange(21) / 20
_GROWTH = 1e4  # by which linear steps amplify the fastest oscillation until tau, about
_MOST_STEPS = 10_000
_CLOSE, _CALM = 0.05, 0.05  # "works well": this far from flow lines; "smooth": overshoot and variation in excess
_TARGET = "file:advected.npy"


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> Setup:
    """A smooth field without divergence, and an eigenfunction that it carries away.

    The time is shorter on a mesh with triangles so small that linear steps would have to be too many.
    """
    name = "mesh" if mesh else "sphere" if small else "fandisk.off"
    mesh = mesh or (sphere(3) if small else bundled(name))
    velocity = stream_field(mesh, _MODES, _WAY)
    tau = min(1.0, math.sqrt(2 * math.log(_GROWTH) * _MOST_STEPS) / _fastest(_derivative(mesh, velocity)))
    source = "eigenfunction:6"
    return Setup(
        mesh=mesh,
        name=name,
        sources=(source,),
        targets=(_TARGET,),
        values={_TARGET: advect(mesh, velocity, function(mesh, source), tau)},
        parameters=Parameters(tau=tau),
        velocity=velocity[None],
    )


def run(setup: Setup, report: Report) -> Findings:
    """Advect in one linear step (Eq. 5), in many, by the exponential (Eq. 4) and along flow lines."""
    assert setup.velocity is not None
    mesh, tau = setup.mesh, setup.parameters.tau
    f = setup.source[:, 0]
    times = _TIMES * tau
    derivative = _derivative(mesh, setup.velocity[0])
    each = _steps_each(derivative, tau)
    steps = each * (len(times) - 1)
    report("flow lines", 0.0)
    ways = {
        "linear": _linear_steps(derivative, f, tau / steps, each),
        "linear, one step": f - times[:, None] * (derivative @ f),
        "nonlinear": push(mesh, setup.velocity, setup.parameters, f, times),
        "flow lines": carried(mesh, feet(mesh, setup.velocity[0], times), f),
    }
    report("variation", 0.9)
    overshoot = {name: np.array([_overshoot(f, h) for h in way]) for name, way in ways.items()}
    variation = {name: np.array([_variation(mesh, h) for h in way]) for name, way in ways.items()}
    distance = {
        name: np.array([l2_norm(mesh, h - g) / l2_norm(mesh, g) for h, g in zip(way, ways["flow lines"], strict=True)])
        for name, way in ways.items()
    }
    short = int(np.argmin(np.abs(_TIMES - _SHORT)))
    rows = [
        (
            Panel(mesh, Values(f), "t = 0", "source"),
            Panel(mesh, Values(ways[name][short]), f"{name}, t = {_SHORT:g} τ"),
            Panel(mesh, Values(ways[name][-1]), f"{name}, t = τ"),
        )
        for name in ("linear", "nonlinear")
    ]
    plots = (
        _plot(times / tau, {k: overshoot[k] for k in overshoot if k != "flow lines"}, "overshoot / range"),
        _plot(times / tau, variation, "total variation"),
    )
    setting = (
        f"{setup.name}, {len(mesh.vertices):,} vertices; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} carries eigenfunction 6 on average {_WAY * tau:.2g} sqrt(area) far; "
        f"the linear way takes {steps:,} steps."
    )
    return Findings(_measures(short, overshoot, variation, distance), Sheet((*rows, plots)), setting)


def _measures(
    short: int, overshoot: dict[str, FloatArray], variation: dict[str, FloatArray], distance: dict[str, FloatArray]
) -> tuple[Measure, ...]:
    found = []
    true = variation["flow lines"]
    for name in ("linear", "linear, one step", "nonlinear"):
        for when, k in ((f"{_SHORT:g} tau", short), ("tau", -1)):
            off, over = float(distance[name][k]), float(overshoot[name][k])
            excess = float(variation[name][k] / true[k] - 1)
            claim, holds = _claim(name, k == -1, off, max(over, excess))
            found += [
                Measure(f"{name}, t = {when}: difference from flow lines, relative L2", off, None, claim, holds),
                Measure(f"{name}, t = {when}: overshoot over the range of f", over),
                Measure(f"{name}, t = {when}: total variation over that along flow lines, minus 1", excess),
            ]
    return tuple(found)


def _claim(name: str, long: bool, off: float, excess: float) -> tuple[str, bool | None]:
    if name == "linear, one step":
        return "", None
    if name == "nonlinear" and long:
        return "smooth even for long times", excess <= _CALM
    if name == "linear" and long:
        return "oscillations for longer times", excess > _CALM
    return "works well for short times", off <= _CLOSE


def _derivative(mesh: TriangleMesh, velocity: FloatArray) -> Matrix:
    return directional_derivative(mesh, to_frame(mesh, velocity))


def _fastest(derivative: Matrix) -> float:
    """A bound of the frequencies of ``exp(-t D_v)``."""
    return float(abs(derivative).sum(axis=1).max())


def _steps_each(derivative: Matrix, tau: float) -> int:
    """Linear steps between two of the times, so many that oscillations grow by about `_GROWTH` until tau.

    A step of length h makes an oscillation of frequency w larger by ``sqrt(1 + (h w)^2)``.
    """
    steps = (tau * _fastest(derivative)) ** 2 / (2 * math.log(_GROWTH))
    return max(math.ceil(steps / (len(_TIMES) - 1)), 1)


def _linear_steps(derivative: Matrix, f: FloatArray, step: float, each: int) -> FloatArray:
    """Eq. 5 again and again: ``f`` and what it is after every ``each`` steps."""
    states = [f]
    for _ in range(len(_TIMES) - 1):
        h = states[-1]
        for _ in range(each):
            h = h - step * (derivative @ h)
        states.append(h)
    return np.array(states)


def _overshoot(f: FloatArray, h: FloatArray) -> float:
    """How far the values of ``h`` leave those of ``f``, as a share of their range."""
    return float(max(h.max() - f.max(), f.min() - h.min(), 0.0) / (f.max() - f.min()))


def _variation(mesh: TriangleMesh, f: FloatArray) -> float:
    """Integral of ``|grad f|``."""
    slopes = (gradient(mesh) @ f).reshape(-1, 2)
    return float(face_areas(mesh) @ np.linalg.norm(slopes, axis=1))


def _plot(times: FloatArray, curves: dict[str, FloatArray], title: str) -> Plot:
    return Plot(
        tuple(Curve(name, times, values, faint=name == "flow lines") for name, values in curves.items()),
        "t / τ",
        title,
        title,
    )


EXPERIMENT = Experiment(
    4,
    "linear and nonlinear advection",
    "Linear advection works well for short times and oscillates for longer ones; nonlinear advection stays smooth.",
    set_up,
    run,
)
