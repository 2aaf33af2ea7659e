"""The schedule of a match: its values of sigma, and the limits of each stage."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from abfm.matching.solvability import is_measured
from abfm.matching.solving.settings import SETTINGS
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import FIRST_SIGMA_MAX, LAST_SIGMA, REACH_MAX, Parameters
from abfm.types import FloatArray

_STEP_ROUNDING = 1e-9  # rounding errors of a number of steps


class Variant(NamedTuple):
    """Alpha and the number of consecutive fields, which all steps of a path have in common."""

    alpha: float
    fields: int


@dataclass(frozen=True)
class Stage:
    """The minimisation of the energy for one sigma on one level."""

    level: int  # number of the mesh, from 0 for the coarsest one
    fields: int  # number of consecutive fields
    sigma: float
    alpha: float
    reach: float  # if above 0, functions are compared in a norm smoothed over this distance
    iterations: int  # largest number of iterations of this stage
    until: int  # largest total number of iterations up to the end of this stage
    fixed: bool  # whether the stage uses all its iterations
    goal: float  # residual at which the stage ends
    landmark_sigma: float = Parameters.landmark_sigma
    # whether the stage also ends if the residual stalls, once the target is found
    is_search: bool = False
    # functions (C, V) subtracted from the advected ones before the comparison with the target
    shift: FloatArray | float = field(default=0.0, repr=False, compare=False)

    def continues(self, before: "Stage") -> bool:
        """Return whether this stage can reuse the energy's curvature in the stage before."""
        names = "level", "fields", "reach", "alpha"
        same = all(getattr(before, name) == getattr(self, name) for name in names)
        return same and not (self.fixed and before.sigma != self.sigma)

    def curvature_ratio(self, before: "Stage") -> float:
        """Return the ratio of the energy's curvature in this stage to that in the stage before."""
        if self.sigma == before.sigma:
            return (before.landmark_sigma / self.landmark_sigma) ** 2
        return (before.sigma / self.sigma) ** 2

    def is_worthwhile(self, energies: Sequence[float], residuals: Sequence[float] = ()) -> bool:
        """Return whether to continue a stage after iterates with these energies and residuals.

        The energy has to fall. Once a search has found the target, the residual also has to fall,
        as the energy of a search compares functions over a distance.
        """
        if self.fixed:
            return True
        is_searched = self.is_search and residuals[-1] <= SETTINGS.found_residual
        return falls(energies) and (not is_searched or falls(residuals))


def falls(
    values: Sequence[float], by: float = SETTINGS.fall_min, within: int = SETTINGS.fall_iterations
) -> bool:
    """Return whether values fell by a share ``by`` within the last ``within`` iterations.

    True also if there are too few values to compare.
    """
    early = len(values) <= within
    return early or values[-1] < (1 - by) * values[-1 - within]


class Schedule:
    """The values of sigma of a match, and the stage of each value.

    A sigma that is given by the user is that of the last step. Otherwise, functions with little
    detail are treated as exact, and the path ends when both checks confirm the goal. Other
    functions are treated as measured, and the path ends when held-out patches no longer improve
    (`held_out`).
    """

    def __init__(
        self, p: Parameters, functions: FunctionTerm, meshes: int, has_landmarks: bool = False
    ) -> None:
        self._p, self._meshes, self._has_landmarks = p, meshes, has_landmarks
        # landmarks alone need only landmark_sigma and no reach
        self._has_landmarks_only = has_landmarks and functions.is_constant
        self.has_given_sigma = p.sigma is not None
        self._has_detail = is_measured(functions)
        # every step uses all its iterations, as in the paper
        self.is_fixed = p.paper.stage_iterations > 0 or (p.solver.reach == 0 and meshes == 1)
        self.is_measured = self._has_detail and not (self.has_given_sigma or self.is_fixed)
        # the path ends when flow lines confirm the goal
        self.is_free = not (self.has_given_sigma or self.is_fixed or self.is_measured)
        self.unit = 1.0 if p.paper.sigma_unit == "relative" else functions.function_size
        self.sigmas = self._sigmas()

    @property
    def has_given_end(self) -> bool:
        """Whether the last step of the path is the result, even if another is better."""
        return self.has_given_sigma or self.is_fixed

    def variants(self, fields: int) -> list[Variant]:
        """Return the variants of the path that are tried on the coarsest mesh.

        The first variant has the alpha of the parameters and ``fields`` consecutive fields.

        Measured functions have a second variant with a smaller alpha, except with the norm of first
        order. Fields of that norm follow small scales anyway: a third of alpha was not better on 21
        of 22 problems.

        Functions that are not measured have a second variant with two consecutive fields. The flow
        of one field preserves values at its zeros, whereas the flow of two fields does not.
        """
        p, first = self._p, Variant(self._p.alpha, fields)
        if self.is_fixed or not p.solver.reach:
            return [first]
        if self._has_detail:
            second = first._replace(alpha=SETTINGS.second_alpha_share * p.alpha)
            is_smooth = p.alpha > 0 and p.solver.order > 1
            return [first, second] if self.is_measured and is_smooth else [first]
        return [first] if p.solver.segments or fields > 1 else [first, first._replace(fields=2)]

    def reach(self, residual: float) -> float:
        """Return the reach of the next variant, after a variant with this residual.

        It is the largest reach if the residual shows that the target was missed, else the usual
        one.
        """
        is_missed = self.is_free and not self.is_found(residual) and not self._has_landmarks_only
        return REACH_MAX if is_missed else self.first_reach

    @property
    def first_reach(self) -> float:
        return 0.0 if self._has_landmarks_only else self._p.solver.reach

    def stage(
        self, level: int, sigma: float, variant: Variant, reach: float = 0.0, error: float = 0.0
    ) -> Stage:
        """Return the stage that minimises the energy for a sigma on a level.

        ``error`` is the discretisation error of the level, as a residual. If the user gives sigma,
        its result on a coarse level is only a start for the mesh itself. The stage then ends at
        this error, as smaller residuals have no meaning on the mesh itself. A search also ends if
        the residual stalls.
        """
        p, alpha, is_last = self._p, variant.alpha, level >= self._meshes - 1
        if self.is_free and not self._has_landmarks_only:
            alpha *= min(1.0, sigma / (SETTINGS.stiff_sigma * self.unit)) ** 2
        limit = p.solver.iterations
        if self.is_fixed:
            limit = p.stage_limits()[0 if sigma > self.sigmas[-1] else -1]
        goal = SETTINGS.goal_share * p.goal if self.is_free else 0.0
        is_given = self.has_given_sigma and sigma == self.sigmas[-1]
        is_start = is_given and not (self.is_fixed or is_last)
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
        """Return the landmark_sigma of the step with this sigma.

        It falls faster than sigma, so that landmarks are matched before functions.
        """
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
        largest = self.unit * FIRST_SIGMA_MAX
        count = max(0, math.floor(math.log(largest / last, ratio) + _STEP_ROUNDING))
        if p.sigma is None:
            return [largest / ratio**step for step in range(count + 1)]
        return [last * ratio**step for step in reversed(range(count + 1))]

    @staticmethod
    def is_found(residual: float) -> bool:
        return residual <= SETTINGS.found_residual
