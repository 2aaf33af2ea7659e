"""Figure 8: optical flow, the field that made the target is found again from source and target."""

import numpy as np

from abfm import Flow, Problem, TriangleMesh, function
from abfm.experiments import vocabulary as words
from abfm.experiments.fields import root_mean_square, slopes, speed, stream_field
from abfm.experiments.vocabulary import Example, Findings, Measure, Script, Sought, Stage
from abfm.io.sheets import Panel, Sheet, Streaks, Values
from abfm.parameters import TABLE_1
from abfm.types import FloatArray

_MODES = {2: 1.0, 5: 0.7}
_WAY = 0.15  # root mean square over the surface, in sqrt(area)
_SLOPE_SHARE_MIN = 0.2  # of the largest slope
_BOUND = 0.02
_DIFFERENCE_MAX = 0.1  # what "very close to the original field" is taken for


def figure_8(stage: Stage) -> Script:
    """Match an eigenfunction to what a smooth field makes of it, and compare the fields."""
    eight = ("eight.off", 1 if stage.small else 2)
    mesh, name = stage.surface("eight.off, Loop subdivided", words.smoothed, *eight)
    parameters = TABLE_1[8].parameters(iterations=100 if stage.small else 200)
    tau, source = parameters.tau, "eigenfunction:7"
    hidden = Flow(mesh, stream_field(mesh, _MODES, _WAY / tau), tau)
    f = function(mesh, source)
    g = hidden.push(f)
    problem = Problem(mesh, f, g, parameters)
    yield Example(problem, name, ((source, "file:advected.npy"),))

    [found] = yield [Sought(problem)]
    stage.report("verifying", 0.95)
    witnesses, label, note = words.witnessed(found)
    velocity, given, matched = found.velocity[0], hidden.velocity[0], found.advected[:, 0]
    gradient, error, difference = slopes(mesh, f), velocity - given, np.abs(g - matched)
    steepness = np.linalg.norm(gradient, axis=1)
    steep = steepness > _SLOPE_SHARE_MIN * steepness.max()
    nowhere = np.zeros_like(gradient)
    directions = np.divide(gradient, steepness[:, None], out=nowhere, where=steep[:, None])
    along, along_given = (
        root_mean_square(mesh, (field * directions).sum(axis=1)) for field in (error, given)
    )
    off, largest = along / along_given, difference.max()
    path = hidden.push(f, np.linspace(0, tau, 21))
    seen = seen_rate(mesh, error, path) / seen_rate(mesh, given, path)
    whole = root_mean_square(mesh, error) / root_mean_square(mesh, given)
    share = root_mean_square(mesh, steep.astype(float)) ** 2

    where = f"where |grad f| exceeds {_SLOPE_SHARE_MIN:.0%} of its maximum"
    of_slopes = f"error of the field along grad f, {where}, relative L2"
    of_path = "error of <v, grad f_t> over the whole way, relative L2 on the surface and in time"
    of_functions = "largest |g - f_tau|, f and g on the scale of 1"
    small = "the error between the functions is very small"
    measures = (
        Measure(of_slopes, off, "very close to the original field", off <= _DIFFERENCE_MAX),
        Measure(f"share of the surface {where}", share),
        Measure(of_path, seen),
        Measure("error of the whole field, relative L2", whole),
        Measure(of_functions, largest, small, largest <= _BOUND, _BOUND),
        Measure("mismatch, relative L2", found.mismatch),
        *witnesses,
    )
    above = (
        Panel(mesh, Streaks(given), "given field v₀", "field"),
        Panel(mesh, Values(speed(mesh, given), "speed"), "|v₀|", "field"),
        Panel(mesh, Values(f), "source f", "source"),
        Panel(mesh, Values(g), f"target g = f at τ = {tau:g}", "target"),
    )
    below = (
        Panel(mesh, Streaks(velocity), "found field v", "result"),
        Panel(mesh, Values(speed(mesh, velocity), "speed"), "|v|", "result"),
        Panel(mesh, Values(matched), label, "result"),
        Panel(mesh, Values(difference, "|g − matched|"), "|g − matched|"),
    )
    setting = (
        f"{words.sized(name, mesh)}; the rotated gradient of eigenfunctions "
        f"{' and '.join(map(str, _MODES))} carries eigenfunction 7 to τ = {tau:g}, "
        f"on average {_WAY:g} sqrt(area) far.{note}"
    )
    return Findings(measures, Sheet((above, below)), setting)


def seen_rate(mesh: TriangleMesh, field: FloatArray, path: FloatArray) -> float:
    """Average ``<v, grad f_t>`` over the surface and the times of a path (T, V)."""
    squares = [root_mean_square(mesh, (field * slopes(mesh, f)).sum(axis=1)) ** 2 for f in path]
    return float(np.sqrt(np.mean(squares)))
