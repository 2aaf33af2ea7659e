"""Figure 4: linear and nonlinear advection, for a short and a long time."""

import math

import numpy as np

from abfm import Flow
from abfm.calculus import directional_derivative, face_areas, gradient, to_frame
from abfm.calculus.operators import Matrix
from abfm.experiments import fields, scripts
from abfm.experiments.scripts import FigureSetup, Findings, Measure, Script
from abfm.io.sheets import Curve, Panel, Plot, Sheet, Values
from abfm.mesh.shapes import five_limbs
from abfm.types import FloatArray

_MODES = {2: 1.0, 3: 0.6, 5: 0.6}
_RMS_DISPLACEMENT = 0.3  # displacement over the surface until tau, in sqrt(area)
_TIMES = np.arange(21) / 20  # times relative to tau
_SHOWN_TIMES = {
    4: ("0.2 tau", "0.2 τ"),
    -1: ("tau", "τ"),
}  # time in names of measures, and in labels, by index into _TIMES
_GROWTH = 1e6  # largest amplification of the fastest oscillation by linear steps until tau
_STEPS_MAX = 10_000
_REFINEMENT = 4  # ratio of the numbers of steps of the two linear advections that are compared
# maximum difference for "works well", and maximum overshoot and excess variation for "smooth"
_DIFFERENCE_MAX = 0.05
# largest height of a plot, relative to the highest curve other than the linear one
_HEIGHT_RATIO = 4.0
_LINEAR_FLOW = "linear"
_STEP_FLOW = "linear, one step"
_FLOW = "nonlinear"
_LINES = "flow lines"
_FINER_NAME = f"linear, {_REFINEMENT} times the steps"
_SMOOTH_CLAIM = ("smooth even for long times", True)
_CLOSE_CLAIM = ("works well for short times", True)
# Claims of the paper, and whether a small number supports them. Key True: overshoot and variation
# at tau; key False: difference from flow lines at 0.2 tau.
_CLAIMS = {
    True: {_LINEAR_FLOW: ("oscillates for longer times", False), _FLOW: _SMOOTH_CLAIM},
    False: {_LINEAR_FLOW: _CLOSE_CLAIM, _FLOW: _CLOSE_CLAIM},
}


def figure_4(setup: FigureSetup) -> Script:
    """Compare advection by one or many steps of Eq. 5, the exponential (Eq. 4) and flow lines."""
    mesh, name = setup.surface("five limbs", five_limbs, 800 if setup.small else 5000)
    velocity = fields.stream_field(mesh, _MODES, _RMS_DISPLACEMENT)
    derivative = directional_derivative(mesh, to_frame(mesh, velocity))
    frequency_max = frequency_bound(derivative)
    # a shorter time on meshes with small triangles, which would need too many linear steps
    tau = min(1.0, math.sqrt(2 * math.log(_GROWTH) * _STEPS_MAX) / frequency_max)
    flow = Flow(mesh, velocity, tau)
    example = scripts.advection_example(flow, name, "eigenfunction:6", "file:advected.npy")
    yield example

    setup.report("flow lines", 0.0)
    f, times = example.problem.source[:, 0], _TIMES * tau
    # A step of length h amplifies an oscillation of frequency w by sqrt(1 + (h w)^2), for any h.
    # The number of steps limits the growth of the fastest oscillation to _GROWTH.
    steps_min = (tau * frequency_max) ** 2 / (2 * math.log(_GROWTH))
    steps_between = max(math.ceil(steps_min / (len(times) - 1)), 1)
    steps = steps_between * (len(times) - 1)
    methods = {
        _LINEAR_FLOW: linear_steps(derivative, f, tau / steps, steps_between),
        _FINER_NAME: linear_steps(
            derivative, f, tau / steps / _REFINEMENT, steps_between * _REFINEMENT
        ),
        _STEP_FLOW: f - times[:, None] * (derivative @ f),
        _FLOW: flow.push(f, times),
        _LINES: fields.advected_values(mesh, fields.departure_points(mesh, velocity, times), f),
    }
    setup.report("variation", 0.9)
    low, high, areas = f.min(), f.max(), face_areas(mesh)
    overshoots, variations = {}, {}
    for method, path in methods.items():
        over = np.maximum(path.max(axis=1) - high, low - path.min(axis=1))
        overshoots[method] = np.maximum(over, 0.0) / (high - low)
        gradient_field = [(gradient(mesh) @ h).reshape(-1, 2) for h in path]
        variations[method] = np.array(
            [areas @ np.linalg.norm(slope, axis=1) for slope in gradient_field]
        )

    measures = []
    for method, path in [*methods.items()][:4]:
        for k, (time_name, _) in _SHOWN_TIMES.items():
            difference = fields.relative_difference(mesh, path[k], methods[_LINES][k])
            excess = variations[method][k] / variations[_LINES][k] - 1
            for quantity, x, oscillates in (
                ("difference from flow lines, relative L2", difference, False),
                ("overshoot over the range of f", overshoots[method][k], True),
                ("total variation over that along flow lines, minus 1", excess, True),
            ):
                claim, reproduces = "", None
                if oscillates == (time_name == "tau") and method in _CLAIMS[oscillates]:
                    claim, small = _CLAIMS[oscillates][method]
                    reproduces = (x <= _DIFFERENCE_MAX) == small
                measures.append(
                    Measure(f"{method}, t = {time_name}: {quantity}", x, claim, reproduces)
                )

    rows = []
    for method in (_LINEAR_FLOW, _FLOW):
        shown = [(np.clip(methods[method][k], low, high), t) for k, (_, t) in _SHOWN_TIMES.items()]
        panels = (Panel(mesh, Values(h), f"{method}, t = {t}") for h, t in shown)
        rows.append((Panel(mesh, Values(f), "t = 0", "source"), *panels))
    growth = {name: values / values[0] for name, values in variations.items()}
    plots = (plot(overshoots, "overshoot / range of f"), plot(growth, "total variation / of f"))
    setting = (
        f"{scripts.size_text(name, mesh)}; the rotated gradient of eigenfunctions "
        f"{', '.join(map(str, _MODES))} advects eigenfunction 6 by {_RMS_DISPLACEMENT * tau:.2g} "
        f"sqrt(area) on average; the linear method takes {steps:,} steps. Colors are limited to "
        "the range of the function."
    )
    return Findings(measures, Sheet((*rows, plots)), setting)


def frequency_bound(derivative: Matrix) -> float:
    """Return the highest angular frequency of ``exp(-t D_v)``, by power iteration on ``D_v``."""
    f = np.random.default_rng(0).normal(size=derivative.shape[0])
    growth = 0.0
    for _ in range(100):
        f = derivative @ f
        growth = float(np.linalg.norm(f))
        f /= growth
    return growth


def linear_steps(derivative: Matrix, f: FloatArray, step: float, steps_between: int) -> FloatArray:
    """Advect ``f`` by linear steps (Eq. 5) of duration ``step``.

    Return the function after every ``steps_between`` steps, (T, V), beginning with ``f``.
    """
    states = [f]
    for _ in _TIMES[1:]:
        for _ in range(steps_between):
            f = f - step * (derivative @ f)
        states.append(f)
    return np.array(states)


def plot(values: dict[str, FloatArray], title: str) -> Plot:
    shown = {name: values[name] for name in (_LINEAR_FLOW, _STEP_FLOW, _FLOW, _LINES)}
    curves = tuple(Curve(name, _TIMES, y, faint=name == _LINES) for name, y in shown.items())
    height = max(float(y.max()) for name, y in shown.items() if name != _LINEAR_FLOW)
    return Plot(
        curves, "t / τ", title, title.partition(" /")[0], top=max(_HEIGHT_RATIO * height, 1.0)
    )
