"""The function `limit_distortion`: a match whose map has a bounded distortion."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

from abfm.errors import AbfmError, ParameterError, brief
from abfm.maps.distortion import BOUNDED_SHARE as BOUNDED_SHARE
from abfm.maps.distortion import Distortion
from abfm.matching.match import match
from abfm.matching.path import PathStep
from abfm.matching.result import Match
from abfm.matching.solving.schedule import Schedule
from abfm.numerics.real_numbers import is_finite_number
from abfm.parameters import Parameters
from abfm.types import FloatArray
from abfm.workers.control import Control, current_control
from abfm.workers.progress import step

_MATCHES_MAX = 3  # number of matches between two steps; each takes as long as the first match
_SCALED_STEPS_MAX = 3  # number of steps beyond the bound whose fields are scaled down
_SCALINGS_MAX = 6  # number of scale factors that are tried for one step
_BOUND_SHARE_MIN = 0.98  # a distortion above this share of the bound is close enough
_INTERVAL_MARGIN = 0.1  # least distance of a scale factor from the ends, relative to the interval
# if the first step exceeds the bound, the search begins at this multiple of its sigma
_SIGMA_FACTOR = 3.0


class _Sigmas(NamedTuple):
    """The values of sigma and landmark_sigma in one step of a match."""

    sigma: float
    landmark_sigma: float

    def smoother(self) -> _Sigmas:
        return _Sigmas(_SIGMA_FACTOR * self.sigma, _SIGMA_FACTOR * self.landmark_sigma)

    def middle(self, other: _Sigmas) -> _Sigmas:
        return _Sigmas(*(math.sqrt(a * b) for a, b in zip(self, other, strict=True)))


def limit_distortion(
    found: Match,
    max_distortion: float,
    measure: Callable[[Match], Distortion] = Match.distortion,
    control: Control | None = None,
) -> Match:
    """Return the match with the smallest residual whose distortion is within a bound.

    Within the bound, no face is folded, and ``|log2 J|`` and ``|log2 R|`` are at most
    ``max_distortion`` on 99% of the faces. ``J`` is the factor by which the area of a face changes.
    ``R`` is the ratio of the two principal stretches of a face.

    If the given match is within the bound, it is the result. Otherwise the result is one of these
    candidates:

    - the field without motion,
    - the steps of the path,
    - scaled fields of steps beyond the bound,
    - matches with a sigma between two steps.

    The result is the candidate within the bound whose larger residual of both checks is smallest.
    The checks are the discrete flow and flow lines. The path of the result consists of the steps
    within the bound. If no candidate is within the bound, the given match is returned; this happens
    if the initial map of a registration already exceeds the bound. The attribute ``bound`` of the
    result describes its distortion.

    Parameters
    ----------
    found : Match
        Match whose distortion is limited.
    max_distortion : float
        Bound of ``|log2 J|`` and ``|log2 R|``.
    measure : callable, optional
        Function that returns the distortion of a match. The default measures the flow.
        Registrations measure the complete map.
    control : Control, optional
        Object that pauses, resumes or cancels the search from another thread.

    Returns
    -------
    Match

    Raises
    ------
    ParameterError
        If the bound is not a positive number.
    """
    check_bound(max_distortion)
    with step("searching for the best field within the bound"):
        bound = measure(found).bound(max_distortion)
        if bound.is_satisfied:
            return found if found.bound == bound else replace(found, bound=bound)
        search = _Search(found, max_distortion, measure, control or current_control())
        search.run()
        if search.best is None:
            return found.with_bound(bound)
        return search.best.with_bound(measure(search.best).bound(max_distortion))


def check_bound(max_distortion: float) -> None:
    """Raise ParameterError unless the bound is a positive number."""
    if not (is_finite_number(max_distortion) and max_distortion > 0):
        raise ParameterError(
            f"max_distortion is {brief(max_distortion)}; expected a positive number"
        )


class _Search:
    """The search of `limit_distortion` for the best match within the bound."""

    def __init__(
        self,
        found: Match,
        max_distortion: float,
        measure: Callable[[Match], Distortion],
        control: Control | None,
    ) -> None:
        self._found, self._max_distortion = found, max_distortion
        self._measure, self._control = measure, control
        self._path: list[PathStep] = []  # the steps of the path within the bound
        self._distortion_at_rest = math.inf
        self.best: Match | None = None  # the best match within the bound

    def run(self) -> None:
        found, first = self._found, self._found.path[0]
        start, number = found.with_step(_scaled(first, 0.0)), -1
        self._distortion_at_rest = self._distortion(start)
        if self._distortion_at_rest <= self._max_distortion:
            self._update(start)
        beyond = list[tuple[PathStep, float]]()
        for index, each in enumerate(found.path):
            match = found.at_step(index)
            distortion = self._distortion(match)
            if distortion > self._max_distortion:
                beyond.append((each, distortion))
                continue
            if math.isnan(match.verified_residual):
                match = found.with_step(each)
            self._path.append(match.path[match.step])
            if self._update(match):
                start, number = match, index
        if self.best is None:
            return
        for each, distortion in beyond[:_SCALED_STEPS_MAX]:
            self._scale_down(each, distortion)
        self._between(start, number)
        self._set_path()

    def _update(self, match: Match) -> bool:
        """Store a match as the best one if its residual is smaller; return whether it was."""
        is_better = self.best is None or match.worse_residual < self.best.worse_residual
        if is_better:
            self.best = match
        return is_better

    def _distortion(self, match: Match) -> float:
        """Return the distortion that 99% of the faces do not exceed; inf if a face is folded."""
        bound = self._measure(match).bound(self._max_distortion)
        return math.inf if bound.folded else bound.largest

    def _distortion_of(self, velocity: FloatArray) -> float:
        return self._distortion(replace(self._found, fine_velocity=velocity, path=(), step=0))

    def _scale_down(self, beyond: PathStep, distortion: float) -> None:
        velocity, low, high = beyond.velocity, 0.0, 1.0
        at_low, at_high = self._distortion_at_rest, distortion
        for _ in range(_SCALINGS_MAX):
            if not _BOUND_SHARE_MIN * self._max_distortion > at_low:
                break
            share = (self._max_distortion - at_low) / (at_high - at_low)
            middle = low + (high - low) * min(max(share, _INTERVAL_MARGIN), 1 - _INTERVAL_MARGIN)
            at_middle = self._distortion_of(middle * velocity)
            if at_middle <= self._max_distortion:
                low, at_low = middle, at_middle
            else:
                high, at_high = middle, at_middle
        if low:
            with suppress(AbfmError):  # raised for fields that cannot advect the source to tau
                self._update(self._found.with_step(_scaled(beyond, low)))

    def _between(self, start: Match, number: int) -> None:
        """Solve matches with sigma between the best step within the bound and the next step.

        ``number`` is the index of the best step, or -1 if only the field without motion is within
        the bound. Each match starts from the latest fields within the bound.
        """
        path = self._found.path
        low = self._sigmas(path[number]) if number >= 0 else self._sigmas(path[0]).smoother()
        later = [each for each in map(self._sigmas, path[number + 1 :]) if each.sigma < low.sigma]
        if not later:
            return
        high = later[0]
        for _ in range(_MATCHES_MAX):
            if self._control is not None and self._control.cancelled:
                return
            middle = low.middle(high)
            problem = self._found.problem.with_parameters(self._at(middle))
            tried = match(problem.starting_from(start.fine_velocity), control=self._control)
            result = tried.path[tried.step]
            distortion = self._distortion_of(result.velocity)
            if distortion <= self._max_distortion:
                start, low = self._found.with_step(result), middle
                self._update(start)
            else:
                self._scale_down(result, distortion)
                high = middle

    def _set_path(self) -> None:
        """Set the path to all steps within the bound, including the best one."""
        assert self.best is not None
        selected = self.best.path[self.best.step]
        numbers = [i for i, each in enumerate(self._path) if each.velocity is selected.velocity]
        if numbers:
            path, number = tuple(self._path), numbers[0]
        else:
            path, number = (*self._path, selected), len(self._path)
        self.best = replace(self.best, path=path, step=number)

    def _sigmas(self, step: PathStep) -> _Sigmas:
        problem = self._found.problem
        has_landmarks = problem.landmarks is not None
        schedule = Schedule(problem.parameters, problem.functions, 1, has_landmarks)
        return _Sigmas(step.sigma, schedule.landmark_sigma(step.sigma))

    def _at(self, sigmas: _Sigmas) -> Parameters:
        found = self._found
        changed = found.parameters.with_values(sigma=sigmas.sigma, cooling_stages=1)
        if found.problem.landmarks is None:
            return changed
        return replace(changed, landmark_sigma=sigmas.landmark_sigma)


def _scaled(step: PathStep, times: float) -> PathStep:
    """Return a step with its fields multiplied by ``times``, without a cross-validation score."""
    return replace(step, velocity=times * step.velocity, held_out=math.nan, score=math.nan)
