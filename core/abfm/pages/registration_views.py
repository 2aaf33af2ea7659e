"""Views and colours of two corresponding surfaces."""

import math

import numpy as np

from abfm.calculus.operators import vertex_areas
from abfm.display import BEST_VIEW, ViewSpec
from abfm.matching import Match
from abfm.pages.color_ranges import color_range
from abfm.pages.colormaps import ColorRange
from abfm.pages.front import Front, front_of, triple, upward_axis
from abfm.reading import side_of
from abfm.registration import Correspondence, Registration
from abfm.types import FloatArray

CHANNELS_MAX = 4  # maximum number of pairs of functions that are shown
_UPRIGHT_COSINE = 0.95  # of the angle by which A may lean and still be shown upright


def fronts(found: Correspondence, view: ViewSpec = BEST_VIEW) -> tuple[Front, Front]:
    """Return the fronts from which A and B are shown; ``view`` is that of B.

    The best view shows the target and the source on B. A is shown from the corresponding side: see
    `corresponding_front`.
    """
    functions = []
    if isinstance(found, Registration) and not found.match.problem.is_of_landmarks:
        functions = [found.match.source[:, 0], found.match.target[:, 0]]
    of_b = front_of(found.b, *functions, view=view)
    return corresponding_front(found, of_b, view), of_b


def corresponding_front(found: Correspondence, of_b: Front, view: ViewSpec = BEST_VIEW) -> Front:
    """Return the front of A that shows the same parts as a front of B, by the map.

    The front of B is rotated like its points by the map. If A then is nearly upright, it is shown
    exactly upright, at the elevation of B. Cortices are shown from the same anatomical side.
    """
    sides = [side_of(mesh.structure) for mesh in (found.a, found.b)]
    if all(sides):
        rotation = np.diag([1.0 if sides[0] == sides[1] else -1.0, 1.0, 1.0])
    else:
        rotation = _rotation(found)
    _, up, direction = of_b.axes @ rotation.T
    own, of_target = (upward_axis(mesh, view.up) for mesh in (found.a, found.b))
    height = float(of_target @ of_b.direction)
    flat = direction - (direction @ own) * own
    is_upright = own @ rotation @ of_target > _UPRIGHT_COSINE and np.linalg.norm(flat) > 0.1
    if not is_upright:
        return Front(triple(direction), triple(up))
    flat *= math.sqrt(1 - height**2) / np.linalg.norm(flat)
    direction = flat + height * own
    up = own - height * direction
    return Front(triple(direction), triple(up / np.linalg.norm(up)))


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
    """Return one colour range of source and target, without masked values."""
    shown = mask_indicator(match) > 0
    pair = match.source[shown, channel], match.target[shown, channel]
    return color_range(*pair, areas=vertex_areas(match.mesh)[shown])
