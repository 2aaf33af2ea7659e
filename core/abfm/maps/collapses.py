"""A closed surface of genus 0 collapsed to a tetrahedron, vertex by vertex, and unfolded again.

Faces hang together by `twins`: the slot (see `abfm.mesh.topology`) on the other side of the edge
opposite each corner. A vertex goes by collapsing an edge to its other end, only where the ends have
no common neighbours but the two corners opposite to it, so that the topology stays. Faces that are
gone keep their slots, which is all that it takes to put them back.
"""

from typing import NamedTuple

import numpy as np

from abfm.mesh.coarsening import fill_star, next_slot
from abfm.numerics.kernels import unfused_kernel
from abfm.types import FloatArray, IndexArray, IntArray
from abfm.workers.control import checkpoint

_SHARE = 0.25  # of the vertices, that go in a round at most
_DEGREE_MAX = 7  # neighbours; more make an edge worse to collapse


class Surface(NamedTuple):
    """Faces by slots, (3 F,): the vertex of each corner and the slot across the edge opposite it;
    and a corner at every vertex, (V,).
    """

    faces: IntArray
    twins: IntArray
    corner_of: IntArray


class Collapses(NamedTuple):
    """Vertices that went, in this order, (V - 4,); the slots opposite the edges that collapsed; and
    how many had gone before each round, and in the end.
    """

    vertices: IntArray
    slots: IntArray
    rounds: list[int]


def collapse(points: FloatArray, surface: Surface) -> Collapses:
    """Collapse a closed surface (V, 3) of genus 0, which is overwritten, to four vertices: in
    rounds, in each the cheapest vertices that are no neighbours.
    """
    count = len(points)
    gone = np.empty((2, count - 4), dtype=np.int64)
    alive, rounds = np.arange(count), [0]
    while rounds[-1] < count - 4:
        checkpoint()
        rounds.append(_collapse_round(points, surface, alive, gone, rounds[-1]))
        alive = np.setdiff1d(alive, gone[0, rounds[-2] : rounds[-1]])
    return Collapses(gone[0], gone[1], rounds)


@unfused_kernel
def unfold(surface: Surface, vertex: int, slot: int, star: IndexArray) -> int:
    """Put back the vertex that went last, at the slot opposite its edge; return the number of its
    corners, which are put into ``star``.
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
    """Collapse an edge to its first end, as it is seen from the slot opposite to it."""
    faces, twins, corner_of = surface
    kept = faces[next_slot(slot)]
    for corner in star[: fill_star(star, twins, next_slot(next_slot(slot)))]:
        faces[corner] = kept
    for side in (slot, twins[slot]):
        p, q = twins[next_slot(side)], twins[next_slot(next_slot(side))]
        twins[p], twins[q] = q, p
        corner_of[faces[side]] = next_slot(p)
        corner_of[kept] = next_slot(next_slot(p))


class _Workspace(NamedTuple):
    """Workspace for what is around a vertex."""

    star: IntArray  # corners there
    seen: IntArray  # when each vertex was seen last, and at the end the time


@unfused_kernel
def _is_free(surface: Surface, slot: int, workspace: _Workspace) -> bool:
    """Return whether the ends of an edge have two common neighbours only."""
    (faces, twins, _), (star, seen) = surface, workspace
    seen[-1] += 1
    for corner in star[: fill_star(star, twins, next_slot(slot))]:
        seen[faces[next_slot(corner)]] = seen[-1]
    common = 0
    for corner in star[: fill_star(star, twins, next_slot(next_slot(slot)))]:
        common += seen[faces[next_slot(corner)]] == seen[-1]
    return common == 2


@unfused_kernel
def _cheapest(
    points: FloatArray, surface: Surface, ring: IntArray, degrees: IntArray, workspace: _Workspace
) -> tuple[float, int]:
    """Return what the cheapest collapse of the vertex of some corners costs, and its slot: the
    square of the longest edge that it makes, times the number of edges where these are many.
    """
    faces, twins, _ = surface
    least, best = np.inf, 0
    for corner in ring:
        kept = faces[next_slot(corner)]
        cost = 0.0
        for other in ring:
            length = 0.0
            for x in range(3):
                length += (points[faces[next_slot(other)], x] - points[kept, x]) ** 2
            cost = max(cost, length)
        cost *= max(degrees[kept] + ring.size - 4, _DEGREE_MAX)
        slot = twins[next_slot(next_slot(corner))]
        if cost < least and _is_free(surface, slot, workspace):
            least, best = cost, slot
    return least, best


@unfused_kernel
def _collapse_round(
    points: FloatArray, surface: Surface, alive: IntArray, gone: IntArray, done: int
) -> int:
    """Collapse the cheapest of the vertices that are left, no two of them neighbours, when some
    have gone; return how many have then.
    """
    faces, twins, corner_of = surface
    count = corner_of.size
    workspace = _Workspace(np.empty(count, dtype=np.int64), np.zeros(count + 1, dtype=np.int64))
    ring, degrees = np.empty_like(workspace.star), np.empty_like(workspace.star)
    touched = np.zeros(count, dtype=np.bool_)
    costs, best = np.empty(alive.size), np.empty_like(alive)
    for v in alive:
        degrees[v] = fill_star(ring, twins, corner_of[v])
    for i in range(alive.size):
        size = fill_star(ring, twins, corner_of[alive[i]])
        costs[i], best[i] = _cheapest(points, surface, ring[:size], degrees, workspace)
    most = min(done + max(int(_SHARE * alive.size), 1), gone.shape[1])
    for i in np.argsort(costs, kind="mergesort"):
        v, slot = alive[i], best[i]
        if done == most or costs[i] == np.inf:
            break
        if touched[v] or not _is_free(surface, slot, workspace):
            continue
        for corner in ring[: fill_star(ring, twins, corner_of[v])]:
            touched[faces[next_slot(corner)]] = True
        gone[0, done], gone[1, done] = v, slot
        _fold(surface, slot, ring)
        done += 1
    return done
