"""Figure 4: linear against nonlinear advection, for a short and a long time."""

import math

import numpy as np

from abfm import Flow, TriangleMesh
from abfm.calculus import directional_derivative, face_areas, gradient, to_frame
from abfm.calculus.operators import Matrix
from abfm.experiments import fields
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage, carried_example, sized
from abfm.io.sheets import Curve, Panel, Plot, Sheet, Values
from abfm.mesh.shapes import five_limbs
from abfm.types import FloatArray

CLAIM = (
    "Linear advection works well for short times and oscillates for longer ones; nonlinear "
    "advection stays smooth."
)

_MODES = {2: 1.0, 3: 0.6, 5: 0.6}
_WAY = 0.3  # root mean square over the surface until tau, in sqrt(area)
_TIMES = np.arange(21) / 20  # of tau
_LABELS = {4: ("0.2 tau", "0.2 τ"), -1: ("tau", "τ")}  # of the times that are shown
_GROWTH = 1e6  # by which linear steps amplify the fastest oscillation until tau
_MOST_STEPS = 10_000
_REFINED = 4  # times as many steps, for comparison
_SMALL = 0.05  # "works well": so far from flow lines; "smooth": overshoot and variation in excess
# a plot is so much taller than its curves but the linear one, which may grow beyond all bounds
_TALL = 4.0
_LINEAR, _ONE_STEP, _NONLINEAR, _LINES = ("linear", "linear, one step", "nonlinear", "flow lines")
_FINER = f"linear, {_REFINED} times the steps"


def figure(stage: Stage) -> Script:
    """Advect in one linear step (Eq. 5), in many, by the exponential (Eq. 4), by flow lines."""
    mesh, name = stage.surface("five limbs", five_limbs, 800 if stage.small else 5000)
    velocity = fields.stream_field(mesh, _MODES, _WAY)
    highest = fastest(directional_derivative(mesh, to_frame(mesh, velocity)))
    # shorter where triangles are so small that linear steps would have to be too many
    flow = Flow(mesh, velocity, min(1.0, math.sqrt(2 * math.log(_GROWTH) * _MOST_STEPS) / highest))
    example = carried_example(flow, name, "eigenfunction:6", "file:advected.npy")
    yield example

    stage.report("flow lines", 0.0)
    f, tau, velocity = example.problem.source[:, 0], flow.tau, flow.velocity[0]
    times, derivative = _TIMES * tau, directional_derivative(mesh, to_frame(mesh, velocity))
    # A step of length h makes an oscillation of frequency w larger by sqrt(1 + (h w)^2), however
    # small h is: so many steps between two of the times that the fastest grows by _GROWTH.
    enough = (tau * fastest(derivative)) ** 2 / (2 * math.log(_GROWTH))
    each = max(math.ceil(enough / (len(times) - 1)), 1)
    steps = each * (len(times) - 1)
    ways = {
        _LINEAR: linear_steps(derivative, f, tau / steps, each),
        _FINER: linear_steps(derivative, f, tau / steps / _REFINED, each * _REFINED),
        _ONE_STEP: f - times[:, None] * (derivative @ f),
        _NONLINEAR: flow.push(f, times),
        _LINES: fields.carried(mesh, fields.feet(mesh, velocity, times), f),
    }
    stage.report("variation", 0.9)
    low, high = f.min(), f.max()
    beyond = {
        way: np.maximum(np.maximum(h.max(axis=1) - high, low - h.min(axis=1)), 0.0) / (high - low)
        for way, h in ways.items()
    }
    total = {way: np.array([variation(mesh, h) for h in path]) for way, path in ways.items()}

    measures = []
    for way in (_LINEAR, _FINER, _ONE_STEP, _NONLINEAR):
        for k, (when, _) in _LABELS.items():
            off = fields.relative_difference(mesh, ways[way][k], ways[_LINES][k])
            excess = total[way][k] / total[_LINES][k] - 1
            measures += [
                judged(way, when, "difference from flow lines, relative L2", off),
                judged(way, when, "overshoot over the range of f", beyond[way][k]),
                judged(way, when, "total variation over that along flow lines, minus 1", excess),
            ]

    rows = [
        (
            Panel(mesh, Values(f), "t = 0", "source"),
            *(
                Panel(mesh, Values(np.clip(ways[way][k], low, high)), f"{way}, t = {t}")
                for k, (_, t) in _LABELS.items()
            ),
        )
        for way in (_LINEAR, _NONLINEAR)
    ]
    growth = {name: values / values[0] for name, values in total.items()}
    plots = (plot(beyond, "overshoot / range of f"), plot(growth, "total variation / of f"))
    setting = (
        f"{sized(name, mesh)}; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} carries eigenfunction 6 on average {_WAY * tau:.2g} "
        f"sqrt(area) far; the linear way takes {steps:,} steps. Colours end at the range of the "
        "function."
    )
    return Findings(measures, Sheet((*rows, plots)), setting)


def judged(way: str, when: str, what: str, value: float) -> Measure:
    """Measure with what the paper says: differences for short times, oscillations for long ones."""
    title = f"{way}, t = {when}: {what}"
    difference = what.startswith("difference")
    if way not in (_LINEAR, _NONLINEAR) or difference == (when == "tau"):
        return Measure(title, value)
    if difference:
        return Measure(title, value, "works well for short times", value <= _SMALL)
    if way == _LINEAR:
        return Measure(title, value, "oscillates for longer times", value > _SMALL)
    return Measure(title, value, "smooth even for long times", value <= _SMALL)


def fastest(derivative: Matrix) -> float:
    """Find the highest frequency of ``exp(-t D_v)``, by power iteration."""
    f = np.random.default_rng(0).normal(size=derivative.shape[0])
    growth = 0.0
    for _ in range(100):
        f = derivative @ f
        growth = float(np.linalg.norm(f))
        f /= growth
    return growth


def linear_steps(derivative: Matrix, f: FloatArray, step: float, each: int) -> FloatArray:
    """Repeat Eq. 5: ``f`` and what it is after every ``each`` steps."""
    states = [f]
    for _ in _TIMES[1:]:
        h = states[-1]
        for _ in range(each):
            h = h - step * (derivative @ h)
        states.append(h)
    return np.array(states)


def variation(mesh: TriangleMesh, f: FloatArray) -> float:
    """Integrate ``|grad f|``."""
    slopes = (gradient(mesh) @ f).reshape(-1, 2)
    return float(face_areas(mesh) @ np.linalg.norm(slopes, axis=1))


def plot(values: dict[str, FloatArray], title: str) -> Plot:
    """Plot what the ways give over time."""
    shown = (_LINEAR, _ONE_STEP, _NONLINEAR, _LINES)
    curves = tuple(Curve(name, _TIMES, values[name], faint=name == _LINES) for name in shown)
    calm = max(float(values[name].max()) for name in shown if name != _LINEAR)
    return Plot(curves, "t / τ", title, title.partition(" /")[0], top=max(_TALL * calm, 1.0))
