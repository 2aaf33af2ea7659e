"""The course of a match: which steps lead from smooth to close, and when one has done its work."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from abfm.matching.solvability import is_measured
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import LAST, LONGEST, WARMEST, Parameters
from abfm.types import FloatArray

_FOUND = 0.75  # residual with which the target is found: the paper's norm leads on, without reach
_LESS = 1 / 3  # factor of alpha on the less smooth way
# a step goes on while its energy falls by this share within so many iterations
_PAYING, _OVER = 0.03, 6
_STIFF = 0.05  # sigma from which on alpha falls as its square: stiff fields go no closer
_SHARE = 0.75  # of all iterations, before the mesh itself
_CLOSE = 0.8  # of the goal: how close a step comes, as flow lines seldom confirm as much
_ROUNDING = 1e-9  # of a number of steps
# times the last landmark_sigma with which a path begins, and the power of sigma by which it falls
_LOOSE, _FASTER = 100.0, 2
_BARE = (100.0, 10.0, 1.0)  # times the last sigma, where landmarks are alone


class Way(NamedTuple):
    """What a way from smooth to close is walked with."""

    alpha: float
    fields: int  # in a row


@dataclass(frozen=True)
class Stage:
    """What a part of the way is minimised with; reach is 0 for the parameters' own norm."""

    level: int  # which mesh, from 0, the coarsest
    fields: int  # in a row
    sigma: float
    alpha: float
    reach: float
    iterations: int  # at most, of its own
    until: int  # at most, of all together
    fixed: bool  # whether it goes on to the end of its iterations
    goal: float  # residual at which it ends
    landmark_sigma: float = Parameters.landmark_sigma
    # whether it only searches: it ends where the residual stalls, too, once the target is found
    is_search: bool = False
    # what is taken off what is carried (C, V), before that is held against the target
    shift: FloatArray | float = field(default=0.0, repr=False, compare=False)

    def continues(self, before: "Stage") -> bool:
        """Tell whether what the stage before learned serves; if fixed not with another sigma."""
        names = "level", "fields", "reach", "alpha"
        same = all(getattr(before, name) == getattr(self, name) for name in names)
        return same and not (self.fixed and before.sigma != self.sigma)

    def steeper(self, before: "Stage") -> float:
        """Return how many times as much the energy bends as in the stage before."""
        if self.sigma == before.sigma:
            return (before.landmark_sigma / self.landmark_sigma) ** 2
        return (before.sigma / self.sigma) ** 2

    def pays(self, energies: Sequence[float], residuals: Sequence[float] = ()) -> bool:
        """Return whether another iteration pays, after these energies and residuals of iterates.

        The energy has to fall. In a search the residual has to fall as well once the target is
        found, as the norm of the search is then no longer the one that matters.
        """
        if self.fixed:
            return True
        is_searched = self.is_search and residuals[-1] <= _FOUND
        return falls(energies) and (not is_searched or falls(residuals))


def falls(values: Sequence[float], by: float = _PAYING, within: int = _OVER) -> bool:
    """Return whether values of iterates fell by a share within so many, or are fewer."""
    early = len(values) <= within
    return early or values[-1] < (1 - by) * values[-1 - within]


class Course:
    """The steps of a match by its parameters, on so many meshes, and what they are to find.

    What the user gives is where it ends: a given sigma is the last one. Without, functions of
    little detail are taken to match exactly, and the way ends where that is confirmed; others are
    taken to be measured, and the way ends where it gains too little of what it has not seen
    (`held_out`).
    """

    def __init__(
        self, p: Parameters, functions: FunctionTerm, meshes: int, has_landmarks: bool = False
    ) -> None:
        self._p, self._meshes, self._has_landmarks = p, meshes, has_landmarks
        # landmarks alone, which need no sigma but their own, and no reach
        self._is_bare = has_landmarks and functions.is_constant
        self.is_given = p.sigma is not None
        self._has_detail = is_measured(functions)
        # as in the paper: every step goes on to the end of its iterations
        self.is_fixed = p.paper.stage_iterations > 0 or (p.solver.reach == 0 and meshes == 1)
        self.is_measured = self._has_detail and not (self.is_given or self.is_fixed)
        # towards the goal, as far as flow lines confirm it
        self.is_free = not (self.is_given or self.is_fixed or self.is_measured)
        self.unit = 1.0 if p.paper.sigma_unit == "relative" else functions.function_size
        self.sigmas = self._sigmas()

    def ways(self, fields: int) -> list[Way]:
        """Return those to try: that of measured functions is the one which finds more; with others
        two fields in a row where one does not come to the goal. A flow along one field keeps the
        value wherever it is zero, and one of two does not.

        In the norm of first order measured functions have one way: its fields follow small scales
        by themselves, and a third of alpha found no more on 21 of 22 problems.
        """
        p, first = self._p, Way(self._p.alpha, fields)
        if self.is_fixed or not p.solver.reach:
            return [first]
        if self._has_detail:
            less = first._replace(alpha=_LESS * p.alpha)
            is_smooth = p.alpha > 0 and p.solver.order > 1
            return [first, less] if self.is_measured and is_smooth else [first]
        return [first] if p.solver.segments or fields > 1 else [first, first._replace(fields=2)]

    def reach(self, before: float) -> float:
        """Return how far a way looks after one that left so much: as far as it can, if that did
        not find the target.
        """
        lost = self.is_free and not self.is_found(before) and not self._is_bare
        return LONGEST if lost else self.first_reach

    @property
    def first_reach(self) -> float:
        """How far the first way looks."""
        return 0.0 if self._is_bare else self._p.solver.reach

    def stage(
        self, level: int, sigma: float, way: Way, reach: float = 0.0, error: float = 0.0
    ) -> Stage:
        """Return the stage of a sigma on a level with this discretisation error (residual).

        On a coarse level the result of the given sigma is only a start for the mesh itself. The
        stage then ends at the discretisation error, as a smaller residual on the coarse mesh means
        nothing on the mesh itself, and a search where the residual stalls.
        """
        p, alpha, is_last = self._p, way.alpha, level >= self._meshes - 1
        if self.is_free and not self._is_bare:
            alpha *= min(1.0, sigma / (_STIFF * self.unit)) ** 2
        own = (
            p.stage_limits()[0 if sigma > self.sigmas[-1] else -1]
            if self.is_fixed
            else p.solver.iterations
        )
        goal = _CLOSE * p.goal if self.is_free else 0.0
        is_start = self.is_given and not (self.is_fixed or is_last) and sigma == self.sigmas[-1]
        goal = error if is_start else goal
        until = p.solver.iterations if is_last else int(_SHARE * p.solver.iterations)
        return Stage(
            level,
            way.fields,
            sigma,
            alpha,
            reach,
            own,
            until,
            self.is_fixed,
            goal,
            self.landmark_sigma(sigma),
            is_search=is_start and reach > 0,
        )

    def landmark_sigma(self, sigma: float) -> float:
        """Return that of landmarks beside a sigma: it falls faster, so that landmarks lead."""
        first, last = self.sigmas[0], self.sigmas[-1]
        if not self._has_landmarks:
            return self._p.landmark_sigma
        times = sigma / last
        if not self._is_bare:
            times = min(times, max(1.0, _LOOSE * (sigma / first) ** _FASTER))
        return self._p.landmark_sigma * times

    def _sigmas(self) -> list[float]:
        p = self._p
        if p.paper.cooling_stages:
            return p.stage_sigmas()
        last = self.unit * LAST if p.sigma is None else p.sigma
        if self._is_bare:
            return [last * times for times in _BARE]
        ratio = math.sqrt(p.paper.cooling_factor) if self.is_measured else p.paper.cooling_factor
        warmest = self.unit * WARMEST
        count = max(0, math.floor(math.log(warmest / last, ratio) + _ROUNDING))
        if p.sigma is None:
            return [warmest / ratio**step for step in range(count + 1)]
        return [last * ratio**left for left in reversed(range(count + 1))]

    @staticmethod
    def is_found(residual: float) -> bool:
        return residual <= _FOUND
