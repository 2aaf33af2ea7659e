"""The closest match whose map distorts no more than it may."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from abfm.errors import ParameterError, brief
from abfm.maps.distortion import Distortion
from abfm.matching.match import Match, match
from abfm.matching.path import PathStep
from abfm.matching.solving.course import Course
from abfm.numerics.real_numbers import is_finite_number
from abfm.parameters import Parameters
from abfm.workers.control import Control
from abfm.workers.progress import step

SHARE = 0.99
"""Of the faces, that keep a bound: single ones, as at the ends of creases, may be beyond it."""
_BISECTIONS = 3  # of sigma between two steps
_SMOOTHER = 3.0  # times sigma, where the first step distorts too much
_MOST_SMOOTHER = 3
_MOST = 4  # matches that are tried, each of which takes at most about as long as the first one


class _Weights(NamedTuple):
    """Of functions and of landmarks against the smoothness: both fall along a path."""

    sigma: float
    landmark_sigma: float

    def smoother(self) -> _Weights:
        return _Weights(_SMOOTHER * self.sigma, _SMOOTHER * self.landmark_sigma)

    def middle(self, other: _Weights) -> _Weights:
        return _Weights(*(math.sqrt(a * b) for a, b in zip(self, other, strict=True)))


def bounded(
    found: Match,
    most: float,
    measure: Callable[[Match], Distortion] = Match.distortion,
    control: Control | None = None,
    at_rest: Callable[[], Distortion] | None = None,
) -> Match:
    """Return the closest match on the way of a match that keeps a bound: for 99% of the faces
    neither ``|log2 J|`` of areas nor ``|log2 R|`` of shapes is more than ``most``, and no face is
    folded, as a folded one is beyond any bound.

    It is looked for on the path, and then between two of its steps with sigmas between theirs, and
    such weights of landmarks, each from the field of the smoother one, so that the path goes on to
    it. Where even much smoother fields exceed the bound the smoothest one comes back; where the map
    that is measured does so ``at_rest``, without any flow, and on all of the path, none is looked
    for, and the match comes back as it is: see `keeps`.

    Raises
    ------
    ParameterError
        If the bound is no positive number.
    """
    check_bound(most)
    with step("looking for the closest field within the bound"):
        if keeps(found, most, measure):
            return found
        below, above = _between(found, most, measure)
        tried = 0
        if below is not None:
            low = _weights(found, below.path[below.step])
        elif at_rest is not None and not is_kept(at_rest(), most):
            return found
        else:
            for _ in range(_MOST_SMOOTHER):
                low, tried = above.smoother(), tried + 1
                below = smoothest = _smooth(found, low, control)
                if keeps(smoothest, most, measure):
                    break
                above = low
            else:
                return smoothest
        for _ in range(min(_BISECTIONS, _MOST - tried)):
            middle = low.middle(above)
            closer = _with_weights(below, middle, control)
            if keeps(closer, most, measure):
                below, low = closer, middle
            else:
                above = middle
    return below


def check_bound(most: float) -> None:
    """Refuse a bound that is no positive number, by a ParameterError."""
    if not (is_finite_number(most) and most > 0):
        raise ParameterError(f"max_distortion is {brief(most)}; expected a positive number")


def keeps(
    found: Match, most: float, measure: Callable[[Match], Distortion] = Match.distortion
) -> bool:
    """Tell whether 99% of the faces keep a bound of distortion, and none is folded."""
    return is_kept(measure(found), most)


def is_kept(told: Distortion, most: float) -> bool:
    """Tell the same of a distortion."""
    return told.share_within(most) >= SHARE and not told.folded


def _weights(found: Match, step: PathStep) -> _Weights:
    """Return what a step of a match's path was found with."""
    problem = found.problem
    course = Course(found.parameters, problem.functions, 1, problem.landmarks is not None)
    return _Weights(step.sigma, course.landmark_sigma(step.sigma))


def _between(
    found: Match, most: float, measure: Callable[[Match], Distortion]
) -> tuple[Match | None, _Weights]:
    """Return the last step that keeps the bound, and the weights of the one after."""
    low, high = -1, found.step
    best = None
    while high - low > 1:
        middle = (low + high) // 2
        tried = found.at_step(middle)
        if keeps(tried, most, measure):
            low, best = middle, tried
        else:
            high = middle
    return best, _weights(found, found.path[high])


def _smooth(found: Match, weights: _Weights, control: Control | None) -> Match:
    """Return a match that is smoother than any on the path."""
    first = match(found.problem.with_parameters(_at(found, weights)), control=control)
    return replace(first, path=(), step=0)


def _with_weights(below: Match, weights: _Weights, control: Control | None) -> Match:
    """Return the match with other weights, from the field of a smoother one, at the end of its
    path.
    """
    problem = below.problem.with_parameters(_at(below, weights))
    found = match(problem.starting_from(below.fine_velocity), control=control)
    path = (*below.path[: below.step + 1], found.path[found.step])
    return replace(found, path=path, step=len(path) - 1)


def _at(found: Match, weights: _Weights) -> Parameters:
    changed = replace(found.parameters, sigma=weights.sigma, cooling_stages=1)
    if found.problem.landmarks is None:
        return changed
    return replace(changed, landmark_sigma=weights.landmark_sigma)
