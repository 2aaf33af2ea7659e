"""Figure 4: linear against nonlinear advection, for a short and a long time."""

import math

import numpy as np

from abfm import Flow
from abfm.calculus import directional_derivative, face_areas, gradient, to_frame
from abfm.calculus.operators import Matrix
from abfm.experiments import fields
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage, carried_example, sized
from abfm.io.sheets import Curve, Panel, Plot, Sheet, Values
from abfm.mesh.shapes import five_limbs
from abfm.types import FloatArray

_MODES = {2: 1.0, 3: 0.6, 5: 0.6}
_WAY = 0.3  # root mean square over the surface until tau, in sqrt(area)
_TIMES = np.arange(21) / 20  # of tau
_SHOWN_TIMES = {4: ("0.2 tau", "0.2 τ"), -1: ("tau", "τ")}  # of these times
_GROWTH = 1e6  # by which linear steps amplify the fastest oscillation until tau
_MOST_STEPS = 10_000
_REFINEMENT = 4  # times as many steps, for comparison
# "works well": so far from flow lines; "smooth": overshoot and variation in excess
_DIFFERENCE_MAX = 0.05
# a plot is so much taller than its curves but the linear one, which may grow beyond all bounds
_HEIGHT_RATIO = 4.0
_LINEAR_FLOW = "linear"
_STEP_FLOW = "linear, one step"
_FLOW = "nonlinear"
_LINES = "flow lines"
_FINER_NAME = f"linear, {_REFINEMENT} times the steps"
_SMOOTH_CLAIM = ("smooth even for long times", True)
_CLOSE_CLAIM = ("works well for short times", True)
_CLAIMS = {  # of oscillations at tau and of differences before, whether they are small
    True: {_LINEAR_FLOW: ("oscillates for longer times", False), _FLOW: _SMOOTH_CLAIM},
    False: {_LINEAR_FLOW: _CLOSE_CLAIM, _FLOW: _CLOSE_CLAIM},
}


def figure_4(stage: Stage) -> Script:
    """Advect in one linear step (Eq. 5), in many, by the exponential (Eq. 4), by flow lines."""
    mesh, name = stage.surface("five limbs", five_limbs, 800 if stage.small else 5000)
    velocity = fields.stream_field(mesh, _MODES, _WAY)
    derivative = directional_derivative(mesh, to_frame(mesh, velocity))
    highest = fastest(derivative)
    # shorter where triangles are so small that linear steps would have to be too many
    tau = min(1.0, math.sqrt(2 * math.log(_GROWTH) * _MOST_STEPS) / highest)
    flow = Flow(mesh, velocity, tau)
    example = carried_example(flow, name, "eigenfunction:6", "file:advected.npy")
    yield example

    stage.report("flow lines", 0.0)
    f, times = example.problem.source[:, 0], _TIMES * tau
    # A step of length h makes an oscillation of frequency w larger by sqrt(1 + (h w)^2), however
    # small h is: so many steps between two of the times that the fastest grows by _GROWTH.
    enough = (tau * highest) ** 2 / (2 * math.log(_GROWTH))
    each = max(math.ceil(enough / (len(times) - 1)), 1)
    steps = each * (len(times) - 1)
    ways = {
        _LINEAR_FLOW: linear_steps(derivative, f, tau / steps, each),
        _FINER_NAME: linear_steps(derivative, f, tau / steps / _REFINEMENT, each * _REFINEMENT),
        _STEP_FLOW: f - times[:, None] * (derivative @ f),
        _FLOW: flow.push(f, times),
        _LINES: fields.carried(mesh, fields.feet(mesh, velocity, times), f),
    }
    stage.report("variation", 0.9)
    low, high, areas = f.min(), f.max(), face_areas(mesh)
    beyond, total = {}, {}
    for way, path in ways.items():
        over = np.maximum(path.max(axis=1) - high, low - path.min(axis=1))
        beyond[way] = np.maximum(over, 0.0) / (high - low)
        slopes = [(gradient(mesh) @ h).reshape(-1, 2) for h in path]
        total[way] = np.array([areas @ np.linalg.norm(slope, axis=1) for slope in slopes])

    measures = []
    for way, path in [*ways.items()][:4]:
        for k, (when, _) in _SHOWN_TIMES.items():
            off = fields.relative_difference(mesh, path[k], ways[_LINES][k])
            excess = total[way][k] / total[_LINES][k] - 1
            for what, x, oscillates in (
                ("difference from flow lines, relative L2", off, False),
                ("overshoot over the range of f", beyond[way][k], True),
                ("total variation over that along flow lines, minus 1", excess, True),
            ):
                claim, reproduces = "", None
                if oscillates == (when == "tau") and way in _CLAIMS[oscillates]:
                    claim, small = _CLAIMS[oscillates][way]
                    reproduces = (x <= _DIFFERENCE_MAX) == small
                measures.append(Measure(f"{way}, t = {when}: {what}", x, claim, reproduces))

    rows = []
    for way in (_LINEAR_FLOW, _FLOW):
        shown = [(np.clip(ways[way][k], low, high), t) for k, (_, t) in _SHOWN_TIMES.items()]
        panels = (Panel(mesh, Values(h), f"{way}, t = {t}") for h, t in shown)
        rows.append((Panel(mesh, Values(f), "t = 0", "source"), *panels))
    growth = {name: values / values[0] for name, values in total.items()}
    plots = (plot(beyond, "overshoot / range of f"), plot(growth, "total variation / of f"))
    setting = (
        f"{sized(name, mesh)}; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} carries eigenfunction 6 on average {_WAY * tau:.2g} "
        f"sqrt(area) far; the linear way takes {steps:,} steps. Colours end at the range of the "
        "function."
    )
    return Findings(measures, Sheet((*rows, plots)), setting)


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
        for _ in range(each):
            f = f - step * (derivative @ f)
        states.append(f)
    return np.array(states)


def plot(values: dict[str, FloatArray], title: str) -> Plot:
    """Plot what the ways give over time."""
    shown = {name: values[name] for name in (_LINEAR_FLOW, _STEP_FLOW, _FLOW, _LINES)}
    curves = tuple(Curve(name, _TIMES, y, faint=name == _LINES) for name, y in shown.items())
    calm = max(float(y.max()) for name, y in shown.items() if name != _LINEAR_FLOW)
    return Plot(
        curves, "t / τ", title, title.partition(" /")[0], top=max(_HEIGHT_RATIO * calm, 1.0)
    )
