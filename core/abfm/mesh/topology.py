"""Connectivity of the faces of a mesh: edges, neighbours, components, fans.

A *slot* is the flat index ``3 f + k`` of corner k of face f. It also denotes the edge opposite to
that corner.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.types import BoolArray, IntArray


def edges_of_faces(faces: IntArray, vertex_count: int) -> tuple[IntArray, IntArray]:
    """Return the sorted edges (E, 2), and the edge opposite each corner of the faces, (F, 3).

    The smaller vertex of an edge is first.
    """
    sides = np.empty((len(faces), 3), dtype=np.int64)
    for corner in range(3):
        start, end = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        sides[:, corner] = np.minimum(start, end) * vertex_count + np.maximum(start, end)
    keys, order = _sorted_with_places(sides.ravel(), vertex_count**2)
    del sides  # for meshes with millions of faces, the array needs much memory
    first = np.append(True, keys[1:] != keys[:-1])
    face_edges = np.empty_like(order)
    face_edges[order] = np.cumsum(first) - 1
    del order
    return np.stack(np.divmod(keys[first], vertex_count), axis=1), face_edges.reshape(-1, 3)


def _sorted_with_places(keys: IntArray, above: int) -> tuple[IntArray, IntArray]:
    """Return keys (from 0 to ``above`` - 1) in ascending order, and their indices before sorting.

    If a key and its index fit in 64 bits, both are sorted as one number, in a fraction of the time
    of ``np.argsort``.
    """
    bits = len(keys).bit_length()
    if above << bits > np.iinfo(np.int64).max:
        order = np.argsort(keys)
        return keys[order], order
    both = keys << bits
    both |= np.arange(len(keys))
    both.sort()
    return both >> bits, both & ((1 << bits) - 1)


def edge_slots(face_edges: IntArray, edge_count: int) -> IntArray:
    """Return the two slots of each edge (corners opposite to it), (E, 2), smaller one first.

    On the boundary the second is -1.
    """
    order = np.argsort(face_edges, axis=None, kind="stable")
    uses = np.bincount(face_edges.ravel(), minlength=edge_count)
    first = np.cumsum(uses) - uses
    last = order[first + uses - 1]
    return np.stack([order[first], np.where(uses == 2, last, -1)], axis=1)


def next_corner(slots: IntArray) -> IntArray:
    """Return the slot of the next corner of the same face, where the edge of each slot starts."""
    return slots - slots % 3 + (slots + 1) % 3


def connected(count: int, pairs: IntArray) -> IntArray:
    """Return the component of each of ``count`` nodes, where ``pairs`` (n, 2) connect nodes.

    Components are numbered in order of first appearance. This is as fast as SciPy's function, whose
    import takes longer than reading and drawing a mesh.
    """
    nodes = np.arange(count)
    root = nodes
    # pairs of roots: each root joins a smaller neighbour if it has one, so few rounds are needed
    while len(pairs):
        root = root.copy()
        np.minimum.at(root, np.maximum(*pairs.T), np.minimum(*pairs.T))
        while not np.array_equal(root, above := root[root]):
            root = above
        pairs = root[pairs]
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return np.asarray((np.cumsum(root == nodes) - 1)[root])


def equal_rows(rows: NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Return the first row of each group of equal rows (n, k), and the group of each row, (n,).

    The first rows are given by their indices, as by ``np.unique`` but in a fraction of its time.
    """
    order = np.lexsort(rows.T)
    ordered = rows[order]
    is_new = np.append(True, (ordered[1:] != ordered[:-1]).any(axis=1))
    groups = np.empty(len(rows), dtype=np.int64)
    groups[order] = np.cumsum(is_new) - 1
    return order[is_new], groups


def grouped(rows: IntArray, labels: IntArray) -> list[IntArray]:
    """Split rows (n, ...) into a list of arrays, one for each different label (n,), ascending."""
    order = np.argsort(labels, kind="stable")
    last = np.flatnonzero(np.diff(labels[order]))
    return np.split(rows[order], last + 1) if len(rows) else []


def corner_fans(slots: IntArray, face_count: int) -> IntArray:
    """Return the fan of each corner, (F, 3).

    A fan is a set of corners at one vertex that are connected by shared edges. ``slots`` are the
    :func:`edge_slots` of a consistently oriented mesh. A manifold vertex has one fan, and a pinched
    one has several. If the surface is cut at its pinched vertices, its vertices are the fans.
    """
    start = next_corner(slots[slots[:, 1] >= 0])
    end = next_corner(start)
    links = [np.stack([start[:, k], end[:, 1 - k]], axis=1) for k in (0, 1)]
    return connected(3 * face_count, np.concatenate(links)).reshape(-1, 3)


def pinched_vertices(faces: IntArray, fans: IntArray, vertex_count: int) -> BoolArray:
    """Return whether each vertex (V,) is pinched: it has several :func:`corner_fans`."""
    vertex_of_fan = np.zeros(fans.max() + 1, dtype=np.int64)
    vertex_of_fan[fans] = faces
    return np.bincount(vertex_of_fan, minlength=vertex_count) > 1
