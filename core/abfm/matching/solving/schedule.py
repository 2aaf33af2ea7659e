"""The schedule of a match: the steps of falling sigma, and when each of them ends."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from abfm.matching.solvability import is_measured
from abfm.matching.solving.settings import SETTINGS
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import FIRST_SIGMA_MAX, LAST_SIGMA, REACH_MAX, Parameters
from abfm.types import FloatArray

_STEP_ROUNDING = 1e-9  # of a number of steps


class Variant(NamedTuple):
    """What all steps of a path have in common."""

    alpha: float
    fields: int  # consecutive ones


@dataclass(frozen=True)
class Stage:
    """A minimisation of one objective on one level; reach is 0 for the parameters' own norm."""

    level: int  # number of the mesh, from 0, the coarsest
    fields: int  # consecutive ones
    sigma: float
    alpha: float
    reach: float
    iterations: int  # limit of its own
    until: int  # limit of all stages together
    fixed: bool  # whether it uses all its iterations
    goal: float  # residual at which it ends
    landmark_sigma: float = Parameters.landmark_sigma
    # whether it also ends if the residual stalls, once the target is found
    is_search: bool = False
    # (C, V), subtracted from the advected functions before they are compared with the target
    shift: FloatArray | float = field(default=0.0, repr=False, compare=False)

    def continues(self, before: "Stage") -> bool:
        """Return whether the curvature of the stage before is still valid; if fixed, only with the
        same sigma.
        """
        names = "level", "fields", "reach", "alpha"
        same = all(getattr(before, name) == getattr(self, name) for name in names)
        return same and not (self.fixed and before.sigma != self.sigma)

    def curvature_ratio(self, before: "Stage") -> float:
        """Return the curvature of the energy relative to the stage before."""
        if self.sigma == before.sigma:
            return (before.landmark_sigma / self.landmark_sigma) ** 2
        return (before.sigma / self.sigma) ** 2

    def is_worthwhile(self, energies: Sequence[float], residuals: Sequence[float] = ()) -> bool:
        """Return whether another iteration pays, after these energies and residuals of iterates.

        The energy has to fall. In a search the residual has to fall as well once the target is
        found, as the norm of the search is then no longer the one that matters.
        """
        if self.fixed:
            return True
        is_searched = self.is_search and residuals[-1] <= SETTINGS.found_residual
        return falls(energies) and (not is_searched or falls(residuals))


def falls(
    values: Sequence[float],
    by: float = SETTINGS.fall_min,
    within: int = SETTINGS.fall_iterations,
) -> bool:
    """Return whether values fell by a share within the last iterations, or are fewer than these."""
    early = len(values) <= within
    return early or values[-1] < (1 - by) * values[-1 - within]


class Schedule:
    """The steps of a match by its parameters, on a number of meshes, and what ends them.

    A given sigma is that of the last step. Without it, functions of little detail are taken to
    match exactly, and the path ends where both checks confirm the goal. Others are measured, and
    the path ends where held-out patches gain nothing (`held_out`).
    """

    def __init__(
        self, p: Parameters, functions: FunctionTerm, meshes: int, has_landmarks: bool = False
    ) -> None:
        self._p, self._meshes, self._has_landmarks = p, meshes, has_landmarks
        # landmarks alone, which need no sigma but their own, and no reach
        self._has_landmarks_only = has_landmarks and functions.is_constant
        self.has_given_sigma = p.sigma is not None
        self._has_detail = is_measured(functions)
        # as in the paper: every step uses all its iterations
        self.is_fixed = p.paper.stage_iterations > 0 or (p.solver.reach == 0 and meshes == 1)
        self.is_measured = self._has_detail and not (self.has_given_sigma or self.is_fixed)
        # ends where flow lines confirm the goal
        self.is_free = not (self.has_given_sigma or self.is_fixed or self.is_measured)
        self.unit = 1.0 if p.paper.sigma_unit == "relative" else functions.function_size
        self.sigmas = self._sigmas()

    @property
    def has_given_end(self) -> bool:
        """Whether the last step is the result, whatever its residual is."""
        return self.has_given_sigma or self.is_fixed

    def variants(self, fields: int) -> list[Variant]:
        """Return the variants of the path that are tried on the first mesh.

        Measured functions have a second one with a smaller alpha, except in the norm of first
        order, whose fields follow small scales anyway: a third of alpha found no more on 21 of 22
        problems. Other functions have a second one with two consecutive fields: a flow along one
        field keeps the value wherever the field is zero, and one along two does not.
        """
        p, first = self._p, Variant(self._p.alpha, fields)
        if self.is_fixed or not p.solver.reach:
            return [first]
        if self._has_detail:
            less = first._replace(alpha=SETTINGS.second_alpha_share * p.alpha)
            is_smooth = p.alpha > 0 and p.solver.order > 1
            return [first, less] if self.is_measured and is_smooth else [first]
        return [first] if p.solver.segments or fields > 1 else [first, first._replace(fields=2)]

    def reach(self, residual: float) -> float:
        """Return the reach of a variant after one with this residual: the largest one, if that did
        not find the target.
        """
        lost = self.is_free and not self.is_found(residual) and not self._has_landmarks_only
        return REACH_MAX if lost else self.first_reach

    @property
    def first_reach(self) -> float:
        """The reach of the first variant."""
        return 0.0 if self._has_landmarks_only else self._p.solver.reach

    def stage(
        self, level: int, sigma: float, variant: Variant, reach: float = 0.0, error: float = 0.0
    ) -> Stage:
        """Return the stage of a sigma on a level with this discretisation error (residual).

        On a coarse level the result of the given sigma is only a start for the mesh itself. The
        stage then ends at the discretisation error, as a smaller residual on the coarse mesh means
        nothing on the mesh itself, and a search where the residual stalls.
        """
        p, alpha, is_last = self._p, variant.alpha, level >= self._meshes - 1
        if self.is_free and not self._has_landmarks_only:
            alpha *= min(1.0, sigma / (SETTINGS.stiff_sigma * self.unit)) ** 2
        limit = (
            p.stage_limits()[0 if sigma > self.sigmas[-1] else -1]
            if self.is_fixed
            else p.solver.iterations
        )
        goal = SETTINGS.goal_share * p.goal if self.is_free else 0.0
        is_start = (
            self.has_given_sigma and not (self.is_fixed or is_last) and sigma == self.sigmas[-1]
        )
        goal = error if is_start else goal
        coarse = int(SETTINGS.coarse_iteration_share * p.solver.iterations)
        return Stage(
            level,
            variant.fields,
            sigma,
            alpha,
            reach,
            limit,
            p.solver.iterations if is_last else coarse,
            self.is_fixed,
            goal,
            self.landmark_sigma(sigma),
            is_search=is_start and reach > 0,
        )

    def landmark_sigma(self, sigma: float) -> float:
        """Return that of landmarks for a sigma: it falls faster, so that landmarks lead."""
        first, last = self.sigmas[0], self.sigmas[-1]
        if not self._has_landmarks:
            return self._p.landmark_sigma
        times = sigma / last
        if not self._has_landmarks_only:
            share = (sigma / first) ** SETTINGS.landmark_power
            times = min(times, max(1.0, SETTINGS.landmark_factor_max * share))
        return self._p.landmark_sigma * times

    def _sigmas(self) -> list[float]:
        p = self._p
        if p.paper.cooling_stages:
            return p.stage_sigmas()
        last = self.unit * LAST_SIGMA if p.sigma is None else p.sigma
        if self._has_landmarks_only:
            return [last * times for times in SETTINGS.landmark_sigma_factors]
        ratio = math.sqrt(p.paper.cooling_factor) if self.is_measured else p.paper.cooling_factor
        warmest = self.unit * FIRST_SIGMA_MAX
        count = max(0, math.floor(math.log(warmest / last, ratio) + _STEP_ROUNDING))
        if p.sigma is None:
            return [warmest / ratio**step for step in range(count + 1)]
        return [last * ratio**left for left in reversed(range(count + 1))]

    @staticmethod
    def is_found(residual: float) -> bool:
        return residual <= SETTINGS.found_residual
