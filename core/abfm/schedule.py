"""The course of a match: which mesh, reach and sigma each stage has, and when it ends."""

from __future__ import annotations

from dataclasses import dataclass, replace

from abfm.parameters import Parameters

FURTHER = 2.0
"""Factor of the reach in another stage after one that left its mismatch standing."""
STANDING = 0.5
"""Share of the mismatch, in the stage's own norm, that counts as left standing."""
FURTHEST = 2.0
"""Largest reach that is tried, in sqrt(area): beyond it the norm only compares the functions' means."""
_PAYING, _OVER = 0.03, 5  # a stage goes on while its energy falls by this share within so many iterations
_FAR_SHARE = 0.4  # of all iterations, at most, in a stage with reach


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
    patient : bool
        Whether it goes on to the end of its iterations, or only as long as it pays.
    balanced : bool
        Whether it weighs flow lines against the discrete advection.
    """

    level: int
    sigma: float
    reach: float
    iterations: int
    patient: bool
    balanced: bool = False

    def pays(self, energies: list[float]) -> bool:
        """Whether to go on after these energies, one for each of the stage's iterates."""
        return self.patient or len(energies) <= _OVER or energies[-1] < (1 - _PAYING) * energies[-1 - _OVER]

    def further(self) -> Stage | None:
        """A stage that reaches further, or None."""
        return replace(self, reach=self.reach * FURTHER) if 0 < self.reach and self.reach * FURTHER <= FURTHEST else None


def stages(p: Parameters, levels: int, warm: bool) -> list[Stage]:
    """The plan of a match on so many meshes; one that starts close to its end, ``warm``, is not cooled again.

    With a fixed number of iterations per stage, and without reach on one mesh, which is the paper's way, stages go on
    to the end of their iterations; else they end when they stop paying.
    """
    patient = p.stage_iterations > 0 or (p.reach == 0 and levels == 1)
    last = Stage(levels - 1, p.sigma, 0.0, p.iterations, patient or not p.balance)
    ending = [replace(last, patient=False, balanced=True)] if p.balance else []
    if warm:
        return [last, *ending]
    sigmas = p.stage_sigmas()
    early = len(sigmas) - 1
    share = p.stage_iterations or (p.iterations // 2 // early if early else p.iterations)
    far = p.stage_iterations or max(1, int(_FAR_SHARE * p.iterations))
    plan = [Stage(0, sigmas[0], p.reach, far, patient)] if p.reach else []
    plan += [Stage(0, sigma, 0.0, share, patient) for sigma in sigmas[:-1]]
    plan += [Stage(level, p.sigma, 0.0, p.iterations, patient) for level in range(levels - 1)]
    return [*plan, last, *ending]
