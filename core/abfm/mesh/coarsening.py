"""A coarser mesh of the same surface, with even triangles: edges collapse to their midpoints.

What has a boundary is closed by faces to a vertex at infinity. Faces hang together by `twins`: the
slot (see `topology`) on the other side of the edge opposite each corner. An edge collapses only
where its ends have no common neighbours but the two corners opposite to it, so that the topology
stays. Edges with an infinite key never do.

``igl.decimate`` gives other meshes where lengths are equal, takes twice as long, and keeps the GIL
all the time: a window would stand still.
"""

from typing import NamedTuple

import numpy as np

from abfm.errors import MeshError
from abfm.mesh.topology import next_corner
from abfm.mesh.triangle_mesh import TriangleMesh, per_mesh
from abfm.numerics.kernels import kernel, unfused_kernel
from abfm.types import FloatArray, IndexArray, IntArray

_INDEX_TYPE = np.int32  # enough for slots of 700 million faces
# a mesh that refuses to shrink to this times what was asked is no coarser mesh
_VERTICES_RATIO_MAX = 1.25


@per_mesh
def coarsened(mesh: TriangleMesh, vertex_count: int) -> TriangleMesh | None:
    """Return a mesh of about ``vertex_count`` vertices near the surface; None if there is none.

    Edges collapse in the order of their lengths, so that what comes out is far more even than what
    went in: needles are the first to go. Topology stays. Made once per mesh and count.
    """
    count = len(mesh.vertices)
    boundary = int(mesh.is_boundary_edge.sum() * vertex_count / count)
    face_count = 2 * (vertex_count - mesh.euler_characteristic) - boundary
    if vertex_count >= count or face_count < 4:
        return None
    points = np.concatenate([mesh.vertices, np.zeros((1, 3))])  # and one at infinity
    faces, twins, edges = (array.astype(_INDEX_TYPE) for array in _closed(mesh))
    lengths = ((mesh.vertices[mesh.edges[:, 0]] - mesh.vertices[mesh.edges[:, 1]]) ** 2).sum(axis=1)
    fixed = np.append(mesh.is_pinched_vertex, True)  # these stay, with all their edges
    keys = np.full(edges.max() + 1, np.inf)
    keys[: len(lengths)] = np.where(fixed[mesh.edges].any(axis=1), np.inf, lengths)
    order = np.argsort(keys, kind="stable").astype(_INDEX_TYPE)
    surface = _Surface(points, faces, twins, edges, fixed)
    _collapse_edges(surface, order, keys, len(mesh.faces), face_count)
    left = faces[: mesh.faces.size].reshape(-1, 3)
    left = left[left[:, 0] >= 0]
    used = np.zeros(count, dtype=bool)
    used[left] = True
    try:
        coarse = TriangleMesh(points[:count][used], (np.cumsum(used) - 1)[left])
    except MeshError:
        return None
    return coarse if len(coarse.vertices) <= _VERTICES_RATIO_MAX * vertex_count else None


def _closed(mesh: TriangleMesh) -> tuple[IntArray, IntArray, IntArray]:
    """Return vertex, other slot and edge of every slot (3 F,), with the faces to infinity."""
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
    # around the boundary: the face after one that ends at a fan begins there
    fans = mesh.corner_fans.ravel()
    before, after = np.argsort(fans[ends], kind="stable"), np.argsort(fans[start], kind="stable")
    twins[new[before] + 2], twins[new[after] + 1] = new[after] + 1, new[before] + 2
    edges = np.empty_like(twins)
    edges[:size] = mesh.face_edges.ravel()
    edges[new] = edges[outer]
    edges[new[before] + 2] = edges[new[after] + 1] = len(mesh.edges) + np.arange(len(outer))
    return np.concatenate([corners, faces.T.ravel()]), twins, edges


class _Surface(NamedTuple):
    points: FloatArray  # of the vertices, (V, 3)
    # by slots (3 F,): the vertex of each corner, -1 in faces that are gone, the other slot and the
    # number of each edge
    faces: IndexArray
    twins: IndexArray
    edges: IndexArray
    fixed: IndexArray  # (V,) whether edges at a vertex do not collapse


class _Places(NamedTuple):
    slot_of: IndexArray  # of every edge, (E,)
    corner_of: IndexArray  # at every vertex, (V,)


class _Queue(NamedTuple):
    heap: IndexArray  # of edges, (E,)
    place: IndexArray  # of each edge in it
    keys: FloatArray  # squared lengths of edges, or infinite


@kernel
def _collapse_edges(
    surface: _Surface, order: IndexArray, keys: FloatArray, finite: int, wanted: int
) -> None:
    """Collapse until at most ``wanted`` of the first ``finite`` faces are left.

    ``order`` (E,) are the edges with ascending ``keys``; the surface and the keys are overwritten.
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
    left, total, attempt = finite, faces.size // 3, 0
    while left > wanted and total > 4 and keys[queue.heap[0]] < np.inf:
        edge = queue.heap[0]
        slot = places.slot_of[edge]
        _rekey(queue, edge, np.inf)
        attempt += 1
        if not _is_free(surface, slot, star, seen, attempt):
            continue
        for side in (slot, twins[slot]):
            left -= side < 3 * finite
        total -= 2
        u = _collapse(surface, places, queue, slot, star)
        for corner in star[: fill_star(star, twins, places.corner_of[u])]:
            spoke, rim = next_slot(corner), edges[corner]
            _rekey(queue, edges[spoke], _squared_length(surface, u, faces[next_slot(spoke)]))
            if keys[rim] == np.inf:  # refused before
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
    """Put the corners around the vertex of the first into ``star``; return how many they are."""
    # a generator would read better, but numba cannot compile what calls one from its cache
    count, corner = 0, first
    while count == 0 or corner != first:
        star[count] = corner
        count += 1
        corner = next_slot(twins[next_slot(corner)])
    return count


@kernel
def _is_free(surface: _Surface, slot: int, star: IndexArray, seen: IndexArray, mark: int) -> bool:
    """Return whether the ends of an edge have two common neighbours only."""
    faces, twins = surface.faces, surface.twins
    for corner in star[: fill_star(star, twins, next_slot(slot))]:
        seen[faces[next_slot(corner)]] = mark
    common = 0
    for corner in star[: fill_star(star, twins, next_slot(next_slot(slot)))]:
        common += seen[faces[next_slot(corner)]] == mark
    return common == 2


@kernel
def _collapse(
    surface: _Surface, places: _Places, queue: _Queue, slot: int, star: IndexArray
) -> int:
    """Move one end of an edge to its middle, give it the other's faces, and return it."""
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
        gone, kept = edges[p], edges[q]
        _rekey(queue, gone, np.inf)
        edges[p] = kept
        places.slot_of[kept] = q
        places.corner_of[faces[side]] = next_slot(p)
        places.corner_of[u] = next_slot(next_slot(p))
        for k in range(3):
            faces[side - side % 3 + k] = -1
    return u


@kernel
def _rekey(queue: _Queue, edge: int, key: float) -> None:
    """Give an edge another key and put it where it belongs in the heap."""
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
