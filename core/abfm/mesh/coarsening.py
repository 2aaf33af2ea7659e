"""Coarsening: edges collapse to their midpoints until a mesh has few, even triangles.

A surface with a boundary is closed by faces to a vertex at infinity. `twins` connects the faces: it
is the slot (see `topology`) on the other side of the edge opposite each corner. An edge may
collapse only if the two corners opposite to it are the only common neighbours of its ends. This
preserves the topology. The key of an edge is its squared length, or infinite if it must not
collapse.

``igl.decimate`` depends on the order of edges of equal length and takes twice as long. It also
holds the GIL all the time, so that a window would freeze.
"""

from typing import NamedTuple

import numpy as np

from abfm.errors import MeshError
from abfm.mesh.topology import next_corner
from abfm.mesh.triangle_mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel, unfused_kernel
from abfm.types import FloatArray, IndexArray, IntArray

_INDEX_TYPE = np.int32  # enough for the slots of 700 million faces
# a result with more vertices, relative to the requested number, is not accepted
_VERTICES_RATIO_MAX = 1.25


@per_mesh
def coarsened(mesh: TriangleMesh, vertex_count: int) -> TriangleMesh | None:
    """Return a mesh of about ``vertex_count`` vertices near the surface, or None if impossible.

    The shortest edge collapses first, so that slivers disappear early. The triangles of the result
    are therefore much more even than those of the input. The topology is preserved. The result is
    cached for each mesh and count.
    """
    count = len(mesh.vertices)
    boundary = int(mesh.is_boundary_edge.sum() * vertex_count / count)
    face_count = 2 * (vertex_count - mesh.euler_characteristic) - boundary
    if vertex_count >= count or face_count < 4:
        return None
    points = np.concatenate([mesh.vertices, np.zeros((1, 3))])  # the last point is at infinity
    faces, twins, edges = (array.astype(_INDEX_TYPE) for array in _closed(mesh))
    lengths = ((mesh.vertices[mesh.edges[:, 0]] - mesh.vertices[mesh.edges[:, 1]]) ** 2).sum(axis=1)
    fixed = np.append(mesh.is_pinched_vertex, True)  # edges at these vertices do not collapse
    keys = np.full(edges.max() + 1, np.inf)
    keys[: len(lengths)] = np.where(fixed[mesh.edges].any(axis=1), np.inf, lengths)
    order = np.argsort(keys, kind="stable").astype(_INDEX_TYPE)
    surface = _Surface(points, faces, twins, edges, fixed)
    _collapse_edges(surface, order, keys, len(mesh.faces), face_count)
    remaining = faces[: mesh.faces.size].reshape(-1, 3)
    remaining = remaining[remaining[:, 0] >= 0]
    used = np.zeros(count, dtype=bool)
    used[remaining] = True
    try:
        coarse = TriangleMesh(points[:count][used], (np.cumsum(used) - 1)[remaining])
    except MeshError:
        return None
    return coarse if len(coarse.vertices) <= _VERTICES_RATIO_MAX * vertex_count else None


def _closed(mesh: TriangleMesh) -> tuple[IntArray, IntArray, IntArray]:
    """Return the vertex, the twin and the edge of every slot (corner of a face), (3 F',) each.

    The F' faces include those between boundary edges and the vertex at infinity.
    """
    inner = mesh.edge_slots[~mesh.is_boundary_edge]
    outer = mesh.edge_slots[mesh.is_boundary_edge, 0]
    corners, size = mesh.faces.ravel(), mesh.faces.size
    new = size + 3 * np.arange(len(outer))
    start = next_corner(outer)
    ends = next_corner(start)
    faces = np.stack([np.full(len(outer), len(mesh.vertices)), corners[ends], corners[start]])
    twins = np.empty(size + 3 * len(outer), dtype=np.int64)
    twins[inner] = inner[:, ::-1]
    twins[new], twins[outer] = outer, new
    # on the boundary, the face whose edge ends at a fan precedes the one whose edge begins there
    fans = mesh.corner_fans.ravel()
    before, after = np.argsort(fans[ends], kind="stable"), np.argsort(fans[start], kind="stable")
    twins[new[before] + 2], twins[new[after] + 1] = new[after] + 1, new[before] + 2
    edges = np.empty_like(twins)
    edges[:size] = mesh.face_edges.ravel()
    edges[new] = edges[outer]
    edges[new[before] + 2] = edges[new[after] + 1] = len(mesh.edges) + np.arange(len(outer))
    return np.concatenate([corners, faces.T.ravel()]), twins, edges


class _Surface(NamedTuple):
    points: FloatArray  # (V, 3) positions of the vertices
    # of all slots, (3 F,)
    faces: IndexArray  # vertex of each corner; -1 in removed faces
    twins: IndexArray  # slot on the other side of each edge
    edges: IndexArray  # edge of each slot
    fixed: IndexArray  # (V,) whether the edges at a vertex must not collapse


class _Places(NamedTuple):
    slot_of: IndexArray  # (E,) one slot of each edge
    corner_of: IndexArray  # (V,) one corner at each vertex


class _Queue(NamedTuple):
    heap: IndexArray  # (E,) edges, a binary heap by key
    place: IndexArray  # (E,) place of each edge in the heap
    keys: FloatArray  # (E,) squared length of each edge, or infinite


@kernel
def _collapse_edges(
    surface: _Surface, order: IndexArray, keys: FloatArray, finite: int, target: int
) -> None:
    """Collapse edges until at most ``target`` of the first ``finite`` faces remain.

    The other faces are at infinity. ``order`` (E,) are the edges by ascending ``keys``. The
    surface and the keys are overwritten.
    """
    faces, twins, edges, fixed = surface.faces, surface.twins, surface.edges, surface.fixed
    queue = _Queue(order.copy(), np.empty_like(order), keys)
    for i in range(order.size):
        queue.place[order[i]] = i
    places = _Places(np.empty_like(order), np.empty(fixed.size, dtype=order.dtype))
    for slot in range(faces.size):
        places.slot_of[edges[slot]] = slot
        places.corner_of[faces[slot]] = slot
    seen, star = np.zeros(fixed.size, dtype=np.int64), np.empty_like(faces)
    remaining, total, attempt = finite, faces.size // 3, 0
    while remaining > target and total > 4 and keys[queue.heap[0]] < np.inf:
        edge = queue.heap[0]
        slot = places.slot_of[edge]
        _rekey(queue, edge, np.inf)
        attempt += 1
        if not _may_collapse(surface, slot, star, seen, attempt):
            continue
        for side in (slot, twins[slot]):
            remaining -= side < 3 * finite
        total -= 2
        u = _collapse(surface, places, queue, slot, star)
        for corner in star[: fill_star(star, twins, places.corner_of[u])]:
            spoke, rim = next_slot(corner), edges[corner]
            _rekey(queue, edges[spoke], _squared_length(surface, u, faces[next_slot(spoke)]))
            if keys[rim] == np.inf:  # the edge could not collapse before
                ends = faces[spoke], faces[next_slot(spoke)]
                _rekey(queue, rim, _squared_length(surface, ends[0], ends[1]))


@kernel
def _squared_length(surface: _Surface, a: int, b: int) -> float:
    if surface.fixed[a] or surface.fixed[b]:
        return np.inf
    length = 0.0
    for x in range(3):
        length += (surface.points[a, x] - surface.points[b, x]) ** 2
    return length


@unfused_kernel
def next_slot(slot: int) -> int:
    return slot - 2 if slot % 3 == 2 else slot + 1


@unfused_kernel
def fill_star(star: IndexArray, twins: IndexArray, first: int) -> int:
    """Write the corners at the vertex of the corner ``first`` to ``star``; return their count."""
    # a generator would be more readable, but Numba cannot cache functions that call one
    count, corner = 0, first
    while count == 0 or corner != first:
        star[count] = corner
        count += 1
        corner = next_slot(twins[next_slot(corner)])
    return count


@kernel
def _may_collapse(
    surface: _Surface, slot: int, star: IndexArray, seen: IndexArray, attempt: int
) -> bool:
    """Return whether the ends of the edge of a slot have exactly two common neighbours.

    ``star`` and ``seen`` are work arrays. ``attempt`` is a number that no earlier call used.
    """
    faces, twins = surface.faces, surface.twins
    for corner in star[: fill_star(star, twins, next_slot(slot))]:
        seen[faces[next_slot(corner)]] = attempt
    common = 0
    for corner in star[: fill_star(star, twins, next_slot(next_slot(slot)))]:
        common += seen[faces[next_slot(corner)]] == attempt
    return common == 2


@kernel
def _collapse(
    surface: _Surface, places: _Places, queue: _Queue, slot: int, star: IndexArray
) -> int:
    """Collapse the edge of a slot to its midpoint, and return the end that remains.

    The remaining vertex gets the faces of the removed one.
    """
    points, faces, twins, edges = surface.points, surface.faces, surface.twins, surface.edges
    u: int = faces[next_slot(slot)]
    v = faces[next_slot(next_slot(slot))]
    for x in range(3):
        points[u, x] = 0.5 * (points[u, x] + points[v, x])
    for corner in star[: fill_star(star, twins, next_slot(next_slot(slot)))]:
        faces[corner] = u
    for side in (slot, twins[slot]):
        p, q = twins[next_slot(side)], twins[next_slot(next_slot(side))]
        twins[p], twins[q] = q, p
        removed, remaining = edges[p], edges[q]
        _rekey(queue, removed, np.inf)
        edges[p] = remaining
        places.slot_of[remaining] = q
        places.corner_of[faces[side]] = next_slot(p)
        places.corner_of[u] = next_slot(next_slot(p))
        for k in range(3):
            faces[side - side % 3 + k] = -1
    return u


@kernel
def _rekey(queue: _Queue, edge: int, key: float) -> None:
    """Change the key of an edge, and restore the order of the heap."""
    heap, place, keys = queue.heap, queue.place, queue.keys
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
