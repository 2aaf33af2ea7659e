"""Critical points followed through time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import dijkstra

from abfm.calculus.operators import edge_graph, edge_lengths
from abfm.errors import ParameterError, brief
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import is_integer
from abfm.sequences.tracking.critical_points import CriticalPoints, PointKind
from abfm.types import FloatArray, IntArray

_DISTANCE_MAX = 6.0  # edges, along edges, that a point may go from one field to the next
_POINTS_AT_ONCE = 64  # points whose distances to all vertices are kept
_MISSED_FIELDS_MAX = 1  # fields in a row in which it may be missing


@dataclass(frozen=True, eq=False)
class Track:
    """A critical point through time.

    Attributes
    ----------
    times : (N,) array
        The middles of the intervals in which it was seen.
    points : SurfacePoints
        Where it was then, (N,).
    kinds : tuple of str
        What it was then: a source may become a spiral.
    index : int
        1 or -1, which stays.
    """

    times: FloatArray
    points: SurfacePoints
    kinds: tuple[PointKind, ...]
    index: int

    def __len__(self) -> int:
        return len(self.kinds)

    @property
    def kind(self) -> PointKind:
        """What it was for most of its time."""
        return Counter(self.kinds).most_common(1)[0][0]


def tracks(
    mesh: TriangleMesh,
    found: Sequence[CriticalPoints],
    times: FloatArray,
    min_intervals: int = 3,
) -> list[Track]:
    """Link the critical points of fields at times (T,): those of one index that are closest to each
    other together, none farther than six edges; one field may miss a point.

    Returns those that were seen in so many fields at ``min_intervals``, the longest ones first.
    """
    if not is_integer(min_intervals, 1, 1_000_000_000):
        raise ParameterError(
            f"min_intervals is {brief(min_intervals)}; expected an integer of at least 1"
        )
    going: list[list[tuple[int, int]]] = []  # of (field, point), those that may go on
    ended: list[list[tuple[int, int]]] = []
    for step, points in enumerate(found):
        taken = set[int]()
        for index in (1, -1):
            old = [t for t in going if np.sign(found[t[-1][0]].index[t[-1][1]]) == index]
            new = np.flatnonzero(np.sign(points.index) == index)
            last = [(found[t[-1][0]], t[-1][1]) for t in old]
            for row, column in _linked(mesh, last, points, new):
                old[row].append((step, column))
                taken.add(column)
        ended += [t for t in going if step - t[-1][0] > _MISSED_FIELDS_MAX]
        going = [t for t in going if step - t[-1][0] <= _MISSED_FIELDS_MAX]
        going += [[(step, i)] for i in range(len(points)) if i not in taken]
    chosen = [t for t in ended + going if len(t) >= min_intervals]
    chosen.sort(key=lambda t: (-len(t), t[0]))
    return [_track(mesh, found, times, t) for t in chosen]


def _track(
    mesh: TriangleMesh,
    found: Sequence[CriticalPoints],
    times: FloatArray,
    seen: list[tuple[int, int]],
) -> Track:
    faces = np.array([found[step].points.faces[i] for step, i in seen])
    weights = np.array([found[step].points.barycentric[i] for step, i in seen])
    kinds = tuple(found[step].kinds[i] for step, i in seen)
    first, i = seen[0]
    index = int(np.sign(found[first].index[i]))
    when = times[[step for step, _ in seen]]
    return Track(when, SurfacePoints(mesh, faces, weights), kinds, index)


def _linked(
    mesh: TriangleMesh,
    old: list[tuple[CriticalPoints, int]],
    points: CriticalPoints,
    new: IntArray,
) -> list[tuple[int, int]]:
    """Return which old point goes on as which new one."""
    if not old or not len(new):
        return []
    # late, as all that films are is loaded with this file
    from scipy.optimize import linear_sum_assignment

    graph = edge_graph(mesh)
    begins = np.array([each.points.nearest_vertices()[i] for each, i in old])
    ends = points.points.nearest_vertices()[new]
    limit = _DISTANCE_MAX * float(edge_lengths(mesh).mean())
    parts = np.array_split(begins, -(-len(begins) // _POINTS_AT_ONCE))
    apart = np.concatenate(
        [dijkstra(graph, directed=False, indices=p, limit=limit)[:, ends] for p in parts]
    )
    places = np.array([each.points.positions[i] for each, i in old])
    straight = np.linalg.norm(places[:, None] - points.points.positions[new][None], axis=2)
    near = np.isfinite(apart)
    # those too far apart cost more than leaving all others alone
    cost = np.where(near, straight, limit * (len(old) + len(new)))
    rows, columns = linear_sum_assignment(cost)
    return [(int(r), int(new[c])) for r, c in zip(rows, columns, strict=True) if near[r, c]]
