"""Figure 8: optical flow; a match recovers the field that generated the target."""

import numpy as np

from abfm import Flow, Problem, TriangleMesh, function
from abfm.experiments import scripts
from abfm.experiments.fields import gradient_field, root_mean_square, speed, stream_field
from abfm.experiments.scripts import Example, FigureSetup, Findings, Measure, RequestedMatch, Script
from abfm.io.sheets import Panel, Sheet, Streaks, Values
from abfm.parameters import TABLE_1
from abfm.types import FloatArray

_MODES = {2: 1.0, 5: 0.7}
_RMS_DISPLACEMENT = 0.15  # displacement of points until tau, in sqrt(area)
_SLOPE_SHARE_MIN = 0.2  # smallest |grad f|, relative to its maximum, where fields are compared
_ERROR_MAX = 0.02
_DIFFERENCE_MAX = 0.1  # criterion for "very close to the original field"


def figure_8(setup: FigureSetup) -> Script:
    """Match a function to its image under a known flow; compare the matched and the known field."""
    eight = ("eight.off", 1 if setup.small else 2)
    mesh, name = setup.surface("eight.off, Loop subdivided", scripts.loop_subdivided, *eight)
    parameters = TABLE_1[8].parameters(iterations=100 if setup.small else 200)
    tau, source = parameters.tau, "eigenfunction:7"
    hidden = Flow(mesh, stream_field(mesh, _MODES, _RMS_DISPLACEMENT / tau), tau)
    f = function(mesh, source)
    g = hidden.push(f)
    problem = Problem(mesh, f, g, parameters)
    yield Example(problem, name, ((source, "file:advected.npy"),))

    [found] = yield [RequestedMatch(problem)]
    setup.report("verifying", 0.95)
    verification, notes, missing = scripts.verification_measures(found)
    velocity, given_velocity, matched = found.velocity[0], hidden.velocity[0], found.advected[:, 0]
    gradient, error = gradient_field(mesh, f), velocity - given_velocity
    difference = np.abs(g - matched)
    steepness = np.linalg.norm(gradient, axis=1)
    is_steep = steepness > _SLOPE_SHARE_MIN * steepness.max()
    zeros = np.zeros_like(gradient)
    directions = np.divide(gradient, steepness[:, None], out=zeros, where=is_steep[:, None])
    components = [(field * directions).sum(axis=1) for field in (error, given_velocity)]
    along, along_given = (root_mean_square(mesh, component) for component in components)
    relative_error, largest = along / along_given, difference.max()
    path = hidden.push(f, np.linspace(0, tau, 21))
    rate_error = derivative_rms(mesh, error, path) / derivative_rms(mesh, given_velocity, path)
    field_error = root_mean_square(mesh, error) / root_mean_square(mesh, given_velocity)
    share = root_mean_square(mesh, is_steep.astype(float)) ** 2

    where = f"where |grad f| exceeds {_SLOPE_SHARE_MIN:.0%} of its maximum"
    of_slopes = f"error of the field along grad f, {where}, relative L2"
    of_path = "error of <v, grad f_t> over the path, relative L2 on the surface and in time"
    of_functions = "largest |g - f_tau|, f and g on the scale of 1"
    close = "very close to the original field"
    small = "the error between the functions is very small"
    measures = (
        Measure(of_slopes, relative_error, close, relative_error <= _DIFFERENCE_MAX),
        Measure(f"share of the surface {where}", share),
        Measure(of_path, rate_error),
        Measure("error of the complete field, relative L2", field_error),
        Measure(of_functions, largest, small, largest <= _ERROR_MAX, _ERROR_MAX),
        Measure("mismatch, relative L2", found.mismatch),
        *verification,
    )
    above = (
        Panel(mesh, Streaks(given_velocity), "given field v₀", "field"),
        Panel(mesh, Values(speed(mesh, given_velocity), "speed"), "|v₀|", "field"),
        Panel(mesh, Values(f), "source f", "source"),
        Panel(mesh, Values(g), f"target g = f at τ = {tau:g}", "target"),
    )
    below = (
        Panel(mesh, Streaks(velocity), "found field v", "result"),
        Panel(mesh, Values(speed(mesh, velocity), "speed"), "|v|", "result"),
        Panel(mesh, Values(matched), "matched", "result"),
        Panel(mesh, Values(difference, "|g − matched|"), "|g − matched|"),
    )
    setting = (
        f"{scripts.size_text(name, mesh)}; the rotated gradient of eigenfunctions "
        f"{' and '.join(map(str, _MODES))} advects eigenfunction 7 until τ = {tau:g}, "
        f"by {_RMS_DISPLACEMENT:g} sqrt(area) on average.{missing}"
    )
    return Findings(measures, Sheet((above, below), notes=notes), setting)


def derivative_rms(mesh: TriangleMesh, field: FloatArray, path: FloatArray) -> float:
    """Return the root mean square of ``<v, grad f_t>`` over the surface and the T functions f_t."""
    squares = [
        root_mean_square(mesh, (field * gradient_field(mesh, f)).sum(axis=1)) ** 2 for f in path
    ]
    return float(np.sqrt(np.mean(squares)))
