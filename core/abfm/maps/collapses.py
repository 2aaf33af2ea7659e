"""Collapse of a closed surface of genus 0 to a tetrahedron, vertex by vertex, and its reversal.

A slot is a corner of a face (see `abfm.mesh.topology`). ``twins`` has, for each slot, the slot on
the other side of the edge opposite the corner. A vertex is removed by collapsing an edge to its
other end. This preserves the topology if the ends have no common neighbours except the two corners
opposite the edge. Removed faces keep their slots, which is sufficient to insert them again.
"""

from typing import NamedTuple

import numpy as np

from abfm.mesh.coarsening import fill_star, next_slot
from abfm.numerics.kernels import unfused_kernel
from abfm.types import FloatArray, IndexArray, IntArray
from abfm.workers.control import checkpoint

_ROUND_SHARE_MAX = 0.25  # largest share of the vertices that one round removes
_DEGREE_MAX = 7  # more neighbours increase the cost of a collapse


class Surface(NamedTuple):
    """The connectivity of a closed surface."""

    faces: IntArray  # (3 F,), the vertex of each corner
    twins: IntArray  # (3 F,), the slot across the edge opposite each corner
    corner_of: IntArray  # (V,), a corner at every vertex


class Collapses(NamedTuple):
    """The edge collapses that reduce a surface to a tetrahedron, in their order."""

    vertices: IntArray  # (V - 4,), removed vertices
    slots: IntArray  # (V - 4,), slots opposite the collapsed edges
    rounds: list[int]  # counts of removed vertices before each round, and at the end


def collapse(points: FloatArray, surface: Surface) -> Collapses:
    """Collapse a closed surface of genus 0 with vertices (V, 3) to four; return the collapses.

    ``surface`` is overwritten. Each round removes the cheapest vertices, no two of which are
    neighbours.
    """
    count = len(points)
    removed = np.empty((2, count - 4), dtype=np.int64)
    active, rounds = np.arange(count), [0]
    while rounds[-1] < count - 4:
        checkpoint()
        rounds.append(_collapse_round(points, surface, active, removed, rounds[-1]))
        active = np.setdiff1d(active, removed[0, rounds[-2] : rounds[-1]])
    return Collapses(removed[0], removed[1], rounds)


@unfused_kernel
def unfold(surface: Surface, vertex: int, slot: int, star: IndexArray) -> int:
    """Reverse the last collapse, which removed ``vertex``; ``slot`` is opposite the collapsed edge.

    Write the corners at the vertex to ``star``, and return their count.
    """
    faces, twins, corner_of = surface
    for side in (slot, twins[slot]):
        after = next_slot(side)
        before = next_slot(after)
        twins[twins[after]], twins[twins[before]] = after, before
    corner_of[vertex] = next_slot(next_slot(slot))
    corner_of[faces[next_slot(slot)]] = next_slot(slot)
    count = fill_star(star, twins, corner_of[vertex])
    for corner in star[:count]:
        faces[corner] = vertex
    return count


@unfused_kernel
def _fold(surface: Surface, slot: int, star: IndexArray) -> None:
    """Collapse the edge opposite the corner ``slot`` into the edge's first end."""
    faces, twins, corner_of = surface
    end = faces[next_slot(slot)]
    for corner in star[: fill_star(star, twins, next_slot(next_slot(slot)))]:
        faces[corner] = end
    for side in (slot, twins[slot]):
        p, q = twins[next_slot(side)], twins[next_slot(next_slot(side))]
        twins[p], twins[q] = q, p
        corner_of[faces[side]] = next_slot(p)
        corner_of[end] = next_slot(next_slot(p))


class _Workspace(NamedTuple):
    """Temporary arrays for the neighbours of a vertex."""

    star: IntArray  # corners at the vertex
    visits: IntArray  # (V + 1,), last visit to each vertex, and the count of all visits


@unfused_kernel
def _is_free(surface: Surface, slot: int, workspace: _Workspace) -> bool:
    """Return whether the ends of the edge opposite ``slot`` have only two common neighbours."""
    (faces, twins, _), (star, visits) = surface, workspace
    visits[-1] += 1
    for corner in star[: fill_star(star, twins, next_slot(slot))]:
        visits[faces[next_slot(corner)]] = visits[-1]
    common = 0
    for corner in star[: fill_star(star, twins, next_slot(next_slot(slot)))]:
        common += visits[faces[next_slot(corner)]] == visits[-1]
    return common == 2


@unfused_kernel
def _cheapest(
    points: FloatArray, surface: Surface, ring: IntArray, degrees: IntArray, workspace: _Workspace
) -> tuple[float, int]:
    """Return the cost of the cheapest collapse of a vertex, and the slot opposite the edge.

    ``ring`` has the corners at the vertex. The cost is the square of the longest new edge, times
    the number of edges of the merged vertex, but at least times 7. It is infinite if no edge may be
    collapsed.
    """
    faces, twins, _ = surface
    least, best = np.inf, 0
    for corner in ring:
        end = faces[next_slot(corner)]
        cost = 0.0
        for other in ring:
            length = 0.0
            for x in range(3):
                length += (points[faces[next_slot(other)], x] - points[end, x]) ** 2
            cost = max(cost, length)
        cost *= max(degrees[end] + ring.size - 4, _DEGREE_MAX)
        slot = twins[next_slot(next_slot(corner))]
        if cost < least and _is_free(surface, slot, workspace):
            least, best = cost, slot
    return least, best


@unfused_kernel
def _collapse_round(
    points: FloatArray, surface: Surface, active: IntArray, removed: IntArray, done: int
) -> int:
    """Remove the cheapest active vertices, no two of which are neighbours.

    Append them and the slots opposite the collapsed edges to ``removed``, which has ``done``
    columns so far. Return the new count of removed vertices.
    """
    faces, twins, corner_of = surface
    count = corner_of.size
    workspace = _Workspace(np.empty(count, dtype=np.int64), np.zeros(count + 1, dtype=np.int64))
    ring, degrees = np.empty_like(workspace.star), np.empty_like(workspace.star)
    touched = np.zeros(count, dtype=np.bool_)
    costs, best = np.empty(active.size), np.empty_like(active)
    for v in active:
        degrees[v] = fill_star(ring, twins, corner_of[v])
    for i in range(active.size):
        size = fill_star(ring, twins, corner_of[active[i]])
        costs[i], best[i] = _cheapest(points, surface, ring[:size], degrees, workspace)
    most = min(done + max(int(_ROUND_SHARE_MAX * active.size), 1), removed.shape[1])
    for i in np.argsort(costs, kind="mergesort"):
        v, slot = active[i], best[i]
        if done == most or costs[i] == np.inf:
            break
        if touched[v] or not _is_free(surface, slot, workspace):
            continue
        for corner in ring[: fill_star(ring, twins, corner_of[v])]:
            touched[faces[next_slot(corner)]] = True
        removed[0, done], removed[1, done] = v, slot
        _fold(surface, slot, ring)
        done += 1
    return done
