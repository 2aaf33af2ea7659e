"""The energy on meshes from coarse to fine, and what goes from one to the next."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from abfm.energy import MatchingEnergy
from abfm.mesh import FloatArray, TriangleMesh
from abfm.mesh.coarsening import coarsened
from abfm.operators import face_areas
from abfm.parameters import Parameters
from abfm.resolution import resolution
from abfm.transfer import Transfer
from abfm.vector_fields import to_ambient

COARSEST = 2500
"""Vertices of the coarsest mesh where their number is chosen here."""
RATIO = 4.0
"""Of the numbers of vertices of a mesh and the next coarser one."""
_WORTH = 3.0  # times as many vertices as the coarsest mesh: smaller meshes are solved on themselves alone
_EDGES = 3.0  # that a function's features span at least on a mesh of their own choice
_COST = 2.0  # of an evaluation on even triangles: spectral bound times height over speed
_LEAST = 2  # iterations that are always spent


_PATIENCE = 0.05  # seconds between two looks at whether to go on waiting
_LOCKS: WeakKeyDictionary[TriangleMesh, threading.Lock] = WeakKeyDictionary()
_LOCKS_LOCK = threading.Lock()


class Level:
    """The energy on one mesh, and the way from there to the next finer one, if there is one."""

    def __init__(self, energy: MatchingEnergy, to_finer: Transfer | None, is_coarsest: bool = True) -> None:
        self.energy, self._to_finer, self.is_coarsest = energy, to_finer, is_coarsest

    @cached_property
    def _usual_height(self) -> float:
        """Median of the faces' least heights."""
        mesh = self.energy.mesh
        corners = mesh.vertices[mesh.faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        return float(np.median(2 * face_areas(mesh) / longest))

    def fields_to_finer(self, x: FloatArray) -> FloatArray:
        """Frame coefficients (N, F, 2) on the finer mesh; times mean the same there."""
        transfer = self._transfer
        fields = to_ambient(self.energy.mesh, x) * self.energy.length_scale
        return np.stack([transfer.field_to_fine(field) for field in fields])

    def fields_from_finer(self, fields: FloatArray) -> FloatArray:
        """Frame coefficients (N, F, 2) here of fields (N, F, 3) on the finer mesh scaled to unit area."""
        found = np.stack([self._transfer.field_to_coarse(field) for field in fields])
        return found / self.energy.length_scale

    def functions_to_finer(self, functions: FloatArray) -> FloatArray:
        """Functions (C, V) on the finer mesh."""
        return self._transfer.function_to_fine(functions)

    def affordable(self, iterations: int, x: FloatArray) -> int:
        """How many of so many iterations to spend here, from frame coefficients (N, F, 2) on.

        Where a few thin triangles set the cost of an evaluation it can be fifty times the usual one; on coarser meshes,
        which have none, these iterations have been made already. What is spent is what even triangles would cost.
        """
        if self.is_coarsest:
            return iterations
        usual = self.energy.step * float(np.sqrt((x**2).sum(axis=-1)).max(axis=-1).sum()) / self._usual_height
        return max(_LEAST, int(iterations * min(1.0, _COST * usual / max(self.energy.exponent(x), 1e-300))))

    @property
    def _transfer(self) -> Transfer:
        assert self._to_finer is not None
        return self._to_finer


def levels(finest: MatchingEnergy, between: Callable[[], None]) -> list[Level]:
    """The energy on all meshes, from the coarsest to that of ``finest``; ``between`` is called on the way."""
    found = [Level(finest, None)]
    counts, edges = _vertex_counts(finest.mesh, finest.parameters), np.inf
    if counts and not finest.parameters.levels:
        counting = finest.weights > 0
        edges = resolution(finest.mesh, np.concatenate([finest.source[counting], finest.target[counting]]).T)
    for count in counts:
        between()
        if edges >= _EDGES > edges * np.sqrt(count / len(finest.mesh.vertices)):
            break  # what this mesh resolves and the coarser one does not would come back distorted
        energy = found[0].energy
        with _making(energy.mesh, between):
            coarse = coarsened(energy.mesh, count)
        if coarse is None:
            break
        transfer = _transfer(energy.mesh, coarse)
        mask = None if energy.mask is None else np.maximum(transfer.function_to_coarse(energy.mask), 0)
        if mask is not None and not mask.any():
            break
        f, g = transfer.function_to_coarse(energy.source), transfer.function_to_coarse(energy.target)
        smaller = MatchingEnergy(coarse, f.T, g.T, energy.parameters, mask, energy.weights)
        smaller.function_size = energy.function_size
        found[0].is_coarsest = False
        found.insert(0, Level(smaller, transfer))
    return found


def prepare(mesh: TriangleMesh, parameters: Parameters) -> None:
    """Make the meshes of `levels` ahead, which a match in another thread waits for."""
    fine = mesh.normalized()
    for count in _vertex_counts(fine, parameters):
        with _making(fine):
            coarse = coarsened(fine, count)
            if coarse is None:
                return
            _transfer(fine, coarse).prepare()
        fine = coarse.normalized()


@contextmanager
def _making(mesh: TriangleMesh, between: Callable[[], None] = lambda: None) -> Iterator[None]:
    """One thread at a time for the coarser mesh of a mesh; ``between`` is called while another one is at it."""
    with _LOCKS_LOCK:
        lock = _LOCKS.setdefault(mesh, threading.Lock())
    while not lock.acquire(timeout=_PATIENCE):
        between()
    try:
        yield
    finally:
        lock.release()


def _vertex_counts(mesh: TriangleMesh, p: Parameters) -> list[int]:
    """Of the coarser meshes, finest first."""
    count = len(mesh.vertices)
    if p.levels:
        return [max(int(count / RATIO**step), 4) for step in range(1, p.levels)]
    if count < _WORTH * COARSEST:
        return []
    steps = max(1, round(np.log(count / COARSEST) / np.log(RATIO)))
    return [int(count * (COARSEST / count) ** (step / steps)) for step in range(1, steps + 1)]


def _transfer(fine: TriangleMesh, coarse: TriangleMesh) -> Transfer:
    """Made once for two meshes, and kept with the fine one."""
    key = (__name__, coarse)
    if key not in fine.cache:
        fine.cache[key] = Transfer(coarse, fine)
    transfer: Transfer = fine.cache[key]
    return transfer
