"""Choice of the norm of fields and of sigma that best predict held-out patches.

The patches of `abfm.matching.solving.held_out` are distributed over three intervals, spread over
time. With fewer intervals, each has several parts of the patches. The first norm is tried with
decreasing sigmas from the largest one. The other norms start from the fields of the first norm, at
a sigma of about the same smoothness. Smaller and larger sigmas are tried only for norms that
predict nearly as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from abfm.calculus.vector_fields import to_frame
from abfm.errors import ParameterError
from abfm.matching.match import match
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.held_out import fold_energies
from abfm.parameters import Parameters
from abfm.sequences.frames import Frames, interval_parameters, sigma_of
from abfm.sequences.noise import NOISE_FACTOR, noise_floor
from abfm.sequences.parameters import SequenceParameters
from abfm.sequences.phase_times import seconds_after
from abfm.sequences.solving.interval import COOLING_FACTOR, Interval, cooling
from abfm.types import FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

SIGMA_MAX = 9.0  # first sigma without initial fields, relative to the size of the frames
SIGMA_MIN = 0.1  # smallest sigma that is tried if none is given
_INTERVALS = 3  # number of intervals with held-out patches
_ITERATIONS = 3  # number of Gauss-Newton iterations for each sigma
_GAIN_SHARE_MIN = 0.001  # smallest gain, as a share of the explained held-out variance
# a long-range match is tried if all sigmas have a larger residual, relative to the initial one
_RESIDUAL_LARGE = 0.6
# a norm is tried with several sigmas if its residual is within this ratio of the smallest
_RESIDUAL_RATIO_MAX = 1.05
_LONG_RANGE = Parameters.of(sigma=0.3, segments=1, refine=0)  # parameters of long-range matches


class Norm(NamedTuple):
    """The norm of fields: its order and the weight of its Hodge Laplacian."""

    order: int
    alpha: float


class Choice(NamedTuple):
    """The norm and sigma of a sequence."""

    norm: Norm
    sigma: float


NORMS = (Norm(2, 0.1), Norm(2, 0.3), Norm(2, 0.03), Norm(1, 1.0))
"""The compared norms; the first is tried with all sigmas."""


def norms(given: SequenceParameters) -> list[Norm]:
    """Return the norms to choose from: those of `NORMS` that agree with the given parameters."""
    is_free = {name: name in given.automatic for name in ("order", "alpha")}
    found = [
        Norm(norm.order, norm.alpha if is_free["alpha"] else given.alpha)
        for norm in NORMS
        if is_free["order"] or norm.order == given.order
    ]
    return list(dict.fromkeys(found))


class _ChoiceInput(NamedTuple):
    """Input for the choice of norm and sigma.

    ``levels`` (C, V) are the standard deviations of the noise.
    """

    frames: Frames
    parameters: SequenceParameters
    levels: FloatArray

    def energy(self, interval: int, norm: Norm) -> MatchingEnergy:
        sigma = self.parameters.sigma or SIGMA_MAX
        found = interval_parameters(self.frames, self.parameters, sigma, interval)
        found = found.with_values(order=norm.order, alpha=norm.alpha)
        return MatchingEnergy(self.frames.problem(interval, found))


def choose_norm(frames: Frames, given: SequenceParameters, levels: FloatArray) -> Choice:
    """Return the norm with the smallest residual on held-out patches, and sigma.

    The patches are in a few intervals. Sigma is the largest one that, with this norm, explains
    nearly as much as the best sigma. Given parameters are not changed. Raises ParameterError if
    sigma is not given, and there are too few vertices to hold any out.
    """
    choice_input, candidates = _ChoiceInput(frames, given, levels), norms(given)
    given_norm = Norm(given.order, given.alpha)
    if given.sigma is not None and len(candidates) == 1:
        return Choice(candidates[0], given.sigma)
    sigmas = cooling(given.sigma or SIGMA_MIN, SIGMA_MAX)
    intervals = _spread(change_rates(frames), _INTERVALS)
    first = _HeldOut(choice_input, intervals, candidates[0], sigmas)
    if not first.searches:
        if given.sigma is not None:
            return Choice(given_norm, given.sigma)
        raise ParameterError("too few vertices are compared to choose sigma; give a sigma")
    after = seconds_after("choosing sigma", frames)
    with step("choosing sigma", len(frames.mesh.vertices), after=after) as report:
        count, found = len(candidates), [first]
        first.scan(lambda share: report(share / count))
        for number, norm in enumerate(candidates[1:]):
            other = _HeldOut(choice_input, intervals, norm, sigmas)
            other.start_near(first, min(each.best_residual for each in found))
            found.append(other)
            report((number + 2) / count)
    best = min(found, key=lambda each: each.best_residual)
    return Choice(best.norm, given.sigma or best.largest_sigma())


class _HeldOut:
    """Residuals on the held-out patches of a few intervals, with one norm, for each tried sigma."""

    def __init__(
        self, given: _ChoiceInput, intervals: Sequence[int], norm: Norm, sigmas: Sequence[float]
    ) -> None:
        self.norm, self._sigmas = norm, sigmas
        self._is_given = given.parameters.sigma is not None
        count = len(intervals)
        searches = [
            _IntervalSearch(given, i, norm, start, count) for start, i in enumerate(intervals)
        ]
        self.searches = [search for search in searches if search.folds]
        self._residuals: dict[float, float] = {}
        self._fields: dict[float, list[list[FloatArray]]] = {}
        if self.searches:
            pairs = [(search.initial_residual, search.noise) for search in self.searches]
            squares = np.mean([(initial**2, noise**2) for initial, noise in pairs], axis=0)
            self.initial_residual, self._noise = np.sqrt(squares)

    @property
    def _best_sigma(self) -> float:
        if self._is_given:
            return self._sigmas[-1]
        return min(self._residuals, key=lambda sigma: (self._residuals[sigma], -sigma))

    @property
    def best_residual(self) -> float:
        return self._residuals[self._best_sigma]

    def largest_sigma(self) -> float:
        """Return the largest sigma whose residual is hardly larger than the smallest one."""
        gain = max(self.initial_residual**2 - self.best_residual**2, 0.0)
        enough = self.best_residual**2 + _GAIN_SHARE_MIN * gain
        return max(sigma for sigma, residual in self._residuals.items() if residual**2 <= enough)

    def scan(self, report: Callable[[float], None]) -> None:
        """Decrease sigma until the residual on the held-out patches grows.

        If the smallest residual is large, do this also from long-range matches. ``report`` gets the
        finished share.
        """
        self._descend(report)
        large = max(_RESIDUAL_LARGE * self.initial_residual, NOISE_FACTOR * self._noise)
        if self.best_residual > large:
            best_residual, earlier = self.best_residual, (self._residuals, self._fields)
            self._residuals, self._fields = {}, {}
            with step("searching at long range"):
                for search in self.searches:  # later minimisations start from these fields
                    search.starts = [long_range_field(fold.energy) for fold, _ in search.folds]
            self._descend(report)
            if best_residual <= self.best_residual:
                self._residuals, self._fields = earlier
                for search in self.searches:
                    search.starts = []

    def _descend(self, report: Callable[[float], None]) -> None:
        fields = [search.zero_fields for search in self.searches]
        for number, sigma in enumerate(self._sigmas):
            fields = self._minimise(sigma, fields)
            report((number + 1) / len(self._sigmas))
            is_worse = not self._is_given and self._best_sigma != sigma
            if is_worse and not self.searches[0].starts:
                break

    def start_near(self, other: _HeldOut, best: float) -> None:
        """Try a sigma with this norm, starting from the fields of another norm.

        It gives about the same smoothness as the best sigma of the other norm. If the new residual
        is at most `_RESIDUAL_RATIO_MAX` times the smallest earlier one, ``best``, smaller and
        larger sigmas are also tried.
        """
        for search, of_other in zip(self.searches, other.searches, strict=True):
            search.starts = of_other.starts
        at = self._sigmas.index(other._best_sigma)
        if self.norm.order == other.norm.order and not self._is_given:
            at += round(float(np.log(self.norm.alpha / other.norm.alpha) / np.log(COOLING_FACTOR)))
        at = int(np.clip(at, 0, len(self._sigmas) - 1))
        self._minimise(self._sigmas[at], other._fields[other._best_sigma])
        if self._is_given or self.best_residual > _RESIDUAL_RATIO_MAX * best:
            return
        if not self._improve(at, 1) and self.best_residual <= best:
            self._improve(at, -1)

    def _improve(self, at: int, direction: int) -> bool:
        """Try smaller (``direction`` 1) or larger (-1) sigmas while the residual falls.

        They begin next to the sigma of index ``at``. Return whether the residual fell.
        """
        fields, start = self._fields[self._sigmas[at]], at
        while 0 <= at + direction < len(self._sigmas):
            at += direction
            fields = self._minimise(self._sigmas[at], fields)
            if self._best_sigma != self._sigmas[at]:
                break
        return self._best_sigma != self._sigmas[start]

    def _minimise(self, sigma: float, fields: list[list[FloatArray]]) -> list[list[FloatArray]]:
        pairs = zip(self.searches, fields, strict=True)
        found = [search.minimise(sigma, starts) for search, starts in pairs]
        self._residuals[sigma] = float(np.sqrt(np.mean([square for square, _ in found])))
        self._fields[sigma] = [fields for _, fields in found]
        return self._fields[sigma]


class _IntervalSearch:
    """Fields of one interval, one for each fold of a cross-validation.

    The field of a fold is found without the patches that the fold holds out. Only every
    ``count``-th fold is used, beginning with ``start``.
    """

    def __init__(
        self, given: _ChoiceInput, interval: int, norm: Norm, start: int, count: int
    ) -> None:
        energy = given.energy(interval, norm)
        self._functions, self._given = energy.functions, given
        self._duration = energy.parameters.tau
        self.initial_residual = energy.residual(energy.functions.source)
        self.noise = noise_floor(energy.functions, given.levels)
        folds = fold_energies(energy)[start::count]
        self.folds = [(Interval(part), hidden) for part, hidden in folds]
        self.zero_fields = [np.zeros(energy.shape[1:])] * len(self.folds)
        self.starts: list[FloatArray] = []
        """Long-range fields from which each sigma starts; large sigmas would lose them."""

    def minimise(
        self, sigma: float, fields: Sequence[FloatArray]
    ) -> tuple[float, list[FloatArray]]:
        """Minimise the energy in each cross-validation fold, from initial fields (F, 2).

        Long-range fields replace the initial fields once they are found. Return the mean squared
        residual on the held-out patches, and the fields.
        """
        given, squares, found = self._given, list[float](), list[FloatArray]()
        sigma = sigma_of(given.frames, given.parameters, sigma, self._duration)
        for (interval, hidden), start in zip(self.folds, self.starts or fields, strict=True):
            checkpoint()
            point = interval.minimise(sigma, start, _ITERATIONS)
            found.append(point.field)
            advected = point.at.advected[: len(self._functions.source)]
            squares.append(self._functions.with_mask(hidden).residual(advected) ** 2)
        return float(np.mean(squares)), found


def long_range_field(energy: MatchingEnergy) -> FloatArray:
    """Return the field (F, 2) of a match that compares functions over long distances.

    The match has an end time of 1, because the duration of the interval would change the balance of
    the energy terms.
    """
    found = match(energy.problem.with_parameters(_LONG_RANGE))
    speed = found.parameters.tau / (energy.parameters.tau * energy.length_scale)
    return to_frame(energy.mesh, found.velocity[0] * speed)


def change_rates(frames: Frames) -> FloatArray:
    """Return the norm of the rate of change in each interval, by mask and weights, (T - 1,)."""
    durations = frames.durations
    counts = np.sqrt(frames.weights) * np.ones((len(frames.mesh.vertices), 1))
    if frames.mask is not None:
        counts *= np.sqrt(frames.mask)[:, None]
    steps = np.diff(frames.values, axis=0)
    return np.array([np.linalg.norm(counts * each) for each in steps]) / durations


def _spread(changed: FloatArray, count: int) -> list[int]:
    """Return the indices of ``count`` intervals with large changes, spread over time.

    Each is at the upper quartile of the changes in one of ``count`` parts of time.
    """
    parts = np.array_split(np.arange(len(changed)), min(count, len(changed)))
    return [
        int(part[np.argsort(changed[part], kind="stable")[(3 * len(part)) // 4]]) for part in parts
    ]
