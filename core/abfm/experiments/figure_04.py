"""Figure 4: linear against nonlinear advection, for a short and a long time."""

from __future__ import annotations

import math

import numpy as np

from abfm.calculus.operators import Matrix, face_areas, gradient, l2_norm
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup
from abfm.experiments.given_flow import carried, feet, stream_field
from abfm.experiments.meshes import five_limbs
from abfm.experiments.sheet import Curve, Panel, Plot, Sheet, Values
from abfm.flow.advection import advect
from abfm.flow.flow import Flow
from abfm.functions import function
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray

_MODES = {2: 1.0, 3: 0.6, 5: 0.6}
_WAY = 0.3  # root mean square over the surface until tau, in sqrt(area)
_SHORT = 0.2  # of tau
_TIMES = np.arange(21) / 20
_GROWTH = 1e6  # by which linear steps amplify the fastest oscillation until tau
_MOST_STEPS = 10_000
_REFINED = 4  # times as many steps, for comparison
_CLOSE, _CALM = 0.05, 0.05  # "works well": this far from flow lines; "smooth": overshoot and variation in excess
_TALL = 4.0  # a plot is so much taller than its curves but the linear one, which may grow beyond all bounds
_TARGET = "file:advected.npy"
_LINEAR, _ONE_STEP, _NONLINEAR, _FLOW_LINES = "linear", "linear, one step", "nonlinear", "flow lines"
_FINER = f"linear, {_REFINED} times the steps"


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> Setup:
    """A smooth field without divergence, and an eigenfunction that it carries away.

    The time is shorter on a mesh with triangles so small that linear steps would have to be too many.
    """
    name = "mesh" if mesh else "five limbs"
    mesh = mesh or five_limbs(800 if small else 5000)
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
        _LINEAR: _linear_steps(derivative, f, tau / steps, each),
        _FINER: _linear_steps(derivative, f, tau / steps / _REFINED, each * _REFINED),
        _ONE_STEP: f - times[:, None] * (derivative @ f),
        _NONLINEAR: Flow(mesh, setup.velocity, tau).push(f, times),
        _FLOW_LINES: carried(mesh, feet(mesh, setup.velocity[0], times), f),
    }
    report("variation", 0.9)
    overshoot = {name: np.array([_overshoot(f, h) for h in way]) for name, way in ways.items()}
    variation = {name: np.array([_variation(mesh, h) for h in way]) for name, way in ways.items()}
    distance = {
        name: np.array([l2_norm(mesh, h - g) / l2_norm(mesh, g) for h, g in zip(way, ways[_FLOW_LINES], strict=True)])
        for name, way in ways.items()
    }
    short = int(np.argmin(np.abs(_TIMES - _SHORT)))
    rows = [
        (
            Panel(mesh, Values(f), "t = 0", "source"),
            *(
                Panel(mesh, Values(np.clip(ways[name][k], f.min(), f.max())), f"{name}, t = {label}")
                for k, label in ((short, f"{_SHORT:g} τ"), (-1, "τ"))
            ),
        )
        for name in (_LINEAR, _NONLINEAR)
    ]
    plots = (
        _plot(times / tau, overshoot, "overshoot / range of f"),
        _plot(times / tau, {name: values / values[0] for name, values in variation.items()}, "total variation / of f"),
    )
    setting = (
        f"{setup.name}, {len(mesh.vertices):,} vertices; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} carries eigenfunction 6 on average {_WAY * tau:.2g} sqrt(area) far; "
        f"the linear way takes {steps:,} steps. Colours end at the range of the function."
    )
    return Findings(_measures(short, overshoot, variation, distance), Sheet((*rows, plots)), setting)


def _measures(
    short: int, overshoot: dict[str, FloatArray], variation: dict[str, FloatArray], distance: dict[str, FloatArray]
) -> tuple[Measure, ...]:
    found = []
    for name in (_LINEAR, _FINER, _ONE_STEP, _NONLINEAR):
        for when, k in ((f"{_SHORT:g} tau", short), ("tau", -1)):
            off, over = float(distance[name][k]), float(overshoot[name][k])
            excess = float(variation[name][k] / variation[_FLOW_LINES][k] - 1)
            found += [
                _measure(name, when, "difference from flow lines, relative L2", off, _CLOSE),
                _measure(name, when, "overshoot over the range of f", over, _CALM),
                _measure(name, when, "total variation over that along flow lines, minus 1", excess, _CALM),
            ]
    return tuple(found)


def _measure(name: str, when: str, what: str, value: float, small: float) -> Measure:
    """A measure with what the paper says about it: differences for short times, oscillations for long ones."""
    long, difference = when == "tau", what.startswith("difference")
    title = f"{name}, t = {when}: {what}"
    if name not in (_LINEAR, _NONLINEAR) or long == difference:
        return Measure(title, value)
    if difference:
        return Measure(title, value, None, "works well for short times", value <= small)
    if name == _LINEAR:
        return Measure(title, value, None, "oscillates for longer times", value > small)
    return Measure(title, value, None, "smooth even for long times", value <= small)


def _derivative(mesh: TriangleMesh, velocity: FloatArray) -> Matrix:
    return directional_derivative(mesh, to_frame(mesh, velocity))


def _fastest(derivative: Matrix) -> float:
    """The highest frequency of ``exp(-t D_v)``, by power iteration."""
    f = np.random.default_rng(0).normal(size=derivative.shape[0])
    growth = 0.0
    for _ in range(100):
        f = derivative @ f
        growth = float(np.linalg.norm(f))
        f /= growth
    return growth


def _steps_each(derivative: Matrix, tau: float) -> int:
    """Linear steps between two of the times, so many that the fastest oscillation grows by `_GROWTH` until tau.

    A step of length h makes an oscillation of frequency w larger by ``sqrt(1 + (h w)^2)``, however small h is.
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


def _plot(times: FloatArray, values: dict[str, FloatArray], title: str) -> Plot:
    shown = (_LINEAR, _ONE_STEP, _NONLINEAR, _FLOW_LINES)
    curves = tuple(Curve(name, times, values[name], faint=name == _FLOW_LINES) for name in shown)
    calm = max(float(values[name].max()) for name in shown if name != _LINEAR)
    return Plot(curves, "t / τ", title, title.partition(" /")[0], top=max(_TALL * calm, 1.0))


EXPERIMENT = Experiment(
    4,
    "Linear advection works well for short times and oscillates for longer ones; nonlinear advection stays smooth.",
    set_up,
    run,
)
