"""Whether flow lines confirm what the discrete advection shows, while a match goes on.

Attempts are compared by their energy with flow lines in place of the discrete advection.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from abfm.calculus.vector_fields import to_ambient
from abfm.errors import ParameterError
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.matching.objective.matching_energy import Evaluation, MatchingEnergy
from abfm.matching.solvability import narrowest
from abfm.matching.solving.schedule import NEARLY
from abfm.types import FloatArray

_PAYING = 0.03  # of what flow lines leave: what a colder stage must gain
# of the same: what a stage that matches may lose; and of an energy: what a gradual search may lose
_ALIKE = 0.1
# that a function's features span at least where flow lines tell what cannot be matched
_EDGES = 3.0
_MOST_WALKS = 50_000  # vertices: finer meshes carry what is matched on them


class Confirmation(NamedTuple):
    """What flow lines say of fields; all inf for fields that are too fast."""

    mismatch: float = np.inf  # over the norm of g
    energy: float = np.inf  # with a sigma
    left: float = np.inf  # the mismatch in the unit of sigma

    @property
    def is_doubtful(self) -> bool:
        """Whether they leave so much that another search for the target is worth its cost."""
        return self.mismatch > NEARLY

    def gains(self, before: Confirmation) -> bool:
        return self.mismatch < (1 - _PAYING) * before.mismatch

    def is_as_low(self, before: Confirmation) -> bool:
        """Tell whether the energy is about as low: what two searches come to is the least."""
        return self.energy < (1 + _ALIKE) * before.energy

    def equals(self, before: Confirmation) -> bool:
        """Tell whether they leave about as much as before, or less: what matches better is real."""
        return self.mismatch <= (1 + _ALIKE) * before.mismatch


def is_walked(energy: MatchingEnergy) -> bool:
    """Tell whether flow lines are asked: not on large meshes, nor for linearised steps."""
    return len(energy.mesh.vertices) <= _MOST_WALKS and energy.parameters.method != "linearised"


def is_resolved(energy: MatchingEnergy) -> bool:
    """Tell whether the mesh carries the functions at all; else flow lines leave much anyway."""
    return narrowest(energy.functions) >= _EDGES


def by_flow_lines(energy: MatchingEnergy, x: FloatArray) -> FloatArray:
    """Return the source (C, V) carried along the continuous fields; ParameterError if too fast."""
    fields = to_ambient(energy.mesh, x)
    flow = ContinuousFlow(energy.mesh, fields, energy.parameters.tau)
    return np.ascontiguousarray(flow.origins().pull_back(energy.terms.carried.T).T)


def confirmation(energy: MatchingEnergy, found: Evaluation, sigma: float) -> Confirmation:
    try:
        carried = by_flow_lines(energy, found.x)
    except ParameterError:
        return Confirmation()
    missed = energy.mismatch_energy(carried, sigma)
    return Confirmation(
        energy.relative_mismatch(carried),
        found.regularity + missed,
        sigma * float(np.sqrt(2 * missed)),
    )
