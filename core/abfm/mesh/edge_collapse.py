"""Edges of a surface collapse to their midpoints, shortest first.

The surface has no boundary here: what has one is closed by faces to a vertex at infinity. Faces hang together by
`twins`: the slot on the other side of the edge opposite each corner, a *slot* being the flat index ``3 f + k``. An
edge collapses only where its ends have no common neighbours but the two corners opposite to it, so that the topology
stays. Edges with an infinite key never do.

``igl.decimate`` gives other meshes where lengths are equal, takes twice as long, and keeps the GIL all the time: a
window would stand still.
"""

import numpy as np

from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray


@kernel
def collapse_edges(
    points: FloatArray,
    faces: IndexArray,
    twins: IndexArray,
    edges: IndexArray,
    fixed: IndexArray,
    order: IndexArray,
    keys: FloatArray,
    finite: int,
    wanted: int,
) -> int:
    """Collapse until at most ``wanted`` of the first ``finite`` faces are left; how many are.

    Parameters
    ----------
    points : (V, 3) array
        Moved.
    faces, twins, edges : (3 F,) arrays
        Vertex of each corner, the other slot of each edge, and its number. Faces that are gone are all ``-1``.
    fixed : (V,) array of bool
        Vertices whose edges do not collapse.
    order : (E,) array
        Edges with ascending ``keys``.
    keys : (E,) array
        Squared lengths, infinite where an edge must not collapse.
    """
    heap, place = order.copy(), np.empty_like(order)
    for i in range(heap.size):
        place[heap[i]] = i
    slot_of, corner_of = np.empty_like(order), np.empty(fixed.size, dtype=order.dtype)
    for slot in range(faces.size):
        slot_of[edges[slot]] = slot
        corner_of[faces[slot]] = slot
    seen, star = np.zeros(fixed.size, dtype=np.int64), np.empty_like(faces)
    left, total, attempt = finite, faces.size // 3, 0
    while left > wanted and total > 4 and keys[heap[0]] < np.inf:
        edge = heap[0]
        slot = slot_of[edge]
        _rekey(heap, place, keys, edge, np.inf)
        attempt += 1
        if not _is_free(faces, twins, slot, star, seen, attempt):
            continue
        for side in (slot, twins[slot]):
            left -= side < 3 * finite
        total -= 2
        u = _collapse(points, faces, twins, edges, slot_of, corner_of, heap, place, keys, slot, star)
        for corner in star[: _fill(star, twins, corner_of[u])]:
            spoke, rim = _next(corner), edges[corner]
            _rekey(heap, place, keys, edges[spoke], _squared_length(points, fixed, u, faces[_next(spoke)]))
            if keys[rim] == np.inf:  # refused before
                _rekey(heap, place, keys, rim, _squared_length(points, fixed, faces[spoke], faces[_next(spoke)]))
    return left


@kernel
def _squared_length(points: FloatArray, fixed: IndexArray, a: int, b: int) -> float:
    if fixed[a] or fixed[b]:
        return np.inf
    length = 0.0
    for x in range(3):
        length += (points[a, x] - points[b, x]) ** 2
    return length


@kernel
def _next(slot: int) -> int:
    """The following corner of the same face."""
    return slot - 2 if slot % 3 == 2 else slot + 1


@kernel
def _fill(star: IndexArray, twins: IndexArray, first: int) -> int:
    """Put the corners at the vertex of the first, face by face around it, into ``star``; how many they are.

    (A generator would read better, but numba cannot compile what calls one that it has kept on disk.)
    """
    count, corner = 0, first
    while count == 0 or corner != first:
        star[count] = corner
        count += 1
        corner = _next(twins[_next(corner)])
    return count


@kernel
def _is_free(faces: IndexArray, twins: IndexArray, slot: int, star: IndexArray, seen: IndexArray, mark: int) -> bool:
    """Whether the ends of an edge have two common neighbours only; those of one end are marked as ``seen``."""
    for corner in star[: _fill(star, twins, _next(slot))]:
        seen[faces[_next(corner)]] = mark
    common = 0
    for corner in star[: _fill(star, twins, _next(_next(slot)))]:
        common += seen[faces[_next(corner)]] == mark
    return common == 2


@kernel
def _collapse(
    points: FloatArray,
    faces: IndexArray,
    twins: IndexArray,
    edges: IndexArray,
    slot_of: IndexArray,
    corner_of: IndexArray,
    heap: IndexArray,
    place: IndexArray,
    keys: FloatArray,
    slot: int,
    star: IndexArray,
) -> int:
    """Move one end of an edge to its middle, give it the faces of the other end, and take out the two between."""
    u: int = faces[_next(slot)]
    v = faces[_next(_next(slot))]
    for x in range(3):
        points[u, x] = 0.5 * (points[u, x] + points[v, x])
    for corner in star[: _fill(star, twins, _next(_next(slot)))]:
        faces[corner] = u
    for side in (slot, twins[slot]):
        p, q = twins[_next(side)], twins[_next(_next(side))]
        twins[p], twins[q] = q, p
        gone, kept = edges[p], edges[q]
        _rekey(heap, place, keys, gone, np.inf)
        edges[p] = kept
        slot_of[kept] = q
        corner_of[faces[side]] = _next(p)
        corner_of[u] = _next(_next(p))
        for k in range(3):
            faces[side - side % 3 + k] = -1
    return u


@kernel
def _rekey(heap: IndexArray, place: IndexArray, keys: FloatArray, edge: int, key: float) -> None:
    """Give an edge another key and put it where it belongs in the heap."""
    before = keys[edge]
    keys[edge] = key
    i = place[edge]
    if key < before:
        while i > 0:
            above = (i - 1) // 2
            if keys[heap[above]] <= key:
                break
            heap[i] = heap[above]
            place[heap[i]] = i
            i = above
    elif key > before:
        while 2 * i + 1 < heap.size:
            below = 2 * i + 1
            if below + 1 < heap.size and keys[heap[below + 1]] < keys[heap[below]]:
                below += 1
            if keys[heap[below]] >= key:
                break
            heap[i] = heap[below]
            place[heap[i]] = i
            i = below
    heap[i] = edge
    place[edge] = i
