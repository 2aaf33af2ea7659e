"""Moves of the vertices of a surface on the sphere toward target positions, with no face flipped.

All vertices move at the same time. Their moves are averages of the offsets to the targets over
neighbours, so contradictions of a discontinuous map average out. The corners of a face that would
be flipped move less.
"""

from typing import NamedTuple

import numpy as np

from abfm.maps.collapses import Surface
from abfm.maps.sphere_embedding import Embedding
from abfm.maps.star_moves import FLAT_VOLUME, Workspace, normalize, volume
from abfm.maps.surface_points import scalar
from abfm.mesh.coarsening import fill_star, next_slot
from abfm.numerics.kernels import unfused_kernel
from abfm.types import FloatArray, IntArray

_STEP = 0.5  # share of a move that is tried before it is reduced
_VOLUME_SHARE_MIN = 0.1  # smallest volume of a face after a move, relative to that before it
_HALVINGS_MAX = 12  # halvings of a move, after which the corners of a flipped face stay


class MoveArrays(NamedTuple):
    """Arrays for the moves of V vertices on the sphere."""

    moves: FloatArray  # (V, 3)
    spare: FloatArray  # (V, 3), temporary values
    shares: FloatArray  # (V,), shares of the moves that are taken


def allocate_moves(count: int) -> MoveArrays:
    return MoveArrays(np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count))


@unfused_kernel
def set_moves(
    places: FloatArray, targets: FloatArray, most: float, active: IntArray, moves: FloatArray
) -> None:
    """Set the moves of active vertices to vectors from ``places`` to ``targets``.

    Vectors longer than ``most`` are shortened to this length.
    """
    for v in active:
        moves[v] = targets[v] - places[v]
        moves[v] /= max(1.0, np.sqrt(scalar(moves[v], moves[v])) / most)


@unfused_kernel
def average(
    surface: Surface, rounds: int, active: IntArray, pull: MoveArrays, star: IntArray
) -> None:
    """Replace each active vertex's move by a mean over it and its neighbours, ``rounds`` times."""
    faces, twins, corner_of = surface
    moves, spare = pull.moves, pull.spare
    for _ in range(rounds):
        for v in active:
            size = fill_star(star, twins, corner_of[v])
            for x in range(3):
                total = moves[v, x]
                for corner in star[:size]:
                    total += moves[faces[next_slot(corner)], x]
                spare[v, x] = total / (size + 1)
        for v in active:
            moves[v] = spare[v]


@unfused_kernel
def shift(state: Embedding, active: IntArray, pull: MoveArrays, workspace: Workspace) -> None:
    """Move vertices on the sphere by half of their moves, or less where faces would be flipped."""
    moves, moved, shares = pull
    for v in active:
        moves[v] -= scalar(moves[v], state.sphere[v]) * state.sphere[v]
        shares[v] = _STEP
    tries, is_flipped = 0, True
    while is_flipped:
        for v in active:
            moved[v] = state.sphere[v] + shares[v] * moves[v]
            normalize(moved[v])
        tries += 1
        factor = 0.5 if tries <= _HALVINGS_MAX else 0.0
        is_flipped = _reduce_shares(state, active, pull, factor, workspace)
    for v in active:
        state.sphere[v] = moved[v]


@unfused_kernel
def _reduce_shares(
    state: Embedding, active: IntArray, pull: MoveArrays, factor: float, workspace: Workspace
) -> bool:
    """Shorten by ``factor`` the moves of the corners of faces that would be flipped.

    A face whose volume becomes too small also counts as flipped. Return whether there were any.
    """
    (faces, twins, corner_of), sphere, moved = state.surface, state.sphere, pull.spare
    is_flipped = False
    for v in active:
        for corner in workspace.star[: fill_star(workspace.star, twins, corner_of[v])]:
            b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
            if b < v or c < v:
                continue
            least = max(FLAT_VOLUME, _VOLUME_SHARE_MIN * volume(sphere[v], sphere[b], sphere[c]))
            if not volume(moved[v], moved[b], moved[c]) > least:
                is_flipped = True
                for end in (v, b, c):
                    pull.shares[end] *= factor
    return is_flipped
