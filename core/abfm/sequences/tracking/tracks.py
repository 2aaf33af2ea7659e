"""Tracks of critical points through time."""

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

_DISTANCE_MAX = 6.0  # largest distance along edges between consecutive fields, in mean edge lengths
_POINTS_AT_ONCE = 64  # points whose distances to all vertices are in memory
_MISSED_FIELDS_MAX = 1  # consecutive fields in which a point may be missing


@dataclass(frozen=True, eq=False)
class Track:
    """A critical point through time.

    Attributes
    ----------
    times : (N,) array
        Middles of the intervals in which the point was found.
    points : SurfacePoints
        Positions of the critical point at these times, (N,).
    kinds : tuple of str
        Kinds of the critical point at these times; a source may become a spiral.
    index : int
        Index of the critical point, 1 or -1, which is constant in time.
    """

    times: FloatArray
    points: SurfacePoints
    kinds: tuple[PointKind, ...]
    index: int

    def __len__(self) -> int:
        return len(self.kinds)

    @property
    def kind(self) -> PointKind:
        """The most frequent kind."""
        return Counter(self.kinds).most_common(1)[0][0]


def tracks(
    mesh: TriangleMesh, found: Sequence[CriticalPoints], times: FloatArray, min_intervals: int = 3
) -> list[Track]:
    """Link the critical points of fields at times (T,) to tracks.

    Points of consecutive fields with the same index are paired so that the sum of distances is
    smallest. No distance exceeds six edges, and a track may miss one field. Return the tracks
    through at least ``min_intervals`` fields, the longest first.
    """
    if not is_integer(min_intervals, 1, 1_000_000_000):
        raise ParameterError(
            f"min_intervals is {brief(min_intervals)}; expected an integer of at least 1"
        )
    active: list[list[tuple[int, int]]] = []  # tracks that may continue, as (field, point)
    ended: list[list[tuple[int, int]]] = []
    for step, points in enumerate(found):
        taken = set[int]()
        for index in (1, -1):
            old = [t for t in active if np.sign(found[t[-1][0]].index[t[-1][1]]) == index]
            new = np.flatnonzero(np.sign(points.index) == index)
            last = [(found[t[-1][0]], t[-1][1]) for t in old]
            for row, column in _linked(mesh, last, points, new):
                old[row].append((step, column))
                taken.add(column)
        ended += [t for t in active if step - t[-1][0] > _MISSED_FIELDS_MAX]
        active = [t for t in active if step - t[-1][0] <= _MISSED_FIELDS_MAX]
        active += [[(step, i)] for i in range(len(points)) if i not in taken]
    chosen = [t for t in ended + active if len(t) >= min_intervals]
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
    mesh: TriangleMesh, old: list[tuple[CriticalPoints, int]], points: CriticalPoints, new: IntArray
) -> list[tuple[int, int]]:
    """Pair the last points of tracks, ``old``, with new points; return pairs of indices.

    ``new`` are the indices of the ``points`` to be assigned.
    """
    if not old or not len(new):
        return []
    # imported late, since this module is loaded with all modules of sequences
    from scipy.optimize import linear_sum_assignment

    graph = edge_graph(mesh)
    begins = np.array([each.points.nearest_vertices()[i] for each, i in old])
    ends = points.points.nearest_vertices()[new]
    limit = _DISTANCE_MAX * float(edge_lengths(mesh).mean())
    parts = np.array_split(begins, -(-len(begins) // _POINTS_AT_ONCE))
    distances = np.concatenate(
        [dijkstra(graph, directed=False, indices=p, limit=limit)[:, ends] for p in parts]
    )
    places = np.array([each.points.positions[i] for each, i in old])
    straight = np.linalg.norm(places[:, None] - points.points.positions[new][None], axis=2)
    near = np.isfinite(distances)
    # a pair beyond the limit costs more than all allowed pairs together
    cost = np.where(near, straight, limit * (len(old) + len(new)))
    rows, columns = linear_sum_assignment(cost)
    return [(int(r), int(new[c])) for r, c in zip(rows, columns, strict=True) if near[r, c]]
