"""Arrows as triangles: polyscope's own are cast per pixel, and frayed where they are thin."""

from itertools import pairwise

import numpy as np

from abfm.types import FloatArray, IntArray

_SIDES = 10
_HEAD_RADIUS, _HEAD_LENGTH = 2.4, 7.0  # in radii of the shaft
_LONGEST_HEAD = 0.5  # of the arrow


def arrow_mesh(starts: FloatArray, vectors: FloatArray, radius: float) -> tuple[FloatArray, IntArray]:
    """Closed arrows from `starts` along `vectors`, both (n, 3), of which those of length 0 are left out.

    The shafts have a radius, and are thinner where an arrow is too short for its head.

    Returns
    -------
    vertices, faces : (V, 3) array, (F, 3) array of int
        All of a piece, counterclockwise from outside.
    """
    lengths = np.linalg.norm(vectors, axis=1)
    starts, vectors, lengths = (values[lengths > 0] for values in (starts, vectors, lengths))
    head = np.minimum(_HEAD_LENGTH * radius, _LONGEST_HEAD * lengths)
    thickness = head / _HEAD_LENGTH
    # a profile from the tail's middle over four rings to the tip, turned about the arrow
    along = np.stack([0 * lengths, 0 * lengths, lengths - head, lengths - head, lengths], axis=1)
    widths = thickness[:, None] * np.array([0.0, 1.0, 1.0, _HEAD_RADIUS, 0.0])
    axis = vectors / lengths[:, None]
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1)[:, None]
    angles = 2 * np.pi * np.arange(_SIDES) / _SIDES
    around = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * np.cross(axis, first)[:, None]
    centers = starts[:, None] + along[:, :, None] * axis[:, None]
    rings = centers[:, 1:4, None] + widths[:, 1:4, None, None] * around[:, None]
    vertices = np.concatenate([centers[:, :1], rings.reshape(len(starts), 3 * _SIDES, 3), centers[:, 4:]], axis=1)
    faces = _faces() + vertices.shape[1] * np.arange(len(starts))[:, None, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def _faces() -> IntArray:
    """Of one arrow: vertex 0 at the tail, three rings, and the tip."""
    here = np.arange(_SIDES)
    there = (here + 1) % _SIDES
    tip = np.full(_SIDES, 1 + 3 * _SIDES)
    first, _, last = rings = [1 + ring * _SIDES for ring in range(3)]
    parts = [(0 * here, first + there, first + here), (last + here, last + there, tip)]
    for low, high in pairwise(rings):
        parts += [(low + here, low + there, high + there), (low + here, high + there, high + here)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])
