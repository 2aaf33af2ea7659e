"""The fields of all intervals together: each near those beside it, in sweeps through time; and a
search where frames are far apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from abfm.calculus.vector_fields import to_ambient
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solvability import is_measured
from abfm.matching.solving.measures import flow_line_measures
from abfm.parameters import Parameters
from abfm.sequences.frames import Frames, interval_parameters, sigma_of
from abfm.sequences.noise import NOISE_FACTOR, explains_too_little, noise_floor, noise_levels
from abfm.sequences.parameters import SequenceParameters
from abfm.sequences.solving.advection_defect import advection_defect
from abfm.sequences.solving.choosing import SIGMA_MAX, Norm, choose_norm, long_range_field
from abfm.sequences.solving.interval import FieldPoint, Interval, Neighbour
from abfm.types import FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step, stepped

_SHARE_MAX = 0.2  # of what differed at first: where more is left, it is looked for further away
_ENERGY_SHARE_MAX = 0.5  # of the energy
_VAIN_SEARCHES_MAX = 3  # searches, after which no more are made
_SWEEPS = 4  # at most
_CHECK_NAMES = ("verified_residual", "folded")
_GAIN_SHARE_MIN = 0.01  # share of its energy that a sweep gains, which is then the last


@dataclass(frozen=True, eq=False)
class IntervalMeasures:
    """What was found of an interval: as in `Match`."""

    advected: FloatArray  # (C, V)
    energies: FloatArray  # (2, 3), of no motion and of the field: total, regularity, mismatch
    residual: float
    verified_residual: float = np.nan
    folded: float = np.nan


class SequenceSolver:
    """Finds fields (T - 1, F, 2) of the mesh scaled to unit area, per unit of time."""

    def __init__(
        self,
        frames: Frames,
        parameters: SequenceParameters,
        gamma: float,
        levels: FloatArray | None = None,
    ) -> None:
        self.frames, self.gamma = frames, gamma
        self.given = parameters
        self.levels = noise_levels(frames) if levels is None else levels
        self.fields = np.zeros((len(frames.durations), len(frames.mesh.faces), 2))
        self.energies = np.full(len(self.fields), np.nan)  # without what ties neighbours
        self.found = np.zeros(len(self.fields), dtype=bool)
        self.sigma = parameters.sigma or np.nan
        self.is_chosen = bool(parameters.sigma) and not parameters.automatic
        self.failed_searches = 0  # searches
        self.is_uncoupled = np.zeros(len(self.fields), dtype=bool)  # no motion, which ties to none
        self.swept_intervals = 0  # intervals, in all sweeps
        self.before = np.nan  # energy of all, when the last sweep began
        # what flow lines leave of each interval, and the share of faces that they fold
        self.flow_line_checks = np.full((len(self.fields), 2), np.nan)
        self._defects: dict[int, FloatArray] = {}  # of fields, where they were asked for

    def run(
        self, on_interval: Callable[[int], object], on_step: Callable[[], object] = lambda: None
    ) -> None:
        """Go through all intervals that are not found; what is there when it is cancelled stays.
        All that it goes on from is in its public attributes, after each step.
        """
        if not self.is_chosen:
            self.choose(*choose_norm(self.frames, self.given, self.levels))
        count = len(self.fields)
        with step("following the frames") as tell:
            for i in np.flatnonzero(~self.found).tolist():
                checkpoint()
                self._keep(i, found := self.first_found(i))
                self.is_uncoupled[i] = self._is_no_motion(self.energy(i), found)
                self.found[i] = True
                tell((i + 1) / count)
                on_interval(i)
                on_step()
        if self.gamma and count > 1:
            self._settle(on_step)
        else:
            self._settle_each(on_step)

    def choose(self, norm: Norm, sigma: float) -> None:
        """Solve with a norm of fields and a sigma from now on."""
        self.given = replace(self.given, order=norm.order, alpha=norm.alpha)
        self.sigma, self.is_chosen = sigma, True

    def _is_no_motion(self, energy: MatchingEnergy, found: FieldPoint) -> bool:
        left = energy.residual(found.at.advected)
        return explains_too_little(energy.functions, self.levels, left)

    def first_found(self, i: int) -> FieldPoint:
        """Return the field of an interval from that of the one before; where frames are far apart
        by way of no warmer sigma, which draws back; else from a match that looks further.
        """
        last, warmest = self._sigmas(i)
        start = self.fields[i - 1] if i else None
        interval = self._interval(i, [i - 1] if i else [])
        energy = interval.energy
        found = interval.find(last, warmest, start)
        if self.failed_searches >= _VAIN_SEARCHES_MAX or not self._is_far(energy, found):
            return found
        if start is not None:
            found = min(found, interval.go_on(last, start), key=lambda point: point.energy)
        if self._is_far(energy, found):
            further = interval.go_on(last, long_range_field(energy))
            if not self._is_better(energy, further, found) or self._is_far(energy, further, True):
                self.failed_searches += 1
                return found
            self.failed_searches = 0
            # what is near may have been missed as the field before led astray
            anew = found if start is None else interval.find(last, warmest, None)
            found = further if self._is_better(energy, further, anew) else anew
        return found

    def _is_better(self, energy: MatchingEnergy, further: FieldPoint, found: FieldPoint) -> bool:
        """Tell whether what is far has less energy than what is near: of measured functions, of
        which all is not to be had, and of which the near explains some, less than half.
        """
        is_part = is_measured(energy.functions) and not self._is_no_motion(energy, found)
        return further.energy < (_ENERGY_SHARE_MAX if is_part else 1.0) * found.energy

    def _is_far(
        self, energy: MatchingEnergy, found: FieldPoint, by_flow_lines: bool = False
    ) -> bool:
        """Tell whether much of an interval is left that is not noise, by the discrete flow, or also
        by flow lines.
        """
        first = energy.residual(energy.functions.source)
        left = energy.residual(found.at.advected)
        if by_flow_lines:
            apart = advection_defect(energy, found.field)
            left = max(left, energy.residual(found.at.advected - apart))
        return left > max(
            _SHARE_MAX * first, NOISE_FACTOR * noise_floor(energy.functions, self.levels)
        )

    def _settle(self, on_step: Callable[[], object] = lambda: None) -> None:
        """Sweep back and forth until the energy of all, by flow lines, hardly falls."""
        count = len(self.fields)
        if not self.swept_intervals:
            with stepped("asking flow lines", range(count)) as intervals:
                for i in intervals:
                    self._ask_flow_lines(i)
            self.before = self.total()
        with step("smoothing in time") as tell:
            while self.swept_intervals < _SWEEPS * count:
                sweep, done = divmod(self.swept_intervals, count)
                i = done if sweep % 2 else count - 1 - done
                self._go_on(i, [j for j in (i - 1, i + 1) if 0 <= j < count])
                self.swept_intervals += 1
                if done == count - 1:
                    before, self.before = self.before, self.total()
                    if not before - self.before > _GAIN_SHARE_MIN * before:
                        self.swept_intervals = _SWEEPS * count
                tell(self.swept_intervals / (_SWEEPS * count))
                on_step()
        self._defects.clear()

    def _settle_each(self, on_step: Callable[[], object]) -> None:
        """Go on with each interval by itself until its energy, by flow lines, hardly falls."""
        count = len(self.fields)
        with step("correcting by flow lines") as tell:
            while self.swept_intervals < _SWEEPS * count:
                i, times = divmod(self.swept_intervals, _SWEEPS)
                if not times:
                    self._ask_flow_lines(i)
                before = self.energies[i]
                self._go_on(i)
                is_settled = not before - self.energies[i] > _GAIN_SHARE_MIN * before
                self.swept_intervals += _SWEEPS - times if is_settled else 1
                if self.swept_intervals % _SWEEPS == 0:
                    del self._defects[i]  # which nobody asks for again
                tell(self.swept_intervals / (_SWEEPS * count))
                on_step()

    def _ask_flow_lines(self, i: int) -> None:
        """Take the energy of an interval's field for what flow lines say."""
        checkpoint()
        self._defects[i] = advection_defect(self.energy(i), self.fields[i])
        interval = self._interval(i, shift=self._defects[i])
        self.energies[i] = interval.go_on(self._sigmas(i)[0], self.fields[i], 0).at.energy

    def _go_on(self, i: int, beside: Sequence[int] = ()) -> None:
        """Minimise an interval's energy with the defect of its field taken off: a defect correction
        [Stetter 1978]. What comes of it is kept if it has less energy by flow lines.
        """
        checkpoint()
        field, sigma = self.fields[i], self._sigmas(i)[0]
        if i not in self._defects:  # of an earlier run
            self._defects[i] = advection_defect(self.energy(i), field)
        interval = self._interval(i, beside, self._defects[i])
        found = interval.go_on(sigma, field)
        left = advection_defect(interval.energy, found.field)
        there = self._interval(i, beside, left).go_on(sigma, found.field, 0)
        if there.energy < self.energies[i] + interval.tied(field):
            self._defects[i] = left
            self._keep(i, there)

    def total(self) -> float:
        """Energy of all intervals together, with what ties them."""
        norm = MatchingEnergy(self.frames.problem(0, self.parameters(0))).regularizer()
        tied = 0.0
        for i in range(len(self.fields) - 1):
            apart = self.fields[i + 1] - self.fields[i]
            tied += 0.5 * self._tie(i, i + 1) * float((apart * norm.apply(apart)).sum())
        return float(self.energies.sum() + tied)

    def _tie(self, i: int, j: int) -> float:
        """How much the fields of neighbouring intervals are held together: gamma times the shorter
        one's duration, where both are motions; a gap is not to be as fast as what is beside it.
        """
        if self.is_uncoupled[i] or self.is_uncoupled[j]:
            return 0.0
        return self.gamma * float(min(self.frames.durations[i], self.frames.durations[j]))

    def parameters(self, interval: int) -> Parameters:
        """Return those of the problem of an interval."""
        sigma = self.sigma if np.isfinite(self.sigma) else SIGMA_MAX
        return interval_parameters(self.frames, self.given, sigma, interval)

    def energy(self, interval: int) -> MatchingEnergy:
        """Return the energy of an interval."""
        return MatchingEnergy(self.frames.problem(interval, self.parameters(interval)))

    def _interval(
        self, i: int, beside: Sequence[int] = (), shift: FloatArray | float = 0.0
    ) -> Interval:
        """Return the minimisation of an interval, near the fields of those beside it."""
        duration = float(self.frames.durations[i])
        neighbours = [Neighbour(self.fields[j], self._tie(i, j) / duration) for j in beside]
        return Interval(self.energy(i), neighbours, shift)

    def _sigmas(self, i: int) -> tuple[float, float]:
        """Return the last and the warmest sigma of an interval."""
        duration = float(self.frames.durations[i])
        last, warmest = (
            sigma_of(self.frames, self.given, sigma, duration) for sigma in (self.sigma, SIGMA_MAX)
        )
        return last, warmest

    def _keep(self, i: int, found: FieldPoint) -> None:
        self.fields[i], self.energies[i] = found.field, found.at.energy

    def measures(self, i: int, by_flow_lines: bool = True) -> IntervalMeasures:
        """Return what the discrete flow and flow lines say of the field of an interval."""
        energy, field = self.energy(i), self.fields[i]
        sigma = energy.parameters.last_sigma
        objective = energy.objective(sigma)
        rest, at = (objective.evaluate(x[None]) for x in (np.zeros_like(field), field))
        energies = np.array([(e.energy, e.regularity, e.mismatch) for e in (rest, at)])
        if by_flow_lines and self.found[i] and np.isnan(self.flow_line_checks[i]).any():
            told = flow_line_measures(energy, to_ambient(energy.mesh, field)[None])
            self.flow_line_checks[i] = [told.get(name, np.nan) for name in _CHECK_NAMES]
        known = zip(_CHECK_NAMES, self.flow_line_checks[i].tolist(), strict=True)
        return IntervalMeasures(at.advected, energies, energy.left(at), **dict(known))
