"""Solver of the fields of all intervals, with long-range searches and sweeps through time."""

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
from abfm.sequences.phase_times import seconds_after, work_of
from abfm.sequences.solving.advection_defect import advection_defect
from abfm.sequences.solving.choosing import SIGMA_MAX, Norm, choose_norm, long_range_field
from abfm.sequences.solving.interval import FieldPoint, Interval, Neighbour
from abfm.types import FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step, stepped

_RESIDUAL_SHARE_MAX = 0.2  # a larger share of the initial residual starts a long-range search
# a long-range field of measured functions must have less than this share of the energy
_ENERGY_SHARE_MAX = 0.5
_FAILED_SEARCHES_MAX = 3  # consecutive long-range searches without success
_SWEEPS_MAX = 4
_CHECK_NAMES = ("verified_residual", "folded")
_GAIN_SHARE_MIN = 0.01  # the last sweep lowers the energy by a smaller share


@dataclass(frozen=True, eq=False)
class IntervalMeasures:
    """Advected frame, energies and residuals of an interval's field, as in `Match`."""

    advected: FloatArray  # (C, V)
    energies: FloatArray  # (2, 3): total, regularity, mismatch; of no motion and of the field
    residual: float
    verified_residual: float = np.nan
    folded: float = np.nan


class SequenceSolver:
    """Finds the fields (T - 1, F, 2) on the mesh scaled to unit area, per unit of time."""

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
        self.energies = np.full(len(self.fields), np.nan)  # energies without the coupling in time
        self.found = np.zeros(len(self.fields), dtype=bool)
        self.sigma = parameters.sigma or np.nan
        self.is_chosen = bool(parameters.sigma) and not parameters.automatic
        self.failed_searches = 0  # number of consecutive long-range searches that failed
        # intervals without motion, which are not coupled to their neighbours
        self.is_uncoupled = np.zeros(len(self.fields), dtype=bool)
        self.swept_intervals = 0  # number of interval solutions in all sweeps
        self.energy_before = np.nan  # total energy at the beginning of the latest sweep
        # residual of flow lines in each interval, and the share of faces that they fold
        self.flow_line_checks = np.full((len(self.fields), 2), np.nan)
        self._defects: dict[int, FloatArray] = {}  # advection defects of fields, by interval

    def run(
        self, on_interval: Callable[[int], object], on_step: Callable[[], object] = lambda: None
    ) -> None:
        """Find the fields of all unsolved intervals, and then improve all fields.

        ``on_interval`` is called with the index of each solved interval, and ``on_step`` after each
        step, when the public attributes have the complete state for resuming. If the run is
        cancelled, solved intervals keep their fields.
        """
        if not self.is_chosen:
            self.choose(*choose_norm(self.frames, self.given, self.levels))
        count = len(self.fields)
        after = seconds_after("following the frames", self.frames)
        with step("following the frames", work_of(self.frames), after=after) as report:
            for i in np.flatnonzero(~self.found).tolist():
                checkpoint()
                self._store(i, found := self.initial_point(i))
                self.is_uncoupled[i] = self._is_no_motion(self.energy(i), found)
                self.found[i] = True
                report((i + 1) / count)
                on_interval(i)
                on_step()
        if self.gamma and count > 1:
            self._smooth_in_time(on_step)
        else:
            self._correct_each(on_step)

    def choose(self, norm: Norm, sigma: float) -> None:
        self.given = replace(self.given, order=norm.order, alpha=norm.alpha)
        self.sigma, self.is_chosen = sigma, True

    def _is_no_motion(self, energy: MatchingEnergy, found: FieldPoint) -> bool:
        residual = energy.residual(found.at.advected)
        return explains_too_little(energy.functions, self.levels, residual)

    def initial_point(self, i: int) -> FieldPoint:
        """Find the field of interval ``i``, starting from the field of the previous interval.

        If the residual is large, minimise again from the previous field without larger sigmas,
        which would reduce its motion. If the residual is still large, start from a long-range
        match.
        """
        sigma, sigma_max = self._sigmas(i)
        start = self.fields[i - 1] if i else None
        interval = self._interval(i, [i - 1] if i else [])
        energy = interval.energy
        found = interval.minimise_by_cooling(sigma, sigma_max, start)
        if self.failed_searches >= _FAILED_SEARCHES_MAX or not self._has_large_residual(
            energy, found
        ):
            return found
        if start is not None:
            found = min(found, interval.minimise(sigma, start), key=lambda point: point.energy)
        if self._has_large_residual(energy, found):
            long_range = interval.minimise(sigma, long_range_field(energy))
            if not self._is_better(energy, long_range, found) or self._has_large_residual(
                energy, long_range, True
            ):
                self.failed_searches += 1
                return found
            self.failed_searches = 0
            # the field of the previous interval may have prevented a short-range solution
            restarted = (
                found if start is None else interval.minimise_by_cooling(sigma, sigma_max, None)
            )
            found = long_range if self._is_better(energy, long_range, restarted) else restarted
        return found

    def _is_better(self, energy: MatchingEnergy, long_range: FieldPoint, found: FieldPoint) -> bool:
        """Return whether a long-range field is better than the field ``found`` without one.

        It must have less energy. Measured functions cannot be matched completely. If ``found``
        explains part of their change, the long-range field must have less than half of its energy.
        """
        is_part = is_measured(energy.functions) and not self._is_no_motion(energy, found)
        return long_range.energy < (_ENERGY_SHARE_MAX if is_part else 1.0) * found.energy

    def _has_large_residual(
        self, energy: MatchingEnergy, found: FieldPoint, by_flow_lines: bool = False
    ) -> bool:
        """Return whether the residual of an interval exceeds noise and a share of the initial one.

        It is that of the discrete flow, or with ``by_flow_lines`` the larger one of both checks.
        """
        first = energy.residual(energy.functions.source)
        residual = energy.residual(found.at.advected)
        if by_flow_lines:
            difference = advection_defect(energy, found.field)
            residual = max(residual, energy.residual(found.at.advected - difference))
        return residual > max(
            _RESIDUAL_SHARE_MAX * first, NOISE_FACTOR * noise_floor(energy.functions, self.levels)
        )

    def _smooth_in_time(self, on_step: Callable[[], object] = lambda: None) -> None:
        """Correct all fields, backwards and forwards in time, until the total energy hardly falls.

        Flow lines measure the energy, and the fields of adjacent intervals are coupled.
        """
        count = len(self.fields)
        if not self.swept_intervals:
            after = seconds_after("tracing flow lines", self.frames)
            with stepped("tracing flow lines", range(count), after) as intervals:
                for i in intervals:
                    self._update_energy(i)
            self.energy_before = self.total_energy()
        after = seconds_after("smoothing in time", self.frames)
        with step("smoothing in time", work_of(self.frames), after=after) as report:
            while self.swept_intervals < _SWEEPS_MAX * count:
                sweep, done = divmod(self.swept_intervals, count)
                i = done if sweep % 2 else count - 1 - done
                self._correct(i, [j for j in (i - 1, i + 1) if 0 <= j < count])
                self.swept_intervals += 1
                if done == count - 1:
                    before, self.energy_before = self.energy_before, self.total_energy()
                    if not before - self.energy_before > _GAIN_SHARE_MIN * before:
                        self.swept_intervals = _SWEEPS_MAX * count
                report(self.swept_intervals / (_SWEEPS_MAX * count))
                on_step()
        self._defects.clear()

    def _correct_each(self, on_step: Callable[[], object]) -> None:
        """Correct each field, without coupling, until its energy by flow lines hardly falls."""
        count = len(self.fields)
        after = seconds_after("smoothing in time", self.frames)
        with step("correcting by flow lines", work_of(self.frames), after=after) as report:
            while self.swept_intervals < _SWEEPS_MAX * count:
                i, times = divmod(self.swept_intervals, _SWEEPS_MAX)
                if not times:
                    self._update_energy(i)
                before = self.energies[i]
                self._correct(i)
                is_settled = not before - self.energies[i] > _GAIN_SHARE_MIN * before
                self.swept_intervals += _SWEEPS_MAX - times if is_settled else 1
                if self.swept_intervals % _SWEEPS_MAX == 0:
                    del self._defects[i]  # the defect is not needed again
                report(self.swept_intervals / (_SWEEPS_MAX * count))
                on_step()

    def _update_energy(self, i: int) -> None:
        """Measure the energy of the field of interval ``i`` by flow lines, and store it."""
        checkpoint()
        self._defects[i] = advection_defect(self.energy(i), self.fields[i])
        interval = self._interval(i, shift=self._defects[i])
        self.energies[i] = interval.minimise(self._sigmas(i)[0], self.fields[i], 0).at.energy

    def _correct(self, i: int, adjacent: Sequence[int] = ()) -> None:
        """Minimise the energy of interval ``i`` with the advection defect of its field subtracted.

        This is a defect correction [Stetter 1978], coupled with the fields of intervals
        ``adjacent``. The new field is accepted if it has less energy by flow lines.
        """
        checkpoint()
        field, sigma = self.fields[i], self._sigmas(i)[0]
        if i not in self._defects:  # the field is from an earlier run
            self._defects[i] = advection_defect(self.energy(i), field)
        interval = self._interval(i, adjacent, self._defects[i])
        found = interval.minimise(sigma, field)
        new_defect = advection_defect(interval.energy, found.field)
        there = self._interval(i, adjacent, new_defect).minimise(sigma, found.field, 0)
        if there.energy < self.energies[i] + interval.coupling_energy(field):
            self._defects[i] = new_defect
            self._store(i, there)

    def total_energy(self) -> float:
        """Return the energy of all intervals, including the coupling in time."""
        norm = MatchingEnergy(self.frames.problem(0, self.parameters(0))).regularizer()
        coupling_energy = 0.0
        for i in range(len(self.fields) - 1):
            difference = self.fields[i + 1] - self.fields[i]
            coupling_energy += (
                0.5 * self._coupling(i, i + 1) * float((difference * norm.apply(difference)).sum())
            )
        return float(self.energies.sum() + coupling_energy)

    def _coupling(self, i: int, j: int) -> float:
        """Return the weight of the difference between the fields of two adjacent intervals.

        It is gamma times the shorter duration, or 0 if an interval has no motion: it should not
        become as fast as its neighbours.
        """
        if self.is_uncoupled[i] or self.is_uncoupled[j]:
            return 0.0
        return self.gamma * float(min(self.frames.durations[i], self.frames.durations[j]))

    def parameters(self, interval: int) -> Parameters:
        sigma = self.sigma if np.isfinite(self.sigma) else SIGMA_MAX
        return interval_parameters(self.frames, self.given, sigma, interval)

    def energy(self, interval: int) -> MatchingEnergy:
        return MatchingEnergy(self.frames.problem(interval, self.parameters(interval)))

    def _interval(
        self, i: int, adjacent: Sequence[int] = (), shift: FloatArray | float = 0.0
    ) -> Interval:
        duration = float(self.frames.durations[i])
        neighbours = [Neighbour(self.fields[j], self._coupling(i, j) / duration) for j in adjacent]
        return Interval(self.energy(i), neighbours, shift)

    def _sigmas(self, i: int) -> tuple[float, float]:
        """Return the smallest and the largest absolute sigma of an interval."""
        duration = float(self.frames.durations[i])
        sigma_min, sigma_max = (
            sigma_of(self.frames, self.given, sigma, duration) for sigma in (self.sigma, SIGMA_MAX)
        )
        return sigma_min, sigma_max

    def _store(self, i: int, found: FieldPoint) -> None:
        self.fields[i], self.energies[i] = found.field, found.at.energy

    def measures(self, i: int, by_flow_lines: bool = True) -> IntervalMeasures:
        """Return the measurements of an interval's field by the discrete flow and by flow lines."""
        energy, field = self.energy(i), self.fields[i]
        objective = energy.objective(energy.parameters.last_sigma)
        rest, at = (objective.evaluate(x[None]) for x in (np.zeros_like(field), field))
        energies = np.array([(e.energy, e.regularity, e.mismatch) for e in (rest, at)])
        if by_flow_lines and self.found[i] and np.isnan(self.flow_line_checks[i]).any():
            checks = flow_line_measures(energy, to_ambient(energy.mesh, field)[None])
            self.flow_line_checks[i] = [checks.get(name, np.nan) for name in _CHECK_NAMES]
        known = zip(_CHECK_NAMES, self.flow_line_checks[i].tolist(), strict=True)
        return IntervalMeasures(at.advected, energies, energy.residual_at(at), **dict(known))
