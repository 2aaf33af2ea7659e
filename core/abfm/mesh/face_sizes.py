"""Areas and side lengths of faces, and the detection of faces without area."""

import numpy as np

from abfm.types import BoolArray, FloatArray, IntArray

FLATNESS = 1e-12  # gradients are unusable on faces with a smaller ratio of height and longest edge
# a height may be a rounding error up to this share of the distance from the origin
ROUNDING = 4 * np.finfo(np.float64).eps
CHUNK_FACES = 1 << 15  # number of faces processed together; their corners fit the CPU caches


def twice_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return twice the area of each face, (F,)."""
    found = np.empty(len(faces))
    for start in range(0, len(faces), CHUNK_FACES):
        a, b, c = _corners(vertices, faces[start : start + CHUNK_FACES])
        found[start : start + CHUNK_FACES] = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return found


def flat_faces(vertices: FloatArray, faces: IntArray) -> BoolArray:
    """Return whether each face (F,) has no area, so that gradients on it would be noise.

    The height over the longest edge of such a face is at most 1e-12 of that edge, plus the rounding
    error of its coordinates. The latter is 9e-16 of the largest distance of its corners from the
    origin. The criterion does not depend on the unit of length or on rotations.
    """
    distances = np.sqrt(_squares(vertices))
    found = np.empty(len(faces), dtype=bool)
    for start in range(0, len(faces), CHUNK_FACES):
        some = slice(start, start + CHUNK_FACES)
        a, b, c = _corners(vertices, faces[some])
        sides = [b - a, c - b, a - c]
        twice = np.sqrt(_squares(np.cross(sides[0], sides[2])))
        longest = np.sqrt(np.maximum.reduce([_squares(side) for side in sides]))
        reach = distances.take(faces[some].T).max(axis=0)
        found[some] = ~(twice > (FLATNESS * longest + ROUNDING * reach) * longest)
    return found


def side_lengths(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the length of the side opposite each corner, (F, 3)."""
    a, b, c = _corners(vertices, faces)
    return np.stack([np.sqrt(_squares(side)) for side in (c - b, a - c, b - a)], axis=1)


def _corners(vertices: FloatArray, faces: IntArray) -> FloatArray:
    # `take` is several times as fast as indexing
    return np.moveaxis(vertices.take(faces, axis=0), 1, 0)


def _squares(vectors: FloatArray) -> FloatArray:
    found: FloatArray = np.einsum("nx,nx->n", vectors, vectors)
    return found
