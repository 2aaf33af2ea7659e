"""A surface on the sphere pulled toward where its vertices belong, without a fold.

All vertices move together, by averages over their neighbours of what is missing: where a torn map
contradicts itself, this averages out. Where a face would turn over, its corners move less.
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

_STEP = 0.5  # of the way
_VOLUME_SHARE_MIN = 0.1  # of a face's volume that a move leaves
_HALVINGS = 12


class MoveArrays(NamedTuple):
    """Workspace for moves of V vertices."""

    moves: FloatArray  # (V, 3)
    spare: FloatArray  # (V, 3)
    shares: FloatArray  # (V,)


def allocate_moves(count: int) -> MoveArrays:
    return MoveArrays(np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count))


@unfused_kernel
def set_moves(
    places: FloatArray, targets: FloatArray, most: float, alive: IntArray, moves: FloatArray
) -> None:
    """Set the ways of some vertices to their targets, none longer than ``most``."""
    for v in alive:
        moves[v] = targets[v] - places[v]
        moves[v] /= max(1.0, np.sqrt(scalar(moves[v], moves[v])) / most)


@unfused_kernel
def average(
    surface: Surface, rounds: int, alive: IntArray, pull: MoveArrays, star: IntArray
) -> None:
    """Average moves over neighbours, so many times."""
    faces, twins, corner_of = surface
    moves, spare = pull.moves, pull.spare
    for _ in range(rounds):
        for v in alive:
            size = fill_star(star, twins, corner_of[v])
            for x in range(3):
                total = moves[v, x]
                for corner in star[:size]:
                    total += moves[faces[next_slot(corner)], x]
                spare[v, x] = total / (size + 1)
        for v in alive:
            moves[v] = spare[v]


@unfused_kernel
def shift(state: Embedding, alive: IntArray, pull: MoveArrays, workspace: Workspace) -> None:
    """Move vertices on the sphere by half of their moves; those of faces that would turn over, or
    come near to it, by half as much, and so on.
    """
    moves, moved, shares = pull
    for v in alive:
        moves[v] -= scalar(moves[v], state.sphere[v]) * state.sphere[v]
        shares[v] = _STEP
    tries, turned = 0, True
    while turned:
        for v in alive:
            moved[v] = state.sphere[v] + shares[v] * moves[v]
            normalize(moved[v])
        tries += 1
        turned = _hold_back(state, alive, pull, 0.5 if tries <= _HALVINGS else 0.0, workspace)
    for v in alive:
        state.sphere[v] = moved[v]


@unfused_kernel
def _hold_back(
    state: Embedding, alive: IntArray, pull: MoveArrays, factor: float, workspace: Workspace
) -> bool:
    """Reduce the shares of corners of faces that are turned over; return whether there are any."""
    (faces, twins, corner_of), sphere, moved = state.surface, state.sphere, pull.spare
    turned = False
    for v in alive:
        for corner in workspace.star[: fill_star(workspace.star, twins, corner_of[v])]:
            b, c = faces[next_slot(corner)], faces[next_slot(next_slot(corner))]
            if b < v or c < v:
                continue
            least = max(FLAT_VOLUME, _VOLUME_SHARE_MIN * volume(sphere[v], sphere[b], sphere[c]))
            if not volume(moved[v], moved[b], moved[c]) > least:
                turned = True
                for end in (v, b, c):
                    pull.shares[end] *= factor
    return turned
