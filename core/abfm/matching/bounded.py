"""The closest match whose map distorts no more than it may."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from abfm.errors import ParameterError, brief
from abfm.maps.distortion import Distortion
from abfm.matching.match import Match, match
from abfm.numerics.real_numbers import is_finite_number
from abfm.workers.control import Control
from abfm.workers.progress import step

SHARE = 0.99
"""Of the faces, that keep a bound: single ones, as at the ends of creases, may be beyond it."""
_BISECTIONS = 3  # of sigma between two steps
_SMOOTHER = 3.0  # times sigma, where the first step distorts too much
_MOST_SMOOTHER = 3


def bounded(
    found: Match,
    most: float,
    measure: Callable[[Match], Distortion] = Match.distortion,
    control: Control | None = None,
) -> Match:
    """Return the closest match on the way of a match of whose faces 99% keep a bound: neither
    ``|log2 J|`` of areas nor ``|log2 R|`` of shapes is more than ``most``.

    It is looked for on the path, and then between two of its steps with sigmas between theirs, each
    from the field of the smoother one, so that the path goes on to it. Where even much smoother
    fields exceed the bound the smoothest one comes back: see `keeps`.

    Raises
    ------
    ParameterError
        If the bound is no positive number.
    """
    if not (is_finite_number(most) and most > 0):
        raise ParameterError(f"max_distortion is {brief(most)}; expected a positive number")
    with step("looking for the closest field within the bound"):
        if keeps(found, most, measure):
            return found
        below, above = _between(found, most, measure)
        if below is None:
            below = _smoother(found, most, measure, control)
            if not keeps(below, most, measure):
                return below
        for _ in range(_BISECTIONS):
            sigma = math.sqrt(below.path[below.step].sigma * above)
            tried = _with_sigma(below, sigma, control)
            if keeps(tried, most, measure):
                below = tried
            else:
                above = sigma
    return below


def keeps(
    found: Match, most: float, measure: Callable[[Match], Distortion] = Match.distortion
) -> bool:
    """Tell whether 99% of the faces keep a bound of distortion, and none is folded."""
    told = measure(found)
    return told.share_within(most) >= SHARE and not told.folded


def _between(
    found: Match, most: float, measure: Callable[[Match], Distortion]
) -> tuple[Match | None, float]:
    """Return the last step that keeps the bound, and the sigma of the one after."""
    low, high = -1, found.step
    best = None
    while high - low > 1:
        middle = (low + high) // 2
        tried = found.at_step(middle)
        if keeps(tried, most, measure):
            low, best = middle, tried
        else:
            high = middle
    return best, found.path[high].sigma


def _smoother(
    found: Match, most: float, measure: Callable[[Match], Distortion], control: Control | None
) -> Match:
    """Return a match with a larger sigma than any on the path: the first that keeps the bound, or
    the smoothest one.
    """
    first = found.at_step(0)
    sigma = first.path[0].sigma
    for _ in range(_MOST_SMOOTHER):
        sigma *= _SMOOTHER
        parameters = replace(found.parameters, sigma=sigma)
        first = match(found.problem.with_parameters(parameters), control=control)
        if keeps(first, most, measure):
            break
    return replace(first, path=(), step=0)


def _with_sigma(below: Match, sigma: float, control: Control | None) -> Match:
    """Return the match with a sigma, from the field of a smoother one, at the end of its path."""
    parameters = replace(below.parameters, sigma=sigma, cooling_stages=1)
    problem = below.problem.with_parameters(parameters).starting_from(below.fine_velocity)
    found = match(problem, control=control)
    path = (*below.path[: below.step + 1], found.path[found.step])
    return replace(found, path=path, step=len(path) - 1)
