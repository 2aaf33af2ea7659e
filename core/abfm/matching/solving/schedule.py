"""The course of a match: which mesh, reach and sigma each stage has, and when it ends."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from abfm.parameters import Parameters

REACHED = 0.5  # mismatch at which a search for the target has found it
_SURE = 0.2  # the same where less smooth attempts are still to be made
# mismatch at which a match on the mesh itself is close enough, as flow lines seldom confirm less,
# and on coarser ones
CLOSE, _CLOSE_ON_COARSER = 0.03, 0.04
# mismatch up to which functions are matched, or nearly; with more a match goes on, with less sigma
MATCHED, NEARLY = 0.05, 0.15
# a stage goes on while its energy falls by this share within so many iterations
_PAYING, _OVER = 0.03, 6
_PAYING_WELL = 0.1  # the same where a stage with less smoothness follows, if it is needed
_LESS = 1 / 3  # factor of a smaller sigma and of a smaller alpha
# factors of reach and of the first sigma in a search
_TRIES = ((1.0, 1.0), (2.0, _LESS), (0.5, _LESS))
_WARMER = (27.0, 9.0, 3.0, 1.0)  # times the first sigma of a search, in one that is gradual
# of all iterations: in one stage of a search, and before the mesh itself
_SEARCH, _COARSE = 0.4, 0.75
_FINE = 0.15  # of all iterations, in one stage on the mesh itself after coarser ones
_CLUSTERED = 0.9  # of all iterations, before the mesh comes without clusters of vertices
_STAGES = 3  # of sigma, where none are given
_CLOSING = 4  # stages with ever smaller sigmas, and alphas as their squares, after the last one


@dataclass(frozen=True)
class Stage:
    level: int  # which mesh, from 0, the coarsest
    sigma: float  # as the parameters give it, and alpha
    alpha: float
    reach: float  # of its norm of mismatches, in sqrt(area); 0 for that of the parameters
    iterations: int  # at most, of its own
    until: int  # at most, of all together
    fixed: bool  # whether it goes on to the end of its iterations
    goal: float = 0.0  # mismatch at which it ends
    needed_above: float = 0.0  # mismatch up to which it is left out
    last: bool = False  # whether it is on the mesh itself with the last sigma or a smaller one
    balanced: bool = False  # whether it weighs flow lines against the discrete advection
    # unless fixed it goes on while it gains this share of its energy again and again
    paying: float = _PAYING

    def continues(self, before: "Stage") -> bool:
        """Tell whether what the stage before learned serves; if fixed not with another sigma."""
        same = (before.level, before.reach, before.alpha) == (self.level, self.reach, self.alpha)
        return same and not (self.fixed and before.sigma != self.sigma)

    def pays(self, energies: list[float]) -> bool:
        """Tell whether to go on after these energies, one for each of the stage's iterates."""
        early = self.fixed or len(energies) <= _OVER
        return early or energies[-1] < (1 - self.paying) * energies[-1 - _OVER]


class Attempt(NamedTuple):
    stages: list[Stage]
    found: float


def search(p: Parameters, levels: int, clustered: bool = False) -> list[Attempt]:
    """Attempts to find the target on the coarsest level, made until it is found.

    Each begins with the norm that reaches far, the first one with the parameters' alpha, others
    with less. Without reach there is one, the paper's: all sigmas but the last.
    """
    p, meshes = _in_stages(p), levels - clustered
    fixed, sigmas = _is_fixed(p, meshes), p.stage_sigmas()
    until = p.iterations if meshes == 1 else int(_COARSE * p.iterations)
    near = Stage(0, sigmas[0], p.alpha, 0.0, p.stage_limits()[0], until, fixed)
    if not p.reach:
        cooled = [replace(near, sigma=sigma) for sigma in sigmas[:-1]]
        return [Attempt(cooled, REACHED)] if cooled else []
    far = replace(near, iterations=p.stage_iterations or max(1, int(_SEARCH * p.iterations)))
    tries = [
        [replace(far, reach=p.reach * further, sigma=sigmas[0] * colder), near]
        for further, colder in _TRIES
    ]
    if fixed or not p.alpha:
        return [Attempt(stages, REACHED) for stages in tries]
    less = [[replace(stage, alpha=_LESS * p.alpha) for stage in stages] for stages in tries]
    return [Attempt(tries[0], _SURE), *(Attempt(stages, REACHED) for stages in less)]


def gradual(p: Parameters, levels: int, clustered: bool = False) -> list[Stage]:
    """List the second attempt of `search` from larger sigmas on, to the same one; [] if fixed."""
    if not p.reach or p.stage_iterations or p.cooling_stages == 1:
        return []
    first = search(p, levels, clustered)[0].stages
    far, near = (replace(stage, alpha=_LESS * p.alpha) for stage in first)
    sigmas = [near.sigma * warmer for warmer in _WARMER]
    return [replace(far, sigma=sigmas[0]), *(replace(near, sigma=sigma) for sigma in sigmas)]


class Found(NamedTuple):
    warm: bool  # whether by given fields
    # a larger last sigma than that of the parameters: the only one, but for closing stages
    raised: float = 0.0
    alpha: float | None = None  # if not that of the parameters


def finish(p: Parameters, levels: int, found: Found, clustered: bool = False) -> list[Stage]:
    """List what follows once the target is found: other sigmas, finer meshes, flow lines.

    Without reach on one mesh, as in the paper, stages go on to the end of their iterations, which
    may be fixed; else until they stop paying, or are close. If ``clustered`` the last level but one
    is the mesh itself with clusters of vertices; on the last only what misses the target goes on.
    """
    p, meshes = _in_stages(p), levels - clustered
    fixed = _is_fixed(p, meshes)
    share = max(1, int(_FINE * p.iterations))
    last = Stage(
        meshes - 1,
        max(p.last_sigma, found.raised),
        p.alpha if found.alpha is None else found.alpha,
        0.0,
        p.iterations if fixed or meshes == 1 else share,
        int(_CLUSTERED * p.iterations) if clustered and not fixed else p.iterations,
        fixed,
        goal=0.0 if fixed else CLOSE,
        last=True,
        paying=_PAYING_WELL,
    )
    coarse = replace(
        last,
        level=0,
        iterations=p.iterations,
        until=int(_COARSE * p.iterations),
        goal=0.0 if fixed else _CLOSE_ON_COARSER,
        last=False,
    )
    sigmas = p.stage_sigmas()[1:-1] if p.reach and not found.warm and not found.raised else []
    cooling = coarse if meshes > 1 else replace(last, last=False)
    plan = [replace(cooling, sigma=sigma) for sigma in sigmas]
    if not found.warm:
        plan += [replace(coarse, level=level) for level in range(meshes - 1)]
    plan += [last, *_closing(replace(last, iterations=p.iterations), p)]
    if p.balance:
        plan.append(replace(last, balanced=True))
    if clustered:
        itself = replace(
            last,
            level=levels - 1,
            iterations=p.iterations if fixed else share,
            until=p.iterations,
            goal=0.0 if fixed else MATCHED,
        )
        plan += [itself, *_closing(itself, p)]
    return plan


def _closing(last: Stage, p: Parameters) -> list[Stage]:
    if last.fixed:
        return []
    closing = replace(
        last, alpha=_LESS * p.alpha, goal=MATCHED, needed_above=MATCHED, paying=_PAYING
    )
    smoother = [closing] if closing.alpha < last.alpha else []
    steps = range(
        1, _CLOSING + 1 + math.ceil(math.log(last.sigma / p.last_sigma, 1 / _LESS) - 1e-9)
    )
    return smoother + [
        replace(closing, sigma=last.sigma * _LESS**step, alpha=closing.alpha * _LESS ** (2 * step))
        for step in steps
    ]


def _in_stages(p: Parameters) -> Parameters:
    return p if p.cooling_stages else replace(p, cooling_stages=_STAGES)


def _is_fixed(p: Parameters, meshes: int) -> bool:
    return p.stage_iterations > 0 or (p.reach == 0 and meshes == 1)
