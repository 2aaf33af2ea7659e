"""The course of a match: which mesh, reach and sigma each stage has, and when it ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from abfm.parameters import Parameters

REACHED = 0.5
"""Mismatch at which a search for the target has found it."""
CLOSE = 0.03
"""Mismatch at which a match on the mesh itself is close enough: flow lines seldom confirm less."""
_CLOSE_ON_COARSER = 0.04
MATCHED = 0.05
"""Mismatch up to which functions are matched; a match that leaves more goes on with a smaller sigma."""
_PAYING, _OVER = 0.03, 6  # a stage goes on while its energy falls by this share within so many iterations
_OVER_AT_LAST = 15  # the same on the mesh itself, as long as it is not matched
_TRIES = ((1.0, 1.0), (2.0, 1 / 3), (0.5, 1 / 3))  # factors of reach and of the first sigma in a search
_WARMER = (27.0, 9.0, 3.0, 1.0)  # times the first sigma of a search, in a way that is gradual
_SEARCH, _COARSE = 0.4, 0.75  # of all iterations: in one stage of a search, and before the mesh itself
_FINE = 0.15  # of all iterations, in one stage on the mesh itself after coarser ones
_JOINED = 0.9  # of all iterations, before the mesh comes without vertices held together
_SMALLER, _CLOSING = 1 / 3, 2  # factor of sigma in stages after the last one, and how many of them


@dataclass(frozen=True)
class Stage:
    """A part of a match.

    Attributes
    ----------
    level : int
        Which mesh, from 0, the coarsest.
    sigma : float
        As the parameters give it.
    reach : float
        Of its norm of mismatches, in sqrt(area); 0 for that of the parameters.
    iterations : int
        At most.
    until : int
        Of all iterations together, at most.
    patient : bool
        Whether it goes on to the end of its iterations, or only as long as it pays.
    goal : float
        Mismatch at which it ends.
    needed_above : float
        It is left out where the mismatch is this small already.
    last : bool
        Whether it is on the mesh itself with the last sigma or a smaller one.
    balanced : bool
        Whether it weighs flow lines against the discrete advection.
    """

    level: int
    sigma: float
    reach: float
    iterations: int
    until: int
    patient: bool
    goal: float = 0.0
    needed_above: float = 0.0
    last: bool = False
    balanced: bool = False

    def pays(self, energies: list[float], mismatch: float) -> bool:
        """Whether to go on after these energies, one for each of the stage's iterates, at this mismatch."""
        over = _OVER_AT_LAST if self.last and mismatch > MATCHED else _OVER
        return self.patient or len(energies) <= over or energies[-1] < (1 - _PAYING) * energies[-1 - over]


def search(p: Parameters, levels: int, joined: bool = False) -> list[list[Stage]]:
    """Ways to find the target on the coarsest level, one to be tried after the other until it is `REACHED`.

    Each begins with the norm that reaches far and ends with that of the parameters. Without reach there is one, the
    paper's: every sigma but the last. ``levels`` and ``joined`` are those of `finish`.
    """
    meshes = levels - joined
    patient = _is_patient(p, meshes)
    until = p.iterations if meshes == 1 else int(_COARSE * p.iterations)
    sigmas = p.stage_sigmas()
    near = Stage(0, sigmas[0], 0.0, p.stage_limits()[0], until, patient)
    if not p.reach:
        return [[replace(near, sigma=sigma) for sigma in sigmas[:-1]]] if len(sigmas) > 1 else []
    far = replace(near, iterations=p.stage_iterations or max(1, int(_SEARCH * p.iterations)))
    return [[replace(far, reach=p.reach * further, sigma=sigmas[0] * colder), near] for further, colder in _TRIES]


def gradual(p: Parameters, levels: int, joined: bool = False) -> list[Stage]:
    """The first way of `search` from a larger sigma on, where a field is smooth before it follows details.

    It ends with the same sigma, so that both compare. None without reach, and with fixed numbers of iterations.
    """
    if not p.reach or p.stage_iterations or p.cooling_stages == 1:
        return []
    far, near = search(p, levels, joined)[0]
    sigmas = [near.sigma * warmer for warmer in _WARMER]
    return [replace(far, sigma=sigmas[0]), *(replace(near, sigma=sigma) for sigma in sigmas)]


def finish(p: Parameters, levels: int, warm: bool, joined: bool = False, raised: float = 0.0) -> list[Stage]:
    """What follows once the target is found: the other sigmas, the finer meshes, flow lines, the mesh as it is.

    With a fixed number of iterations per stage, and without reach on one mesh, which is the paper's way, stages go on
    to the end of their iterations; else they end when they stop paying, or are close.

    Parameters
    ----------
    p : Parameters
    levels : int
    warm : bool
        Whether the target is found already by given fields.
    joined : bool
        Whether the last level but one has the mesh itself already, with vertices of thin triangles held together: it
        takes the place of the last one, where only what then misses the target goes on.
    raised : float
        A larger last sigma than that of the parameters, which is the only one then but for those of closing stages.
    """
    meshes = levels - joined
    patient = _is_patient(p, meshes)
    goal, coarse_goal = (0.0, 0.0) if patient else (CLOSE, _CLOSE_ON_COARSER)
    most = p.iterations if patient or meshes == 1 else max(1, int(_FINE * p.iterations))
    until = int(_JOINED * p.iterations) if joined and not patient else p.iterations
    last = Stage(meshes - 1, max(p.sigma, raised), 0.0, most, until, patient, goal, last=True)
    coarse = replace(
        last, level=0, iterations=p.iterations, until=int(_COARSE * p.iterations), goal=coarse_goal, last=False
    )
    sigmas = p.stage_sigmas()[1:-1] if p.reach and not warm and not raised else []
    plan = [replace(coarse if meshes > 1 else replace(last, last=False), sigma=sigma) for sigma in sigmas]
    if not warm:
        plan += [replace(coarse, level=level) for level in range(meshes - 1)]
    plan += [last, *_closing(replace(last, iterations=p.iterations), p.sigma)]
    if p.balance:
        plan.append(replace(last, balanced=True))
    if joined:
        fine = p.iterations if patient else max(1, int(_FINE * p.iterations))
        itself = replace(last, level=levels - 1, iterations=fine, until=p.iterations, goal=0.0 if patient else MATCHED)
        plan += [itself, *_closing(itself, p.sigma)]
    return plan


def _closing(last: Stage, sigma: float) -> list[Stage]:
    """Smaller sigmas for what is not matched with the last one, down to those below the parameters' sigma."""
    if last.patient:
        return []
    closing = replace(last, goal=MATCHED, needed_above=MATCHED)
    steps = _CLOSING + math.ceil(math.log(last.sigma / sigma, 1 / _SMALLER) - 1e-9)
    return [replace(closing, sigma=last.sigma * _SMALLER**step) for step in range(1, steps + 1)]


def _is_patient(p: Parameters, meshes: int) -> bool:
    return p.stage_iterations > 0 or (p.reach == 0 and meshes == 1)
