"""The levels of a match: energies on meshes from coarse to fine, and transfers between them.

Thin triangles can dominate the cost of an evaluation. A mesh with such triangles has two levels. In
the first one, their vertices form clusters (`abfm.flow.clusters`); the second has none.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from abfm.calculus.operators import Matrix, face_frames, face_normals, vertex_areas
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.flow.clusters import vertex_clusters
from abfm.flow.continuous_flow import field_on_children
from abfm.flow.corner_fit import corner_vectors
from abfm.maps.point_maps import PointMap
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solvability import narrowest, range_bound
from abfm.matching.solving.settings import SETTINGS
from abfm.mesh import TriangleMesh, per_mesh
from abfm.mesh.coarsening import coarsened
from abfm.mesh.subdivision import interpolated, refined
from abfm.numerics.kernels import kernel
from abfm.parameters import Parameters
from abfm.types import FloatArray, IndexArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

_WAIT_SECONDS = 0.05  # interval of cancellation checks while another thread makes a mesh


@dataclass(frozen=True, eq=False)
class Transfer:
    """The transfer of functions and fields by closest points between meshes in the same unit."""

    coarse: TriangleMesh
    fine: TriangleMesh

    def prepare(self) -> None:
        """Find the closest points now instead of at the first transfer."""
        _ = self.interpolation, self._covered, self._to_coarse

    @cached_property
    def interpolation(self) -> Matrix:
        """The matrix (V, V_coarse) that interpolates coarse functions at the fine vertices."""
        return self._to_fine.to_matrix()

    @cached_property
    def _covered(self) -> FloatArray:
        return np.asarray(self.interpolation.T @ vertex_areas(self.fine))

    @cached_property
    def _to_fine(self) -> PointMap:
        return PointMap.project(self.fine, self.coarse, self.fine.vertices)

    @cached_property
    def _to_coarse(self) -> PointMap:
        return PointMap.project(self.coarse, self.fine, self.coarse.vertices)

    def function_to_coarse(self, f: FloatArray) -> FloatArray:
        """Return averages of fine functions (..., V) over coarse hat functions, (..., V_coarse)."""
        totals = self.interpolation.T @ (vertex_areas(self.fine) * f).T
        averages = (totals.T / np.where(self._covered > 0, self._covered, 1.0)).copy()
        # without fine vertices nearby, use the value at the closest point
        uncovered = np.flatnonzero(self._covered == 0)
        if len(uncovered):
            points = self._to_coarse
            corners = f[..., self.fine.faces[points.faces[uncovered]]]
            averages[..., uncovered] = (corners * points.barycentric[uncovered]).sum(axis=-1)
        return np.asarray(averages)

    def function_to_fine(self, f: FloatArray) -> FloatArray:
        return np.ascontiguousarray((self.interpolation @ f.T).T)

    def field_to_fine(self, field: FloatArray) -> FloatArray:
        return _transferred_field(field, self._to_fine)

    def field_to_coarse(self, field: FloatArray) -> FloatArray:
        return _transferred_field(field, self._to_coarse)


@dataclass(frozen=True, eq=False)
class Subdivision:
    """The transfer of functions and fields from a mesh to its midpoint subdivision.

    The vertices of the mesh are the first vertices of the subdivision.
    """

    coarse: TriangleMesh

    def function_to_fine(self, f: FloatArray) -> FloatArray:
        return np.ascontiguousarray(interpolated(self.coarse, f.T).T)

    def field_to_fine(self, field: FloatArray) -> FloatArray:
        return to_frame(refined(self.coarse, 1), field_on_children(self.coarse, field))


def _transferred_field(field: FloatArray, points: PointMap) -> FloatArray:
    """Transfer a field (F, 2) from the codomain of a point map to its domain.

    The continuous field is evaluated at the mapped vertices and rotated onto the faces.
    """
    mesh, other = points.codomain, points.domain
    vectors = (corner_vectors(mesh, field)[points.faces] * points.barycentric).sum(axis=1)
    frames = face_frames(mesh)[points.faces]
    found = vectors.real[:, None] * frames[:, 0] + vectors.imag[:, None] * frames[:, 1]
    normals = face_normals(mesh)[points.faces]
    onto = other.faces, face_normals(other), face_frames(other)
    transferred: FloatArray = rotate_onto_faces(found, normals, *onto)
    return transferred


@kernel
def rotate_onto_faces(
    vectors: FloatArray,
    normals: FloatArray,
    faces: IndexArray,
    face_normals: FloatArray,
    frames: FloatArray,
) -> FloatArray:
    """Rotate vectors (V, 3) at vertices onto faces; return means over the corners, (F, 2).

    Each vector is rotated from ``normals`` (V, 3), the normal at its vertex, to the normal of the
    face.
    """
    out = np.zeros((faces.shape[0], 2))
    for f in range(faces.shape[0]):
        n = face_normals[f]
        for c in range(3):
            v, m = vectors[faces[f, c]], normals[faces[f, c]]
            along = 1.0 + m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
            height = v[0] * n[0] + v[1] * n[1] + v[2] * n[2]
            # between nearly opposite normals no rotation is unique, so the vector is projected
            share = height / along if along > 1e-3 else 0.0
            for k in range(2):
                e = frames[f, k]
                for x in range(3):
                    out[f, k] += (v[x] - share * m[x]) * e[x] / 3
    return out


@dataclass(frozen=True, eq=False)
class Level:
    """The energy on one mesh, and the transfer to the next finer mesh.

    If the level before has the same mesh with clusters of vertices, ``cheaper`` is its energy.
    """

    energy: MatchingEnergy
    to_finer: Transfer | Subdivision | None = None
    cheaper: MatchingEnergy | None = None

    def fields_to_finer(self, x: FloatArray) -> FloatArray:
        if self.to_finer is None:
            return x
        fields = to_ambient(self.energy.mesh, x)
        if isinstance(self.to_finer, Transfer):
            fields = fields * self.energy.length_scale
        return np.stack([self.to_finer.field_to_fine(field) for field in fields])

    def fields_from_finer(self, fields: FloatArray) -> FloatArray:
        """Transfer fields (N, F, 3) from the next finer mesh, of unit area, to this mesh.

        Return coefficients (N, F, 2).
        """
        if not isinstance(self.to_finer, Transfer):
            return np.stack([to_frame(self.energy.mesh, field) for field in fields])
        found = np.stack([self.to_finer.field_to_coarse(field) for field in fields])
        return found / self.energy.length_scale

    def functions_to_finer(self, functions: FloatArray) -> FloatArray:
        return functions if self.to_finer is None else self.to_finer.function_to_fine(functions)

    def affordable_iterations(self, iterations: int, x: FloatArray) -> int:
        """Return a number of iterations, reduced if clusters of vertices make them much cheaper.

        They cost at most a constant factor more than ``iterations`` iterations with clusters.
        """
        if self.cheaper is None:
            return iterations
        ratio = self.cheaper.flow(x).exponent / max(self.energy.flow(x).exponent, 1e-300)
        share = min(1.0, SETTINGS.cluster_cost_max * ratio)
        return max(SETTINGS.exact_iterations_min, int(iterations * share))

    def cost(self, x: FloatArray) -> float:
        """Return the approximate cost of an evaluation at (N, F, 2), in matrix row products."""
        return self.energy.discretisation.size * max(self.energy.flow(x).exponent, 1.0)


@dataclass(frozen=True, eq=False)
class Levels:
    """The levels of a match, from coarse to fine.

    Level ``mesh_level`` is the mesh of the problem; later levels are its subdivisions.
    """

    all: tuple[Level, ...]
    mesh_level: int

    @classmethod
    def of_mesh(cls, energy: MatchingEnergy) -> "Levels":
        levels = _of_mesh(energy)
        return cls(levels, len(levels) - 1)

    def __len__(self) -> int:
        return len(self.all)

    def __getitem__(self, level: int) -> Level:
        return self.all[level]

    def cheapest(self, level: int) -> int:
        """Return the first level on the mesh of ``level``; it has clusters of vertices, if any."""
        return level - (self[level].cheaper is not None)

    def exact(self, level: int) -> int:
        """Return the last level on the mesh of ``level``; it has no clusters of vertices."""
        is_clustered = level + 1 < len(self) and self[level + 1].cheaper is not None
        return level + is_clustered

    def exact_energy(self, level: int) -> MatchingEnergy:
        return self[self.exact(level)].energy

    def fields_on(self, level: int, x: FloatArray, origin: int) -> FloatArray:
        """Transfer coefficients (N, F, 2) from level ``origin`` to the same or a finer level."""
        for coarser in self.all[origin:level]:
            x = coarser.fields_to_finer(x)
        return x

    def error(self, level: int) -> float:
        """Return the discretisation error of source and target on a level, as a residual.

        It is the difference from the functions that are averaged on the level and interpolated
        back.
        """
        if level >= self.mesh_level:
            return 0.0
        functions, fine = self[level].energy.functions, self[self.mesh_level].energy.functions
        errors = []
        for coarse, exact in ((functions.source, fine.source), (functions.target, fine.target)):
            for between in self.all[level : self.mesh_level]:
                coarse = between.functions_to_finer(coarse)
            errors.append(fine.relative_size(coarse - exact))
        return max(errors)

    def attainable(self, goal: float) -> float:
        """Return ``goal`` or, if larger, the least residual of any flow; 0 if ``goal`` is 0."""
        return max(goal, range_bound(self[self.mesh_level].energy.functions)) if goal else 0.0

    def with_coarser(self) -> "Levels":
        """Return the levels preceded by levels on coarser meshes.

        The number of meshes is the parameter ``levels``. If this is 0, it depends on the size of
        the mesh and on the width of the features.
        """
        found, first = list(self.all), self[0].energy
        size, least = len(first.mesh.vertices), SETTINGS.feature_edges_min
        counts = _vertex_counts(first.mesh, first.parameters)
        if not counts:
            return self
        edges = np.inf if first.parameters.solver.levels else narrowest(first.functions)
        with step("making coarser meshes", size):
            for count in counts:
                checkpoint()
                if edges >= least > edges * np.sqrt(count / size):
                    # a coarser mesh would distort features that this mesh resolves
                    break
                energy = found[0].energy
                transfer = _coarser(energy.mesh, count)
                smaller = None if transfer is None else energy.problem.restricted(transfer)
                if smaller is None:
                    break
                found.insert(0, Level(MatchingEnergy(smaller), transfer))
        return Levels(tuple(found), len(found) - 1)

    def subdivided(self) -> "Levels":
        """Return the levels followed by one on the midpoint subdivision of the finest mesh.

        Raise AbfmError if that mesh cannot be subdivided.
        """
        last = self.all[-1]
        finer = Level(MatchingEnergy(last.energy.problem.subdivided()))
        coarse = replace(last, to_finer=Subdivision(last.energy.mesh))
        return replace(self, all=(*self.all[:-1], coarse, finer))

    def clustered(self) -> "Levels":
        """Return the levels, with a copy of the last one with clusters of vertices before it.

        The levels do not change if clusters are not useful, or if the parameters exclude them.
        """
        return replace(self, all=(*self.all[:-1], *_of_mesh(self.all[-1].energy)))


def _of_mesh(finest: MatchingEnergy) -> tuple[Level, ...]:
    p, paper = finest.parameters, finest.parameters.paper
    is_plain = p.solver.levels == 1 or paper.gradient != "adjoint" or paper.method != "nonlinear"
    if is_plain or vertex_clusters(finest.mesh) is None:
        return (Level(finest),)
    clustered = finest.clustered()
    return Level(clustered), Level(finest, cheaper=clustered)


def prepare(mesh: TriangleMesh, parameters: Parameters) -> None:
    """Make and cache the coarser meshes of a match; a match in another thread waits for them."""
    fine = mesh.normalized()
    with step("making coarser meshes", len(fine.vertices)):
        for count in _vertex_counts(fine, parameters):
            transfer = _coarser(fine, count, in_advance=True)
            if transfer is None:
                return
            fine = transfer.coarse.normalized()


def _coarser(fine: TriangleMesh, count: int, in_advance: bool = False) -> Transfer | None:
    with _making(fine):
        coarse = coarsened(fine, count)
        transfer = None if coarse is None else _transfer(fine, coarse)
        if transfer is not None and in_advance:
            transfer.prepare()
    return transfer


@contextmanager
def _making(mesh: TriangleMesh) -> Iterator[None]:
    while not _lock(mesh).acquire(timeout=_WAIT_SECONDS):
        checkpoint()
    try:
        yield
    finally:
        _lock(mesh).release()


@per_mesh
def _lock(mesh: TriangleMesh) -> threading.Lock:
    return threading.Lock()


def _vertex_counts(mesh: TriangleMesh, p: Parameters) -> list[int]:
    count, ratio, coarsest = len(mesh.vertices), SETTINGS.level_ratio, SETTINGS.coarsest_vertices
    if p.solver.levels:
        return [max(int(count / ratio**step), 4) for step in range(1, p.solver.levels)]
    if count < SETTINGS.coarsening_factor_min * coarsest:
        return []
    steps = max(1, round(np.log(count / coarsest) / np.log(ratio)))
    return [int(count * (coarsest / count) ** (step / steps)) for step in range(1, steps + 1)]


@per_mesh
def _transfer(fine: TriangleMesh, coarse: TriangleMesh) -> Transfer:
    return Transfer(coarse, fine)
