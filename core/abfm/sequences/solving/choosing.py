"""Which norm of fields and which sigma suit a sequence: those that predict held-out patches best.

The patches of `abfm.matching.solving.held_out` are dealt out to three intervals, spread over time;
of fewer intervals each has several parts of them. The first norm is followed from the largest sigma
down. The others begin at its fields, at the sigma that is about as smooth with them, and try
smaller and larger ones only where that predicts nearly as well.
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
from abfm.sequences.solving.interval import COOLING_FACTOR, Interval, cooling
from abfm.types import FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

SIGMA_MAX = 9.0
"""Sigma with which a search without a start begins, in deviations of the frames."""
SIGMA_MIN = 0.1
"""The smallest sigma that is tried where none is given."""
_INTERVALS = 3  # intervals by which the choice is made
_ITERATIONS = 3  # of Gauss-Newton with each sigma there
_GAIN_SHARE_MIN = 0.001  # share of what any choice explains of the variance that was held out
_RESIDUAL_LARGE = 0.6  # of what was held out: where any sigma leaves more, a match looks further
_RESIDUAL_RATIO_MAX = (
    1.05  # times the least residual, within which a norm is worth more than one sigma
)
_LONG_RANGE = Parameters.of(sigma=0.3, segments=1, refine=0)  # of a match that looks further


class Norm(NamedTuple):
    """The norm of fields: its order, and the weight of its Hodge Laplacian."""

    order: int
    alpha: float


class Choice(NamedTuple):
    """What a sequence is solved with."""

    norm: Norm
    sigma: float


NORMS = (Norm(2, 0.1), Norm(2, 0.3), Norm(2, 0.03), Norm(1, 1.0))
"""Those that are compared; the first is followed through all sigmas."""


def norms(given: SequenceParameters) -> list[Norm]:
    """Return the norms to choose from: those in `NORMS` with the values that are given."""
    is_free = {name: name in given.automatic for name in ("order", "alpha")}
    found = [
        Norm(norm.order, norm.alpha if is_free["alpha"] else given.alpha)
        for norm in NORMS
        if is_free["order"] or norm.order == given.order
    ]
    return list(dict.fromkeys(found))


class _ChoiceInput(NamedTuple):
    """What norm and sigma are chosen for; levels are those of the noise at vertices."""

    frames: Frames
    parameters: SequenceParameters
    levels: FloatArray

    def energy(self, interval: int, norm: Norm) -> MatchingEnergy:
        """Return the energy of an interval with a norm of fields."""
        sigma = self.parameters.sigma or SIGMA_MAX
        found = interval_parameters(self.frames, self.parameters, sigma, interval)
        found = found.with_values(order=norm.order, alpha=norm.alpha)
        return MatchingEnergy(self.frames.problem(interval, found))


def choose_norm(frames: Frames, given: SequenceParameters, levels: FloatArray) -> Choice:
    """Return the norm with the smallest residual on held-out patches of a few intervals, and the
    largest sigma that explains nearly as much with it as its best one.

    Raises
    ------
    ParameterError
        If there are too few vertices to hold any out, and sigma is not given.
    """
    made_for, candidates = _ChoiceInput(frames, given, levels), norms(given)
    usual = Norm(given.order, given.alpha)
    if given.sigma is not None and len(candidates) == 1:
        return Choice(candidates[0], given.sigma)
    sigmas = cooling(given.sigma or SIGMA_MIN, SIGMA_MAX)
    looked_at = _spread(change_rates(frames), _INTERVALS)
    first = _HeldOut(made_for, looked_at, candidates[0], sigmas)
    if not first.walks:
        if given.sigma is not None:
            return Choice(usual, given.sigma)
        raise ParameterError("too few vertices are compared to choose sigma by; give one")
    with step("choosing sigma") as report:
        count, found = len(candidates), [first]
        first.follow_all(lambda share: report(share / count))
        for number, norm in enumerate(candidates[1:]):
            other = _HeldOut(made_for, looked_at, norm, sigmas)
            other.look_near(first, min(each.least for each in found))
            found.append(other)
            report((number + 2) / count)
    best = min(found, key=lambda each: each.least)
    return Choice(best.norm, given.sigma or best.largest_sigma())


class _HeldOut:
    """Residuals of held-out patches with a norm, by sigma, on a few intervals. If sigma is given,
    only the residual with that one counts.
    """

    def __init__(
        self, given: _ChoiceInput, intervals: Sequence[int], norm: Norm, sigmas: Sequence[float]
    ) -> None:
        self.norm, self._sigmas = norm, sigmas
        self._is_given = given.parameters.sigma is not None
        count = len(intervals)
        walks = [_Walk(given, i, norm, start, count) for start, i in enumerate(intervals)]
        self.walks = [walk for walk in walks if walk.folds]  # what could be compared without some
        self._left: dict[float, float] = {}
        self._fields: dict[float, list[list[FloatArray]]] = {}
        if self.walks:
            squares = np.mean([(walk.rest**2, walk.noise**2) for walk in self.walks], axis=0)
            self.rest, self._noise = np.sqrt(squares)

    @property
    def _best_sigma(self) -> float:
        if self._is_given:
            return self._sigmas[-1]
        return min(self._left, key=lambda sigma: (self._left[sigma], -sigma))

    @property
    def least(self) -> float:
        return self._left[self._best_sigma]

    def largest_sigma(self) -> float:
        """Return the largest sigma that leaves hardly more than the best one."""
        enough = self.least**2 + _GAIN_SHARE_MIN * max(self.rest**2 - self.least**2, 0.0)
        return max(sigma for sigma, left in self._left.items() if left**2 <= enough)

    def follow_all(self, report: Callable[[float], None]) -> None:
        """Decrease sigma until the residual grows; if it stays large, look further away."""
        self._descend(report)
        if self.least > max(_RESIDUAL_LARGE * self.rest, NOISE_FACTOR * self._noise):
            least, found = self.least, (self._left, self._fields)
            self._left, self._fields = {}, {}
            with step("looking further"):
                for walk in self.walks:
                    walk.look_further()
            self._descend(report)
            if least <= self.least:
                self._left, self._fields = found
                for walk in self.walks:
                    walk.starts = []

    def _descend(self, report: Callable[[float], None]) -> None:
        fields = [walk.rest_fields for walk in self.walks]
        for number, sigma in enumerate(self._sigmas):
            fields = self._follow(sigma, fields)
            report((number + 1) / len(self._sigmas))
            is_worse = not self._is_given and self._best_sigma != sigma
            if is_worse and not self.walks[0].starts:
                break

    def look_near(self, other: _HeldOut, best: float) -> None:
        """Start from the fields of another norm, at the sigma that is about as smooth. If this is
        within `_RESIDUAL_RATIO_MAX` of the best residual, try smaller and larger sigmas.
        """
        for walk, of_other in zip(self.walks, other.walks, strict=True):
            walk.starts = of_other.starts
        at = self._sigmas.index(other._best_sigma)
        if self.norm.order == other.norm.order and not self._is_given:
            at += round(float(np.log(self.norm.alpha / other.norm.alpha) / np.log(COOLING_FACTOR)))
        at = int(np.clip(at, 0, len(self._sigmas) - 1))
        self._follow(self._sigmas[at], other._fields[other._best_sigma])
        if self._is_given or self.least > _RESIDUAL_RATIO_MAX * best:
            return
        if not self._improve(at, 1) and self.least <= best:
            self._improve(at, -1)

    def _improve(self, at: int, turn: int) -> bool:
        """Try smaller sigmas (1), or larger ones (-1), while the residual falls; return whether it
        did.
        """
        fields, start = self._fields[self._sigmas[at]], at
        while 0 <= at + turn < len(self._sigmas):
            at += turn
            fields = self._follow(self._sigmas[at], fields)
            if self._best_sigma != self._sigmas[at]:
                break
        return self._best_sigma != self._sigmas[start]

    def _follow(self, sigma: float, fields: list[list[FloatArray]]) -> list[list[FloatArray]]:
        followed = [
            walk.follow(sigma, starts) for walk, starts in zip(self.walks, fields, strict=True)
        ]
        self._left[sigma] = float(np.sqrt(np.mean([left for left, _ in followed])))
        self._fields[sigma] = [found for _, found in followed]
        return self._fields[sigma]


class _Walk:
    """Fields of one interval, without the patches of every ``count``-th fold, from ``start`` on."""

    def __init__(
        self, given: _ChoiceInput, interval: int, norm: Norm, start: int, count: int
    ) -> None:
        energy = given.energy(interval, norm)
        self._functions, self._given = energy.functions, given
        self._duration = energy.parameters.tau
        self.rest = energy.residual(energy.functions.source)
        self.noise = noise_floor(energy.functions, given.levels)
        folds = fold_energies(energy)[start::count]
        self.folds = [(Interval(part), hidden) for part, hidden in folds]
        self.rest_fields = [np.zeros(energy.shape[1:])] * len(self.folds)
        self.starts: list[FloatArray] = []
        """Fields that were found further away, which each sigma begins at: warm ones lose them."""

    def look_further(self) -> None:
        """Begin with each sigma at what a match finds without the patches of each fold."""
        self.starts = [long_range_field(interval.energy) for interval, _ in self.folds]

    def follow(self, sigma: float, fields: Sequence[FloatArray]) -> tuple[float, list[FloatArray]]:
        """Go on from fields (F, 2) of each fold; return the mean square of what is left of what
        each has not seen, and the fields.
        """
        of, left, found = self._given, list[float](), list[FloatArray]()
        sigma = sigma_of(of.frames, of.parameters, sigma, self._duration)
        starts = self.starts or fields
        for (interval, hidden), start in zip(self.folds, starts, strict=True):
            checkpoint()
            point = interval.go_on(sigma, start, _ITERATIONS)
            found.append(point.field)
            carried = point.at.advected[: len(self._functions.source)]
            left.append(self._functions.with_mask(hidden).residual(carried) ** 2)
        return float(np.mean(left)), found


def long_range_field(energy: MatchingEnergy) -> FloatArray:
    """Return the field (F, 2) of an ordinary match, which looks further: one over a time of 1,
    whatever the interval's, by which the balance of its terms would be another.
    """
    found = match(energy.problem.with_parameters(_LONG_RANGE))
    speed = found.parameters.tau / (energy.parameters.tau * energy.length_scale)
    return to_frame(energy.mesh, found.velocity[0] * speed)


def change_rates(frames: Frames) -> FloatArray:
    """Return how much each interval changes of what is compared, (T - 1,)."""
    durations = frames.durations
    counts = np.sqrt(frames.weights) * np.ones((len(frames.mesh.vertices), 1))
    if frames.mask is not None:
        counts *= np.sqrt(frames.mask)[:, None]
    steps = np.diff(frames.values, axis=0)
    return np.array([np.linalg.norm(counts * each) for each in steps]) / durations


def _spread(changed: FloatArray, count: int) -> list[int]:
    """Return, of each of so many parts of the time, the interval that changes as the upper quartile
    of its part.
    """
    parts = np.array_split(np.arange(len(changed)), min(count, len(changed)))
    return [
        int(part[np.argsort(changed[part], kind="stable")[(3 * len(part)) // 4]]) for part in parts
    ]
