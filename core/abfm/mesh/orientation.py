"""Making the faces of a mesh agree on a side."""

import numpy as np

from abfm.errors import MeshError
from abfm.mesh.topology import connected, next_corner
from abfm.types import BoolArray, FloatArray, IntArray

_ENCLOSES = 0.3  # of what the normals of a sphere come to


def faces_to_flip(
    vertices: FloatArray, faces: IntArray, face_ids: IntArray, slots: IntArray
) -> BoolArray:
    """Return the faces (F,) to turn over so that neighbours agree; none when they already do.

    Each piece joined through edges is settled by itself: a closed one ends with its normals
    outward, one with a boundary keeps the side that most of its faces have.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (F, 3) array
    face_ids : (F,) array
        What an error calls them.
    slots : (E, 2) array
        :func:`abfm.mesh.topology.edge_slots`.

    Raises
    ------
    MeshError
        If the surface is not orientable.
    """
    inner = slots[slots[:, 1] >= 0]
    start = faces.ravel()[next_corner(inner)]
    disagree = start[:, 0] == start[:, 1]
    if not disagree.any():
        return np.zeros(len(faces), dtype=bool)

    as_given, turned = _double_cover(inner // 3, disagree, len(faces))
    one_sided = as_given == turned
    if one_sided.any():
        raise MeshError(
            f"the surface is not orientable, like a Moebius strip ({one_sided.sum()} of "
            f"{len(faces)} faces lie on a one-sided piece, for example face "
            f"{face_ids[np.argmax(one_sided)]}, counting from 0): cut it open"
        )
    flip = turned < as_given
    piece = np.minimum(as_given, turned)
    return flip ^ _prefers_other_side(vertices, faces, slots, flip, piece)[piece]


def _double_cover(
    neighbours: IntArray, disagree: BoolArray, face_count: int
) -> tuple[IntArray, IntArray]:
    """Return the component of every face as given and of its turned copy in the orientation double
    cover, both (F,).
    """
    f, g = neighbours.T
    same = np.stack([f, g + face_count * disagree], axis=1)
    opposite = np.stack([f + face_count, g + face_count * ~disagree], axis=1)
    labels = connected(2 * face_count, np.concatenate([same, opposite]))
    return labels[:face_count], labels[face_count:]


def _prefers_other_side(
    vertices: FloatArray, faces: IntArray, slots: IntArray, flip: BoolArray, piece: IntArray
) -> BoolArray:
    """Return per piece label: whether the flips proposed for it are the wrong one of the two
    choices.
    """
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[faces], 1, 0)
    volume = np.einsum("fx,fx->f", a, np.cross(b, c)) * np.where(flip, -1, 1)
    inward = np.bincount(piece, volume) < 0
    mostly_flipped = 2 * np.bincount(piece, flip) > np.bincount(piece)
    has_boundary = np.zeros(len(inward), dtype=bool)
    has_boundary[piece[slots[slots[:, 1] < 0, 0] // 3]] = True
    return np.where(has_boundary, mostly_flipped, inward)


def faces_inward(vertices: FloatArray, faces: IntArray) -> bool:
    """Return whether a surface that encloses space, all of it or nearly, has its inner side in
    front.

    Its normals then point, on the whole, to the middle. The more they agree on a direction, as
    those of a dish do, the more clearly they must: what is flat or shaped like a saddle has no
    inner side.
    """
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals, middles = np.cross(b - a, c - a), (a + b + c) / 3
    sizes = np.linalg.norm(normals, axis=1)
    outward = middles - sizes @ middles / sizes.sum()
    agree = float(np.linalg.norm(normals.sum(axis=0)) / sizes.sum())
    clearly = _ENCLOSES * agree * float(sizes @ np.linalg.norm(outward, axis=1))
    return float(np.einsum("fx,fx->", normals, outward)) < -clearly
