"""Views and colours of two corresponding surfaces."""

import numpy as np

from abfm.calculus.operators import vertex_areas
from abfm.matching import Match
from abfm.pages.colormaps import ColorRange, typical_range
from abfm.pages.front import Front, best_front, triple
from abfm.registration import Correspondence, Registration
from abfm.types import FloatArray

CHANNELS_MAX = 4  # maximum number of pairs of functions that are shown


def fronts(found: Correspondence, up: str | None = None) -> tuple[Front, Front]:
    """Return the fronts from which A and B are shown.

    B is shown from its best side, or a cortex from its lateral side. A is shown from the side of B,
    rotated like the points of B by the map. ``up`` is the axis that points upwards.
    """
    target = []
    if isinstance(found, Registration) and not found.match.problem.is_of_landmarks:
        target = [found.match.target[:, 0]]
    of_b = best_front(found.b, *target, up=up)
    if found.a.structure and up in (None, "z"):
        return best_front(found.a, up=up), of_b
    rotation = _rotation(found)
    of_a = Front(*(triple(rotation @ np.array(one)) for one in (of_b.direction, of_b.up)))
    return of_a, of_b


def _rotation(found: Correspondence) -> FloatArray:
    """Return the orthogonal matrix (3, 3) that rotates B to its points on A (Kabsch 1976).

    The matrix minimises the distances of centred points. For a mirrored map it is a reflection.
    """
    if found.a is found.b:
        return np.eye(3)
    weights = vertex_areas(found.b) / vertex_areas(found.b).sum()
    points_b, points_a = (
        places - weights @ places for places in (found.b.vertices, found.points.positions)
    )
    u, _, v = np.linalg.svd((points_a * weights[:, None]).T @ points_b)
    sign = np.sign(np.linalg.det(u @ v)) * (-1 if found.is_mirrored else 1)
    return np.asarray(u @ np.diag([1, 1, sign]) @ v)


def functions_on_a(found: Registration) -> FloatArray:
    """Return the compared functions of A, (V_A, C), or else the source on B, transferred to A."""
    if found.functions is not None:
        return found.functions
    return found.initial.inverse().transfer(found.match.source)


def mask_indicator(match: Match) -> FloatArray:
    """Return 1 where the mismatch is evaluated and 0 where a mask hides it, (V,)."""
    if match.mask is None:
        return np.ones(len(match.target))
    return np.asarray((match.mask > 0).astype(float))


def common_colors(match: Match, channel: int) -> ColorRange:
    """Return one colour range of source and target, without masked or extreme values."""
    shown = mask_indicator(match) > 0
    pair = match.source[shown, channel], match.target[shown, channel]
    return typical_range(*pair)
