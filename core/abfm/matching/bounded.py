"""The closest match whose map keeps a bound of distortion."""

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

_MATCHES_MAX = 3  # matches with a sigma between two steps, each about as long as the first match
_SHRUNK_STEPS = 3  # steps beyond the bound that are shrunk
_SHRINKINGS = 6  # fields that are measured to shrink one
_SHARE_CLOSE = 0.98  # of the bound: what comes closer to it is not shrunk less
_SHARE_MARGIN = 0.1  # share of an interval at either end in which no field is measured
_SIGMA_FACTOR = 3.0  # times sigma, for fields that are smoother than the first step


class _Weights(NamedTuple):
    """Of functions and of landmarks against the smoothness: both fall along a path."""

    sigma: float
    landmark_sigma: float

    def smoother(self) -> _Weights:
        return _Weights(_SIGMA_FACTOR * self.sigma, _SIGMA_FACTOR * self.landmark_sigma)

    def middle(self, other: _Weights) -> _Weights:
        return _Weights(*(math.sqrt(a * b) for a, b in zip(self, other, strict=True)))


def limit_distortion(
    found: Match,
    most: float,
    measure: Callable[[Match], Distortion] = Match.distortion,
    control: Control | None = None,
) -> Match:
    """Return the closest match that keeps a bound: for 99% of the faces neither ``|log2 J|`` of
    areas nor ``|log2 R|`` of shapes is more than ``most``, and no face is folded.

    If the match itself keeps the bound, it is the result. If not, the candidates are the field
    without motion, the steps of its path, fields of steps beyond the bound times a factor, and
    matches with sigmas between two steps. Of those that keep the bound, the result is the one with
    the smallest residual of both checks: never larger than of any step that keeps the bound, or
    without motion if that keeps it. Its path has the steps that keep the bound. If no candidate
    keeps it, as where the initial map of a registration is beyond it, the match comes back. The
    ``bound`` of the result says how it keeps the bound.

    Parameters
    ----------
    found : Match
    most : float
        Bound of ``|log2 J|`` and ``|log2 R|``.
    measure : callable, optional
        Returns the distortion that is bounded; by default that of the flow, for registrations that
        of the complete map.
    control : Control, optional
        To pause, resume or cancel from elsewhere.

    Raises
    ------
    ParameterError
        If the bound is no positive number.
    """
    check_bound(most)
    with step("looking for the closest field within the bound"):
        bound = measure(found).bound(most)
        if bound.is_kept:
            return found if found.bound == bound else replace(found, bound=bound)
        search = _Search(found, most, measure, control or current_control())
        search.run()
        if search.best is None:
            return found.within(bound)
        return search.best.within(measure(search.best).bound(most))


def check_bound(most: float) -> None:
    """Refuse a bound that is no positive number, by a ParameterError."""
    if not (is_finite_number(most) and most > 0):
        raise ParameterError(f"max_distortion is {brief(most)}; expected a positive number")


class _Search:
    """A search for the closest match within a bound; ``best`` is the closest one so far."""

    def __init__(
        self,
        found: Match,
        most: float,
        measure: Callable[[Match], Distortion],
        control: Control | None,
    ) -> None:
        self._found, self._most, self._measure, self._control = found, most, measure, control
        self._path: list[PathStep] = []  # its steps that keep the bound
        self._still = math.inf  # distortion without motion
        self.best: Match | None = None

    def run(self) -> None:
        """Try all candidates after a match that is beyond the bound."""
        found, first = self._found, self._found.path[0]
        start, number = found.with_step(_scaled(first, 0.0)), -1
        self._still = self._distortion(start)
        if self._still <= self._most:
            self._take(start)
        beyond = list[tuple[PathStep, float]]()
        for index, each in enumerate(found.path):
            match = found.at_step(index)
            distortion = self._distortion(match)
            if distortion > self._most:
                beyond.append((each, distortion))
                continue
            if math.isnan(match.verified_residual):
                match = found.with_step(each)
            self._path.append(match.path[match.step])
            if self._take(match):
                start, number = match, index
        if self.best is None:
            return
        for each, distortion in beyond[:_SHRUNK_STEPS]:
            self._shrink(each, distortion)
        self._between(start, number)
        self._join()

    def _take(self, match: Match) -> bool:
        """Take a match that keeps the bound if it is the closest one so far."""
        is_closer = self.best is None or match.worse_residual < self.best.worse_residual
        if is_closer:
            self.best = match
        return is_closer

    def _distortion(self, match: Match) -> float:
        """Return the distortion that 99% of the faces keep; infinity if one is folded."""
        bound = self._measure(match).bound(self._most)
        return math.inf if bound.folded else bound.largest

    def _distortion_of(self, velocity: FloatArray) -> float:
        return self._distortion(replace(self._found, fine_velocity=velocity, path=(), step=0))

    def _shrink(self, beyond: PathStep, distortion: float) -> None:
        """Try fields beyond the bound times the largest factor found that keeps it."""
        velocity, low, high = beyond.velocity, 0.0, 1.0
        at_low, at_high = self._still, distortion
        for _ in range(_SHRINKINGS):
            if not _SHARE_CLOSE * self._most > at_low:
                break
            share = (self._most - at_low) / (at_high - at_low)
            middle = low + (high - low) * min(max(share, _SHARE_MARGIN), 1 - _SHARE_MARGIN)
            at_middle = self._distortion_of(middle * velocity)
            if at_middle <= self._most:
                low, at_low = middle, at_middle
            else:
                high, at_high = middle, at_middle
        if low:
            with suppress(AbfmError):  # fields that carry nothing to their end
                self._take(self._found.with_step(_scaled(beyond, low)))

    def _between(self, start: Match, number: int) -> None:
        """Try sigmas between those of a step that keeps the bound and of the next one, each from
        the field of the smoother one.
        """
        path = self._found.path
        low = self._weights(path[number]) if number >= 0 else self._weights(path[0]).smoother()
        later = [each for each in map(self._weights, path[number + 1 :]) if each.sigma < low.sigma]
        if not later:
            return
        high = later[0]
        for _ in range(_MATCHES_MAX):
            if self._control is not None and self._control.cancelled:
                return
            middle = low.middle(high)
            problem = self._found.problem.with_parameters(self._at(middle))
            tried = match(problem.starting_from(start.fine_velocity), control=self._control)
            own = tried.path[tried.step]
            distortion = self._distortion_of(own.velocity)
            if distortion <= self._most:
                start, low = self._found.with_step(own), middle
                self._take(start)
            else:
                self._shrink(own, distortion)
                high = middle

    def _join(self) -> None:
        """Let the path of the best match be the steps that keep the bound, with its own."""
        assert self.best is not None
        own = self.best.path[self.best.step]
        numbers = [i for i, each in enumerate(self._path) if each.velocity is own.velocity]
        if numbers:
            path, number = tuple(self._path), numbers[0]
        else:
            path, number = (*self._path, own), len(self._path)
        self.best = replace(self.best, path=path, step=number)

    def _weights(self, step: PathStep) -> _Weights:
        """Return the weights with which a step of the path was found."""
        problem = self._found.problem
        has_landmarks = problem.landmarks is not None
        schedule = Schedule(problem.parameters, problem.functions, 1, has_landmarks)
        return _Weights(step.sigma, schedule.landmark_sigma(step.sigma))

    def _at(self, weights: _Weights) -> Parameters:
        found = self._found
        changed = found.parameters.with_values(sigma=weights.sigma, cooling_stages=1)
        if found.problem.landmarks is None:
            return changed
        return replace(changed, landmark_sigma=weights.landmark_sigma)


def _scaled(step: PathStep, times: float) -> PathStep:
    """Return a step with its fields times a number, which was not held out."""
    return replace(step, velocity=times * step.velocity, held_out=math.nan, score=math.nan)
