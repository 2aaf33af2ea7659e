"""Points that the flow is to take to other points: a data term of the flow's own map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from abfm.errors import ParameterError, brief
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.flow.flow_line_derivative import FlowLineDerivative, Walk
from abfm.maps.surface_points import SurfacePoints, project_onto_surface, vertex_points
from abfm.matching.terms.functions import checked_weights
from abfm.matching.terms.squared_distances import SquaredDistances
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import to_children
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray, IntArray

MATCHED_ERROR = 0.005
"""Of sqrt(area): landmarks that are left no farther than this count as matched, with the usual goal
of a mismatch."""
_USUAL_GOAL = 0.05


class LandmarkMisfit(NamedTuple):
    """What the landmarks say of fields."""

    share: float  # of the energy
    errors: FloatArray  # (L,), see `Landmarks.errors`
    differentiate: Callable[[], FloatArray]  # by the fields, (N, F, 2)


class LandmarkCurvature(NamedTuple):
    """The energy's derivative ``J^T D r`` by the fields, and about its second one, ``J^T D J``."""

    jacobian: sparse.csr_array  # (2 L, N F 2), of the landmarks' ends by the fields
    weights: FloatArray  # (2 L,), D
    residuals: FloatArray  # (2 L,), of each landmark a vector as long as its error


class Landmarks:
    """L points of a mesh of unit area, and where the flow is to take them; immutable.

    ``faces`` (L, 2) and ``barycentric`` (L, 2, 3) hold each landmark and the place wanted for it;
    ``weights`` are (L,).
    """

    word = "landmarks"

    def __init__(
        self, mesh: TriangleMesh, faces: IntArray, barycentric: FloatArray, weights: FloatArray
    ) -> None:
        self.mesh, self.faces, self.barycentric, self.weights = mesh, faces, barycentric, weights

    def __len__(self) -> int:
        return len(self.faces)

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs besides the mesh, see `Problem`."""
        kept = ("faces", "barycentric", "weights")
        return {name: self.__dict__[name] for name in kept}

    def points(self, mesh: TriangleMesh | None = None) -> SurfacePoints:
        """Return the landmarks, on the same mesh in other units if it is given."""
        return SurfacePoints(mesh or self.mesh, self.faces[:, 0], self.barycentric[:, 0])

    def targets(self, mesh: TriangleMesh | None = None) -> SurfacePoints:
        """Return where they are wanted."""
        return SurfacePoints(mesh or self.mesh, self.faces[:, 1], self.barycentric[:, 1])

    def misfit(self, x: FloatArray, tau: float, sigma: float) -> LandmarkMisfit:
        """Return ``1/(2 sigma^2) sum_i w_i d(phi(p_i), q_i)^2`` for the flow phi of fields
        (N, F, 2) to tau, and its derivative; AdvectionError if they lead over too many faces.
        """
        lines = self._lines(tau)
        walk = lines.walk(x)
        squares = self._distances.at(walk.points)
        weights = self.weights / sigma**2
        slopes = partial(self._slopes, lines, walk, weights / 2)
        return LandmarkMisfit(float(weights @ squares / 2), _roots(squares), slopes)

    def curvature(self, x: FloatArray, tau: float, sigma: float) -> LandmarkCurvature:
        """Return how the energy bends at fields, but for how the flow itself bends."""
        lines = self._lines(tau)
        walk = lines.walk(x)
        away = self._distances.slopes(walk.points).ravel() / 2
        return LandmarkCurvature(lines.jacobian(walk), np.repeat(self.weights / sigma**2, 2), away)

    def errors(self, points: SurfacePoints) -> FloatArray:
        """Return how far points (L,) are along the surface from where they are wanted, (L,)."""
        return _roots(self._distances.at(points))

    def errors_along(self, mesh: TriangleMesh, velocity: FloatArray, tau: float) -> FloatArray:
        """Return how far the flow lines of fields (N, 4^k F, 3) leave the landmarks, (L,), which
        every residual and report uses; infinite if they cross too many faces.

        The mesh may be the same in another unit, which is then that of the fields. The objective
        has steps of its own, which it can differentiate, and its errors differ by theirs.
        """
        try:
            flow = ContinuousFlow(mesh, velocity, tau)
        except ParameterError:
            return np.full(len(self), np.inf)
        return self.errors(flow.destinations(self.points(mesh)))

    @cached_property
    def initial_errors(self) -> FloatArray:
        """How far the landmarks themselves are from where they are wanted, (L,)."""
        return self.errors(self.points())

    def restricted(self, coarse: TriangleMesh) -> Landmarks:
        """Return the landmarks on a coarser mesh of the same surface, in the same units."""
        faces, barycentric = self.faces.copy(), self.barycentric.copy()
        for k, points in enumerate((self.points(), self.targets())):
            found = project_onto_surface(coarse, points.positions)
            faces[:, k], barycentric[:, k] = found.faces, found.barycentric
        return Landmarks(coarse.normalized(), faces, barycentric, self.weights)

    def subdivided(self, fine: TriangleMesh) -> Landmarks:
        """Return the same landmarks on the midpoint subdivision of their mesh, of unit area."""
        faces, barycentric = to_children(self.faces.ravel(), self.barycentric.reshape(-1, 3))
        return Landmarks(fine, faces.reshape(-1, 2), barycentric.reshape(-1, 2, 3), self.weights)

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Return everything that it is made of but the mesh, for files and digests."""
        return {
            "landmark_faces": self.faces,
            "landmark_barycentric": self.barycentric,
            "landmark_weights": self.weights,
        }

    @cached_property
    def _distances(self) -> SquaredDistances:
        return SquaredDistances(self.targets())

    def _lines(self, tau: float) -> FlowLineDerivative:
        known: FlowLineDerivative | None = self.__dict__.get("_latest")
        if known is None or known.tau != tau:
            known = self.__dict__["_latest"] = FlowLineDerivative(self.points(), tau)
        return known

    def _slopes(self, lines: FlowLineDerivative, walk: Walk, weights: FloatArray) -> FloatArray:
        return lines.gradient(walk, weights[:, None] * self._distances.slopes(walk.points))


def landmarks_of(
    mesh: TriangleMesh, given: Any, weights: ArrayLike | None, as_file: bool = False
) -> Landmarks | None:
    """Check landmarks as users give them: vertices (L, 2), from and to, or two SurfacePoints; or
    None.

    Vertices are rows of the mesh, or numbers ``as_file``, which also counts those without faces.

    Raises
    ------
    ParameterError
        If they do not fit the mesh, or each other.
    """
    if given is None:
        if weights is not None:
            raise ParameterError("landmark_weights without landmarks: give both")
        return None
    unit = mesh.normalized()
    if isinstance(given, tuple | list) and any(isinstance(p, SurfacePoints) for p in given):
        pair = [_on_mesh(mesh, points) for points in given]
        if len(pair) != 2 or len(pair[0].faces) != len(pair[1].faces):
            counts = " and ".join(str(len(points.faces)) for points in pair)
            raise ParameterError(
                f"landmarks are {counts} points; expected a pair of as many SurfacePoints each"
            )
    else:
        vertices = real_numbers(given, "landmarks", ParameterError)
        if vertices.ndim != 2 or vertices.shape[1] != 2:
            raise ParameterError(
                f"landmarks have shape {vertices.shape}; expected (L, 2) vertices, from and to, "
                "or a pair of SurfacePoints"
            )
        count = len(mesh.vertices)
        rows = mesh.local_vertices(vertices) if as_file else vertices
        wrong = vertices[~np.isin(rows, np.arange(count))]
        if wrong.size:
            most = (mesh.file_vertex_count if as_file else count) - 1
            raise ParameterError(
                f"landmarks name vertex {wrong[0]:g}; expected vertices 0 to {most} that are in "
                "a face"
            )
        pair = [vertex_points(mesh, column) for column in rows.astype(np.int64).T]
    size = len(pair[0].faces)
    if not size:
        raise ParameterError("landmarks are empty; give one pair at least, or None")
    heavy = checked_weights(weights, size, "landmark_weights", "landmark")
    faces = np.stack([points.faces for points in pair], axis=1)
    return Landmarks(unit, faces, np.stack([p.barycentric for p in pair], axis=1), heavy)


def residual_of_errors(errors: FloatArray) -> float:
    """Return the largest of errors (L,) in the scale of residuals: `MATCHED_ERROR` as the usual
    goal.
    """
    return float(errors.max()) * (_USUAL_GOAL / MATCHED_ERROR)


def error_of(residual: float) -> float:
    """Return the error that has such a residual, of sqrt(area)."""
    return residual * (MATCHED_ERROR / _USUAL_GOAL)


def _on_mesh(mesh: TriangleMesh, points: Any) -> SurfacePoints:
    if not isinstance(points, SurfacePoints):
        raise ParameterError(f"landmarks have {brief(points)}; expected a pair of SurfacePoints")
    if not np.array_equal(points.mesh.faces, mesh.faces):
        raise ParameterError(
            f"landmarks are on a mesh of {len(points.mesh.faces)} faces; expected points of the "
            f"problem's own mesh, of {len(mesh.faces)}"
        )
    return points


def _roots(squares: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.maximum(squares, 0)))
