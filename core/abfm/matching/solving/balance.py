"""The end of a match: flow lines weighed against the discrete advection.

The scheme disperses, and flow lines of a field made continuous are off by a little too: neither is
the flow. With ``g + b (f_tau - f o phi)`` as target a perfect match has
``(1 - b) f_tau + b (f o phi) = g``, so that both share what divides them. No derivative of flow
lines is needed.
"""

from collections.abc import Callable, Iterator

import numpy as np

from abfm.errors import ParameterError
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.confirmation import by_flow_lines
from abfm.matching.solving.incumbent import Candidate
from abfm.matching.solving.schedule import MATCHED
from abfm.types import FloatArray

ROUND = 8
"""Iterations between two looks at the flow lines."""
_ROUNDS = 6  # looks at most
_GAP = 0.01  # difference of flow lines and discrete advection, over ||g||, that is worth balancing
_APART = 0.5  # mismatch by flow lines beyond which both have nothing to share
_LEAST_SHARE = 0.3  # of the parameters' balance
_BETTER = 0.97  # of the mismatch before: a round that leaves more is the last one


def balanced(
    energy: MatchingEnergy,
    best: Candidate,
    go_on: Callable[[FloatArray, FloatArray], Candidate | None],
) -> Iterator[Candidate]:
    """Move the target by a share of what divides both witnesses, again and again.

    Yields ever better candidates; the last one is the best round. After a round that costs the
    discrete mismatch more than it may, or gains nothing, the share is halved.

    Parameters
    ----------
    energy : MatchingEnergy
    best : Candidate
        The start.
    go_on : callable
        Some iterations from fields (N, F, 2) that may leave an offset (C, V) of the target; None
        where none are left.
    """
    weight = share = energy.parameters.balance
    allowed = max(energy.relative_mismatch(best.point.advected), MATCHED)
    away = np.zeros_like(energy.terms.carried)
    known, least = best, np.inf
    for _ in range(_ROUNDS):
        try:
            walked = by_flow_lines(energy, known.x)
        except ParameterError:  # too fast for walks
            break
        advected = known.point.advected
        discrete, lines = energy.relative_mismatch(advected), energy.relative_mismatch(walked)
        if lines > _APART:
            break
        score = float(np.sqrt((1 - weight) * discrete**2 + weight * lines**2))
        if discrete > allowed or score >= least:
            share /= 2
            if share < _LEAST_SHARE * weight:
                break
        else:
            gains_little = score > _BETTER * least
            best, least, away = known, score, advected - walked
            yield best
            if gains_little:
                break
        if energy.terms.relative_size(away) < _GAP:
            break
        found = go_on(best.x, share * away)
        if found is None:
            break
        known = found
