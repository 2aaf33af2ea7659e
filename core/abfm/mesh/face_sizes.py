"""Areas of faces, and which faces have none."""

import numpy as np

from abfm.types import BoolArray, FloatArray, IntArray

FLATNESS = 1e-12  # height over longest edge at which a face has no usable gradient
# height over distance from the origin at which it is a matter of rounding
ROUNDING = 4 * np.finfo(np.float64).eps
# faces whose corners are looked at together, as many as the processor's caches hold
AT_A_TIME = 1 << 15


def twice_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute twice the area of every face, (F,)."""
    found = np.empty(len(faces))
    for start in range(0, len(faces), AT_A_TIME):
        a, b, c = _corners(vertices, faces[start : start + AT_A_TIME])
        found[start : start + AT_A_TIME] = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return found


def flat_faces(vertices: FloatArray, faces: IntArray) -> BoolArray:
    """Compute the faces (F,) without area: so flat that gradients on them would be noise.

    The height over the longest edge is at most 1e-12 of that edge, or what rounding does to the
    coordinates: 9e-16 of how far the face reaches from the origin. That is the same in every unit
    of length and after every rotation.
    """
    distances = np.sqrt(_squares(vertices))
    found = np.empty(len(faces), dtype=bool)
    for start in range(0, len(faces), AT_A_TIME):
        some = slice(start, start + AT_A_TIME)
        a, b, c = _corners(vertices, faces[some])
        sides = [b - a, c - b, a - c]
        twice = np.sqrt(_squares(np.cross(sides[0], sides[2])))
        longest = np.sqrt(np.maximum.reduce([_squares(side) for side in sides]))
        reach = distances.take(faces[some].T).max(axis=0)
        found[some] = ~(twice > (FLATNESS * longest + ROUNDING * reach) * longest)
    return found


def side_lengths(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute the length of the side opposite each corner, (F, 3)."""
    a, b, c = _corners(vertices, faces)
    return np.stack([np.sqrt(_squares(side)) for side in (c - b, a - c, b - a)], axis=1)


def _corners(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return where the corners of faces are, (3, F, 3)."""
    return np.moveaxis(vertices.take(faces, axis=0), 1, 0)  # several times as fast as by index


def _squares(vectors: FloatArray) -> FloatArray:
    """Compute squared lengths of rows, (n,)."""
    found: FloatArray = np.einsum("nx,nx->n", vectors, vectors)
    return found
