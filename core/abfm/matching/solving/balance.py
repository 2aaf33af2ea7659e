"""The end of a match: flow lines weighed against the discrete advection.

The scheme disperses, and flow lines of a field made continuous are off by a little too: neither is the flow. With
``g + b (f_tau - f o phi)`` as target a perfect match has ``(1 - b) f_tau + b (f o phi) = g``, so that both share what
divides them. No derivative of flow lines is needed.
"""

from collections.abc import Callable

import numpy as np

from abfm.errors import ParameterError
from abfm.matching.energy.energy import MatchingEnergy
from abfm.matching.judging.confirmation import Best, by_flow_lines
from abfm.matching.schedule import MATCHED
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
    best: Best,
    go_on: Callable[[FloatArray, FloatArray], Best | None],
    between: Callable[[], None],
) -> Best:
    """Move the target by a share of what divides both witnesses, again and again; the best round stays.

    After a round that costs the discrete mismatch more than it may, or gains nothing, the share is halved.

    Parameters
    ----------
    energy : MatchingEnergy
    best : Best
        The start.
    go_on : callable
        Some iterations from fields (N, F, 2) towards a target (C, V); None where none are left.
    between : callable
        Called again and again; what it raises ends the work.
    """
    weight = share = energy.parameters.balance
    allowed = max(energy.relative_mismatch(best.point.advected), MATCHED)
    away = np.zeros_like(energy.target)
    known, least = best, np.inf
    for _ in range(_ROUNDS):
        try:
            walked = by_flow_lines(energy, known.x, between)
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
            if gains_little:
                break
        if energy.relative_mismatch(energy.target + away) < _GAP:
            break
        found = go_on(best.x, energy.target + share * away)
        if found is None:
            break
        known = found
    return best
