"""How two surfaces that correspond are seen: from where, and in which colours."""

import numpy as np

from abfm.calculus.operators import vertex_areas
from abfm.matching import Match
from abfm.pages.colormaps import ColorRange, typical_range
from abfm.pages.front import Front, best_front, triple
from abfm.registration import Correspondence, Registration
from abfm.types import FloatArray

MOST_CHANNELS = 4
"""The most pairs of functions that are shown."""


def fronts(found: Correspondence, up: str | None = None) -> tuple[Front, Front]:
    """Return from where A and B are seen: B from its best side, and A from where most of what is
    seen of B lies on it, turned as the map turns B; a cortex from its own lateral side.
    """
    target = []
    if isinstance(found, Registration) and not found.match.problem.is_of_landmarks:
        target = [found.match.target[:, 0]]
    of_b = best_front(found.b, *target, up=up)
    if found.a.structure and up in (None, "z"):
        return best_front(found.a, up=up), of_b
    turn = _turn(found)
    of_a = Front(*(triple(turn @ np.array(one)) for one in (of_b.direction, of_b.up)))
    return of_a, of_b


def _turn(found: Correspondence) -> FloatArray:
    """Return the orthogonal matrix (3, 3) that turns B's places about their middle as near to where
    they lie on A as it can; of a mirrored map one that mirrors (Kabsch 1976).
    """
    if found.a is found.b:
        return np.eye(3)
    weights = vertex_areas(found.b) / vertex_areas(found.b).sum()
    here, there = (
        places - weights @ places for places in (found.b.vertices, found.points.positions)
    )
    u, _, v = np.linalg.svd((there * weights[:, None]).T @ here)
    sign = np.sign(np.linalg.det(u @ v)) * (-1 if found.is_mirrored else 1)
    return np.asarray(u @ np.diag([1, 1, sign]) @ v)


def functions_on_a(found: Registration) -> FloatArray:
    """Return A's functions (V_A, C), as they are compared; or what the initial map brings back."""
    if found.functions is not None:
        return found.functions
    return found.initial.inverse().transfer(found.match.source)


def counts(match: Match) -> FloatArray:
    """Return 1 where the mismatch counts and 0 where a mask hides it, (V,)."""
    if match.mask is None:
        return np.ones(len(match.target))
    return np.asarray((match.mask > 0).astype(float))


def compared_colors(match: Match, channel: int) -> ColorRange:
    """Return one range for source and target of a channel, where they count, but for extremes."""
    shown = counts(match) > 0
    pair = match.source[shown, channel], match.target[shown, channel]
    return typical_range(*pair)
