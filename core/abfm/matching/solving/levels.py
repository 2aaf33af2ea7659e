"""The energy on meshes from coarse to fine, and what goes from one to the next.

Where thin triangles would set the cost of an evaluation the mesh itself comes twice: first with
their vertices held together (`abfm.flow.clusters`), then as it is.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.flow.clusters import vertex_clusters
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.resolution import narrowest
from abfm.matching.solving.transfer import Transfer
from abfm.mesh import TriangleMesh, per_mesh
from abfm.mesh.coarsening import coarsened
from abfm.parameters import Parameters
from abfm.types import FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

COARSEST = 2500
"""Vertices of the coarsest mesh where their number is chosen here."""
RATIO = 4.0
"""Of the numbers of vertices of a mesh and the next coarser one."""
# times as many vertices as the coarsest mesh: smaller meshes are solved on themselves alone
_WORTH = 3.0
_EDGES = 3.0  # that a function's features span at least on a mesh of their own choice
_COST = 2.0  # of all iterations on the mesh as it is, in iterations with vertices held together
_LEAST = 2  # iterations that are always spent
_PATIENCE = 0.05  # seconds between two looks at whether to go on waiting


class Level:
    """The energy on one mesh, and the way to the next finer one; None where that is the same
    mesh.
    """

    def __init__(
        self,
        energy: MatchingEnergy,
        to_finer: Transfer | None = None,
        cheaper: MatchingEnergy | None = None,
    ) -> None:
        self.energy, self._to_finer, self._cheaper = energy, to_finer, cheaper

    def fields_to_finer(self, x: FloatArray) -> FloatArray:
        """Frame coefficients (N, F, 2) on the finer mesh; times mean the same there."""
        if self._to_finer is None:
            return x
        fields = to_ambient(self.energy.mesh, x) * self.energy.length_scale
        return np.stack([self._to_finer.field_to_fine(field) for field in fields])

    def fields_from_finer(self, fields: FloatArray) -> FloatArray:
        """Frame coefficients (N, F, 2) here of fields (N, F, 3) on the finer mesh scaled to unit
        area.
        """
        if self._to_finer is None:
            return np.stack([to_frame(self.energy.mesh, field) for field in fields])
        found = np.stack([self._to_finer.field_to_coarse(field) for field in fields])
        return found / self.energy.length_scale

    def functions_to_finer(self, functions: FloatArray) -> FloatArray:
        """Functions (C, V) on the finer mesh."""
        return functions if self._to_finer is None else self._to_finer.function_to_fine(functions)

    def affordable(self, iterations: int, x: FloatArray) -> int:
        """Return how many of so many iterations to spend here, from frame coefficients (N, F, 2)
        on.

        Where thin triangles set the cost it can be fifty times what it is with their vertices held
        together, where these iterations have been made already. What is spent is what they would
        cost there.
        """
        if self._cheaper is None:
            return iterations
        share = _COST * (self._cheaper.flow(x).exponent / max(self.energy.flow(x).exponent, 1e-300))
        return max(_LEAST, int(iterations * min(1.0, share)))


def levels(finest: list[Level]) -> list[Level]:
    """Make the energy on all meshes, from the coarsest to the last of ``finest``."""
    found = list(finest)
    energy = found[0].energy
    size = len(energy.mesh.vertices)
    counts, edges = _vertex_counts(energy.mesh, energy.parameters), np.inf
    if counts and not energy.parameters.levels:
        edges = narrowest(energy.functions)
    if not counts:
        return found
    with step("making coarser meshes", size):
        for count in counts:
            checkpoint()
            if edges >= _EDGES > edges * np.sqrt(count / size):
                # what this mesh resolves and the coarser one does not would come back distorted
                break
            energy = found[0].energy
            with _making(energy.mesh):
                coarse = coarsened(energy.mesh, count)
            if coarse is None:
                break
            transfer = _transfer(energy.mesh, coarse)
            smaller = energy.problem.restricted(transfer)
            if smaller is None:
                break
            found.insert(0, Level(MatchingEnergy(smaller), transfer))
    return found


def on_the_mesh(finest: MatchingEnergy) -> list[Level]:
    """The levels with the mesh of ``finest``: where thin triangles cost too much, first with their
    vertices joined.

    The bracket gradient and linearised steps have no clusters, nor has a match on one level by
    choice.
    """
    p = finest.parameters
    chosen = p.levels == 1 or p.gradient != "adjoint" or p.method != "nonlinear"
    if chosen or vertex_clusters(finest.mesh) is None:
        return [Level(finest)]
    clustered = finest.clustered()
    return [Level(clustered), Level(finest, cheaper=clustered)]


def prepare(mesh: TriangleMesh, parameters: Parameters) -> None:
    """Make the meshes of `levels` ahead, which a match in another thread waits for."""
    fine = mesh.normalized()
    with step("making coarser meshes", len(fine.vertices)):
        _prepare(fine, parameters)


def _prepare(fine: TriangleMesh, parameters: Parameters) -> None:
    for count in _vertex_counts(fine, parameters):
        with _making(fine):
            coarse = coarsened(fine, count)
            if coarse is None:
                return
            _transfer(fine, coarse).prepare()
        fine = coarse.normalized()


@contextmanager
def _making(mesh: TriangleMesh) -> Iterator[None]:
    """Let one thread at a time make the coarser mesh of a mesh."""
    while not _lock(mesh).acquire(timeout=_PATIENCE):
        checkpoint()
    try:
        yield
    finally:
        _lock(mesh).release()


@per_mesh
def _lock(mesh: TriangleMesh) -> threading.Lock:
    return threading.Lock()


def _vertex_counts(mesh: TriangleMesh, p: Parameters) -> list[int]:
    """Of the coarser meshes, finest first."""
    count = len(mesh.vertices)
    if p.levels:
        return [max(int(count / RATIO**step), 4) for step in range(1, p.levels)]
    if count < _WORTH * COARSEST:
        return []
    steps = max(1, round(np.log(count / COARSEST) / np.log(RATIO)))
    return [int(count * (COARSEST / count) ** (step / steps)) for step in range(1, steps + 1)]


@per_mesh
def _transfer(fine: TriangleMesh, coarse: TriangleMesh) -> Transfer:
    return Transfer(coarse, fine)
