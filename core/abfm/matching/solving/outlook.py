"""Estimates of the remaining time of a match; no result depends on them.

The constants describe 30 matches on meshes of 300 to 41,000 vertices. Numbers of iterations are
rounded up from their means.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable
from typing import NamedTuple

from abfm.matching.solving.settings import SETTINGS
from abfm.workers.progress import work_time

SECOND_SHARE = 0.3  # share of matches whose first attempt fails
REFINED_SHARE = 0.8  # share of matches that are refined after a failed attempt, if they can be
COARSE_SHARE = 0.25  # share of these, if the problem has coarser meshes than its own
_STEP_ITERATIONS = 15  # of a step of the search, unless an earlier attempt had this step
_END_ITERATIONS = 100  # of the last step, if its sigma is given
_MESH_ITERATIONS = 15  # on the mesh of the problem, after the search
_REFINED_ITERATIONS = (100, 80, 40)  # on consecutive midpoint subdivisions
_EXACT_ITERATIONS = 20  # without clusters of vertices
_COST_WITHOUT_CLUSTERS = 4.0  # ratio of the time of such an iteration to that with clusters
_CONTINUED_SHARE = 0.5  # least ratio of remaining to finished iterations of a step
_COST_EXPONENT = 1.3  # the time of an iteration grows with this power of the vertices
_COST_OF_FIELDS = 1.5  # ratio of the time of an iteration with two fields to that with one
_SECONDS_PER_VERTEX = 5e-5  # for the preparation of a mesh, and the check by flow lines
_ITERATION_SECONDS = 6e-6  # per vertex, before any iteration
_SEARCH_ITERATIONS = 100
_TIME_RATIO_MAX = 5.0  # of an iteration to the mean; longer times include a pause
_UNTIMED_ITERATIONS = 2  # the first ones on a mesh, which include its preparation
_PRIOR_ITERATIONS = 4  # the expected time of an iteration counts as much as these
_ITERATIONS_MIN = 3  # from this number of iterations on, time is reported
_REPORT_SECONDS = 0.1  # between two reports
Key = tuple[int, int]  # numbers of vertices and of fields


def expected_seconds(vertices: int) -> float:
    """Return the usual duration of a match on a mesh, in seconds."""
    coarse = min(vertices, SETTINGS.coarsest_vertices)
    iterations = _SEARCH_ITERATIONS * coarse + _MESH_ITERATIONS * (vertices - coarse)
    return _ITERATION_SECONDS * iterations + _SECONDS_PER_VERTEX * vertices


class Plan(NamedTuple):
    """The present sweep of a continuation, and what may follow it."""

    fields: int  # number of consecutive fields
    steps: int = 0  # remaining steps of an attempt of the search; 0 after the search
    is_clustered: bool = False  # whether vertices form clusters
    is_exact: bool = False  # whether the clusters of such a mesh are not used
    has_given_end: bool = False  # whether the last sigma is given
    attempts: float = 0.0  # expected number of later attempts
    sizes: tuple[int, ...] = ()  # vertices of the problem's mesh, if a coarser one is in use
    refined: int = 0  # number of subdivisions so far
    finer: tuple[int, ...] = ()  # vertices of possible subdivisions
    finer_share: float = 0.0  # probability that they are used


class Outlook:
    """Measures the time of iterations, and reports the remaining seconds and the phase.

    ``vertices`` is the number of vertices of the first mesh.
    """

    def __init__(self, report: Callable[[float, str], None], vertices: int) -> None:
        self._report, self._vertices = report, vertices
        self._plan: Plan | None = None
        self._done = 0  # iterations of the present step
        self._attempts: list[list[int]] = [[]]  # iterations of each step, by attempt
        # seconds and iterations by vertices and number of fields
        self._seconds, self._timed = defaultdict[Key, float](float), Counter[Key]()
        self._name = "match"  # the phase that was reported last
        self._latest: Key | None = None
        self._untimed = 0  # number of the next iterations whose time is not used
        self._now = self._reported = work_time()

    def plan(self, plan: Plan) -> None:
        """Take the next step of a continuation into account."""
        if self._plan is not None:
            if self._plan.steps:
                self._attempts[-1].append(self._done)
            elif plan.steps:
                self._attempts.append([])
        self._plan, self._done = plan, 0
        if self._latest is None:
            self._report(self.seconds(plan), self._name)

    def add(self, vertices: int) -> None:
        """Take an iterate on a level with this number of vertices into account."""
        assert self._plan is not None
        now, key = work_time(), (vertices, self._plan.fields)
        if key != self._latest:
            self._untimed, self._latest = _UNTIMED_ITERATIONS, key
        if not self._timed[key]:
            cost = _COST_WITHOUT_CLUSTERS if self._plan.is_exact else 1.0
            self._seconds[key] = cost * _PRIOR_ITERATIONS * self._each(*key)
            self._timed[key] = _PRIOR_ITERATIONS
        elif not self._untimed:
            is_first = self._timed[key] == _PRIOR_ITERATIONS
            most = math.inf if is_first else _TIME_RATIO_MAX * self._each(*key)
            self._seconds[key] += min(now - self._now, most)
            self._timed[key] += 1
        self._untimed = max(self._untimed - 1, 0)
        self._done, self._now = self._done + 1, now
        name = "refine" if self._plan.refined else "match"
        is_due = name != self._name or now - self._reported >= _REPORT_SECONDS
        if is_due and self._timed.total() >= _PRIOR_ITERATIONS + _ITERATIONS_MIN:
            self._name, self._reported = name, now
            self._report(self.seconds(self._plan), name)

    def seconds(self, plan: Plan) -> float:
        """Return the estimated remaining seconds, after the latest iterate if there is one."""
        vertices, fields = self._latest or (self._vertices, plan.fields)
        each, later = self._each(vertices, fields), _SECONDS_PER_VERTEX * vertices
        if plan.steps:
            steps = self._usual_steps(plan.steps)
            steps[-1] = max(steps[-1], _END_ITERATIONS * plan.has_given_end)
            usual, *left = steps[-plan.steps :]
            later = sum(left) * each
            later += plan.attempts * sum(steps) * self._each(vertices, 2 * fields)
        else:
            times = min(plan.refined, len(_REFINED_ITERATIONS))
            usual = _REFINED_ITERATIONS[times - 1] if times else _MESH_ITERATIONS
            usual = _EXACT_ITERATIONS if plan.is_exact else usual
        later += max(usual - self._done, _CONTINUED_SHARE * self._done) * each
        if plan.is_clustered:
            later += _EXACT_ITERATIONS * _COST_WITHOUT_CLUSTERS * each
        for size in plan.sizes:
            later += _MESH_ITERATIONS * self._each(size, fields) + _SECONDS_PER_VERTEX * size
        pairs = zip(plan.finer, _REFINED_ITERATIONS[plan.refined :], strict=False)
        finer = sum(count * self._each(size, fields) for size, count in pairs)
        return later + plan.finer_share * finer

    def _usual_steps(self, remaining: int) -> list[int]:
        """Return the usual numbers of iterations of all steps of the present attempt."""
        known = self._attempts[-2] if len(self._attempts) > 1 else []
        finished = self._attempts[-1]
        total, usual = len(finished) + remaining, _STEP_ITERATIONS
        if finished:
            usual = max(usual, sum(finished) // len(finished))
        return [*known[:total], *[usual] * (total - len(known))]

    def _each(self, vertices: int, fields: int) -> float:
        """Return the seconds of an iteration, extrapolated from the latest ones if necessary."""
        key = vertices, fields
        if not self._timed:
            return _ITERATION_SECONDS * vertices
        known = key if self._timed[key] else list(self._timed)[-1]
        ratio = (vertices / known[0]) ** _COST_EXPONENT
        ratio *= _COST_OF_FIELDS if fields > known[1] else 1.0
        return float(ratio * self._seconds[known] / self._timed[known])
