"""Rays against a mesh: a tree of boxes over the faces, and the first face that a ray meets."""

from __future__ import annotations

from typing import Any

import numpy as np

from abfm.kernels import kernel
from abfm.mesh import FloatArray, IntArray, TriangleMesh, per_mesh

LEAF_SIZE = 4


@per_mesh
def box_tree(mesh: TriangleMesh) -> tuple[FloatArray, IntArray]:
    """Bounding boxes (2L - 1, 2, 3) of a complete binary tree with L leaves, and the faces in leaf order (F,).

    The faces are sorted along a space-filling curve (Morton order of their centres) and cut into leaves of
    ``LEAF_SIZE``; node n has the children ``2n + 1`` and ``2n + 2``, leaf l is node ``L - 1 + l``, L a power of two.
    """
    corners = mesh.vertices[mesh.faces]
    order = np.argsort(_morton_codes(corners.mean(axis=1)), kind="stable")
    leaves = 1
    while leaves * LEAF_SIZE < len(order):
        leaves *= 2
    boxes = np.empty((2 * leaves - 1, 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    used = np.arange(0, len(order), LEAF_SIZE)
    boxes[leaves - 1 : leaves - 1 + len(used), 0] = np.minimum.reduceat(corners.min(axis=1)[order], used)
    boxes[leaves - 1 : leaves - 1 + len(used), 1] = np.maximum.reduceat(corners.max(axis=1)[order], used)
    while leaves > 1:
        leaves //= 2
        parents = np.arange(leaves - 1, 2 * leaves - 1)
        boxes[parents, 0] = np.minimum(boxes[2 * parents + 1, 0], boxes[2 * parents + 2, 0])
        boxes[parents, 1] = np.maximum(boxes[2 * parents + 1, 1], boxes[2 * parents + 2, 1])
    return boxes, order


def _morton_codes(points: FloatArray) -> IntArray:
    """Interleaved bits of the three coordinates on a grid of 2^20 cells a side, (n,)."""
    low = points.min(axis=0)
    side = np.ptp(points, axis=0).max() or 1.0
    cells = ((points - low) / side * (2**20 - 1)).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(20):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def first_hits(mesh: TriangleMesh, sources: IntArray, directions: FloatArray) -> tuple[FloatArray, IntArray]:
    """Length and face of the first hit of every ray from vertices into the mesh; faces at the source do not count.

    Parameters
    ----------
    sources : (n,) array of int
        Vertices where the rays start.
    directions : (n, r, 3) array
        Unit vectors.

    Returns
    -------
    lengths : (n, r) array, infinite where nothing is hit
    faces : (n, r) array of int, -1 where nothing is hit
    """
    boxes, order = box_tree(mesh)
    lengths = np.empty(directions.shape[:2])
    faces = np.empty(directions.shape[:2], dtype=np.int64)
    _cast(mesh.vertices, mesh.faces, boxes, order, sources, np.ascontiguousarray(directions), lengths, faces)
    return lengths, faces


@kernel
def _box_entry(box, origin, inverse):
    """Ray parameter where the ray enters the box, infinite if it misses (slab test)."""
    near, far = 0.0, np.inf
    for axis in range(3):
        a = (box[0, axis] - origin[axis]) * inverse[axis]
        b = (box[1, axis] - origin[axis]) * inverse[axis]
        if a > b:
            a, b = b, a
        near, far = max(near, a), min(far, b)
    return near if near <= far else np.inf


@kernel
def _triangle_hit(a, b, c, origin, direction):
    """Ray parameter of the hit, infinite if none [Möller, Trumbore 1997]; edges belong to both their faces."""
    e1x, e1y, e1z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    e2x, e2y, e2z = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
    determinant = e1x * px + e1y * py + e1z * pz
    if determinant == 0.0:
        return np.inf
    sx, sy, sz = origin[0] - a[0], origin[1] - a[1], origin[2] - a[2]
    u = (sx * px + sy * py + sz * pz) / determinant
    if u < -1e-9 or u > 1.0 + 1e-9:
        return np.inf
    qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
    v = (dx * qx + dy * qy + dz * qz) / determinant
    if v < -1e-9 or u + v > 1.0 + 1e-9:
        return np.inf
    t = (e2x * qx + e2y * qy + e2z * qz) / determinant
    return t if t > 0.0 else np.inf


@kernel
def _cast(vertices, faces, boxes, order, sources, directions, lengths, hit_faces):
    """Walk the tree depth first, nearer child first, and drop every box that starts behind the best hit."""
    first_leaf = boxes.shape[0] // 2
    stack = np.empty(64, dtype=np.int64)
    entries = np.empty(64)
    inverse = np.empty(3)
    for i in range(sources.size):
        source = sources[i]
        origin = vertices[source]
        for r in range(directions.shape[1]):
            direction = directions[i, r]
            for axis in range(3):
                inverse[axis] = 1.0 / direction[axis] if direction[axis] != 0.0 else 1e300
            best, best_face = np.inf, -1
            stack[0], entries[0], depth = 0, _box_entry(boxes[0], origin, inverse), 1
            while depth > 0:
                depth -= 1
                node = stack[depth]
                if entries[depth] >= best:
                    continue
                if node >= first_leaf:
                    start = (node - first_leaf) * 4
                    for place in range(start, min(start + 4, order.size)):
                        f = order[place]
                        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                        if source in (a, b, c):
                            continue
                        t = _triangle_hit(vertices[a], vertices[b], vertices[c], origin, direction)
                        if t < best:
                            best, best_face = t, f
                    continue
                near, far = 2 * node + 1, 2 * node + 2
                near_entry = _box_entry(boxes[near], origin, inverse)
                far_entry = _box_entry(boxes[far], origin, inverse)
                if far_entry < near_entry:
                    near, far, near_entry, far_entry = far, near, far_entry, near_entry
                stack[depth], entries[depth] = far, far_entry
                stack[depth + 1], entries[depth + 1] = near, near_entry
                depth += 2
            lengths[i, r] = best
            hit_faces[i, r] = best_face
