"""Figure 4: linear against nonlinear advection, for a short and a long time."""

import math

import numpy as np

from abfm.calculus.operators import Matrix, face_areas, gradient
from abfm.calculus.vector_fields import directional_derivative, to_frame
from abfm.experiments.experiment import Experiment, Findings, Measure, Report
from abfm.experiments.given_flow import GivenFlow, carried, feet, relative_difference, stream_field
from abfm.experiments.meshes import five_limbs
from abfm.experiments.sheet import Curve, Panel, Plot, Sheet, Values
from abfm.flow.flow import Flow
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

_MODES = {2: 1.0, 3: 0.6, 5: 0.6}
_WAY = 0.3  # root mean square over the surface until tau, in sqrt(area)
_SHORT = 4  # of the times: 0.2 tau
_TIMES = np.arange(21) / 20
_GROWTH = 1e6  # by which linear steps amplify the fastest oscillation until tau
_MOST_STEPS = 10_000
_REFINED = 4  # times as many steps, for comparison
_SMALL = 0.05  # "works well": so far from flow lines; "smooth": overshoot and variation in excess
_TALL = 4.0  # a plot is so much taller than its curves but the linear one, which may grow beyond all bounds
_LINEAR, _ONE_STEP, _NONLINEAR, _FLOW_LINES = "linear", "linear, one step", "nonlinear", "flow lines"
_FINER = f"linear, {_REFINED} times the steps"
_WORKS, _SMOOTH, _OSCILLATES = "works well for short times", "smooth even for long times", "oscillates for longer times"


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> GivenFlow:
    """A smooth field without divergence, and an eigenfunction that it carries away.

    The time is shorter on a mesh with triangles so small that linear steps would have to be too many.
    """
    name = "mesh" if mesh else "five limbs"
    mesh = mesh or five_limbs(800 if small else 5000)
    velocity = stream_field(mesh, _MODES, _WAY)
    tau = min(1.0, math.sqrt(2 * math.log(_GROWTH) * _MOST_STEPS) / _fastest(_derivative(mesh, velocity)))
    return GivenFlow.of(Flow(mesh, velocity, tau), name, "eigenfunction:6")


def run(setup: GivenFlow, report: Report) -> Findings:
    """Advect in one linear step (Eq. 5), in many, by the exponential (Eq. 4) and along flow lines."""
    mesh, flow, f = setup.mesh, setup.flow, setup.source[:, 0]
    times = _TIMES * flow.tau
    derivative = _derivative(mesh, flow.velocity[0])
    each = _steps_each(derivative, flow.tau)
    steps = each * (len(times) - 1)
    report("flow lines", 0.0)
    ways = {
        _LINEAR: _linear_steps(derivative, f, flow.tau / steps, each),
        _FINER: _linear_steps(derivative, f, flow.tau / steps / _REFINED, each * _REFINED),
        _ONE_STEP: f - times[:, None] * (derivative @ f),
        _NONLINEAR: flow.push(f, times),
        _FLOW_LINES: carried(mesh, feet(mesh, flow.velocity[0], times), f),
    }
    report("variation", 0.9)
    overshoot = {name: np.array([_overshoot(f, h) for h in way]) for name, way in ways.items()}
    variation = {name: np.array([_variation(mesh, h) for h in way]) for name, way in ways.items()}
    rows = [
        (
            Panel(mesh, Values(f), "t = 0", "source"),
            *(
                Panel(mesh, Values(np.clip(ways[name][k], f.min(), f.max())), f"{name}, t = {label}")
                for k, label in ((_SHORT, f"{_TIMES[_SHORT]:g} τ"), (-1, "τ"))
            ),
        )
        for name in (_LINEAR, _NONLINEAR)
    ]
    growth = {name: values / values[0] for name, values in variation.items()}
    plots = (
        _plot(times / flow.tau, overshoot, "overshoot / range of f"),
        _plot(times / flow.tau, growth, "total variation / of f"),
    )
    measures = []
    for name in (_LINEAR, _FINER, _ONE_STEP, _NONLINEAR):
        for k, when in ((_SHORT, f"{_TIMES[_SHORT]:g} tau"), (-1, "tau")):
            off = relative_difference(mesh, ways[name][k], ways[_FLOW_LINES][k])
            excess = variation[name][k] / variation[_FLOW_LINES][k] - 1
            measures += [
                _measure(name, when, "difference from flow lines, relative L2", off),
                _measure(name, when, "overshoot over the range of f", overshoot[name][k]),
                _measure(name, when, "total variation over that along flow lines, minus 1", excess),
            ]
    setting = (
        f"{setup.where}; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} carries eigenfunction 6 on average {_WAY * flow.tau:.2g} sqrt(area) far; "
        f"the linear way takes {steps:,} steps. Colours end at the range of the function."
    )
    return Findings(measures, Sheet((*rows, plots)), setting)


def _measure(name: str, when: str, what: str, value: float) -> Measure:
    """A measure with what the paper says about it: differences for short times, oscillations for long ones."""
    title = f"{name}, t = {when}: {what}"
    difference = what.startswith("difference")
    if name not in (_LINEAR, _NONLINEAR) or difference == (when == "tau"):
        return Measure(title, value)
    claim = _WORKS if difference else _OSCILLATES if name == _LINEAR else _SMOOTH
    return Measure(title, value, claim, (value > _SMALL) == (claim == _OSCILLATES))


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
