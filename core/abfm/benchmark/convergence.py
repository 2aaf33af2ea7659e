"""Progress per iteration, which should not depend on how fine the mesh is."""

from __future__ import annotations

from dataclasses import dataclass, replace

from abfm.benchmark.problem import PARAMETERS, Problem
from abfm.matching.match import Control, Iteration, match
from abfm.parameters import Parameters
from abfm.types import FloatArray

COOLED = replace(PARAMETERS, cooling_stages=Parameters().cooling_stages)


@dataclass(frozen=True)
class Convergence:
    """Energy and relative mismatch of each iterate, and the last field (F, 3) in the mesh's units."""

    energies: list[float]
    mismatches: list[float]
    velocity: FloatArray

    def iterations_to(self, level: float) -> int | None:
        """Iterations until the mismatch was at most ``level``; None if it never was."""
        return next((i for i, mismatch in enumerate(self.mismatches) if mismatch <= level), None)


def converge(problem: Problem, parameters: Parameters, until: float = 0.0) -> Convergence:
    """Match until the mismatch is at most ``until``, or to the iteration limit."""
    control = Control()
    energies, mismatches = [], []

    def record(iterate: Iteration) -> None:
        energies.append(iterate.energy)
        mismatches.append(iterate.mismatch)
        if iterate.mismatch <= until:
            control.cancel()

    result = match(problem.mesh, problem.source, problem.target, parameters, on_iteration=record, control=control)
    return Convergence(energies, mismatches, result.velocity[0])
