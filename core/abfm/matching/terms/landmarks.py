"""Landmarks: points that the map of the flow should take to target points."""

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
"""Largest error of matched landmarks with the default goal, as a fraction of sqrt(area)."""
_USUAL_GOAL = 0.05


class LandmarkMisfit(NamedTuple):
    """The landmark term of the energy at given fields."""

    energy: float
    errors: FloatArray  # (L,), errors of `Landmarks.errors`
    differentiate: Callable[[], FloatArray]  # the derivative by the fields, (N, F, 2)


class LandmarkCurvature(NamedTuple):
    """Factors of the derivatives of the landmark term, ``J^T D r`` and (second) ``J^T D J``.

    The second derivative is an approximation.
    """

    jacobian: sparse.csr_array  # (2 L, N F 2), J: derivative of the landmarks' ends by the fields
    weights: FloatArray  # (2 L,), diagonal matrix D
    residuals: FloatArray  # (2 L,), r, for each landmark a vector with the length of its error


class Landmarks:
    """Pairs of landmarks and target points on a mesh of unit area; immutable.

    ``faces`` (L, 2) and ``barycentric`` (L, 2, 3) define each landmark and its target. ``weights``
    are (L,).
    """

    name = "landmarks"

    def __init__(
        self, mesh: TriangleMesh, faces: IntArray, barycentric: FloatArray, weights: FloatArray
    ) -> None:
        self.mesh, self.faces, self.barycentric, self.weights = mesh, faces, barycentric, weights

    def __len__(self) -> int:
        return len(self.faces)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the mesh, which `Problem` sets again."""
        return {name: self.__dict__[name] for name in ("faces", "barycentric", "weights")}

    def points(self, mesh: TriangleMesh | None = None) -> SurfacePoints:
        """Return the landmarks as points; ``mesh`` may be their mesh in another length unit."""
        return SurfacePoints(mesh or self.mesh, self.faces[:, 0], self.barycentric[:, 0])

    def targets(self, mesh: TriangleMesh | None = None) -> SurfacePoints:
        """Return the targets as points; ``mesh`` may be their mesh in another length unit."""
        return SurfacePoints(mesh or self.mesh, self.faces[:, 1], self.barycentric[:, 1])

    def misfit(self, x: FloatArray, tau: float, sigma: float) -> LandmarkMisfit:
        """Return ``1/(2 sigma^2) sum_i w_i d(phi(p_i), q_i)^2`` and its derivative.

        The landmarks ``p_i`` have weights ``w_i`` and targets ``q_i``, and ``d`` is the distance
        along the surface. The map ``phi`` is the flow of fields (N, F, 2) to tau. Raise
        AdvectionError if flow lines cross too many faces.
        """
        lines = self._lines(tau)
        walk = lines.walk(x)
        squares = self._distances.at(walk.points)
        weights = self.weights / sigma**2
        slopes = partial(self._slopes, lines, walk, weights / 2)
        return LandmarkMisfit(float(weights @ squares / 2), _roots(squares), slopes)

    def curvature(self, x: FloatArray, tau: float, sigma: float) -> LandmarkCurvature:
        """Return factors of the derivatives of the landmark term at fields (N, F, 2).

        The second derivative of the flow is neglected.
        """
        lines = self._lines(tau)
        walk = lines.walk(x)
        away = self._distances.slopes(walk.points).ravel() / 2
        return LandmarkCurvature(lines.jacobian(walk), np.repeat(self.weights / sigma**2, 2), away)

    def errors(self, points: SurfacePoints) -> FloatArray:
        """Return the distances (L,) along the surface from points (L,) to the targets."""
        return _roots(self._distances.at(points))

    def errors_along(self, mesh: TriangleMesh, velocity: FloatArray, tau: float) -> FloatArray:
        """Return the errors (L,) of the landmarks along flow lines of fields (N, 4^k F, 3).

        The errors are infinite if flow lines cross too many faces. All residuals and reports use
        these errors. The objective has slightly different ones, as its flow lines have
        differentiable steps. ``mesh`` may be in another unit, which is then also the unit of the
        fields.
        """
        try:
            flow = ContinuousFlow(mesh, velocity, tau)
        except ParameterError:
            return np.full(len(self), np.inf)
        return self.errors(flow.destinations(self.points(mesh)))

    @cached_property
    def initial_errors(self) -> FloatArray:
        """The errors of the landmarks without motion, (L,)."""
        return self.errors(self.points())

    def restricted(self, coarse: TriangleMesh) -> Landmarks:
        """Return the landmarks on a coarser mesh of the same surface, in the same unit."""
        faces, barycentric = self.faces.copy(), self.barycentric.copy()
        for k, points in enumerate((self.points(), self.targets())):
            found = project_onto_surface(coarse, points.positions)
            faces[:, k], barycentric[:, k] = found.faces, found.barycentric
        return Landmarks(coarse.normalized(), faces, barycentric, self.weights)

    def subdivided(self, fine: TriangleMesh) -> Landmarks:
        """Return the landmarks on the midpoint subdivision of their mesh, of unit area."""
        faces, barycentric = to_children(self.faces.ravel(), self.barycentric.reshape(-1, 3))
        return Landmarks(fine, faces.reshape(-1, 2), barycentric.reshape(-1, 2, 3), self.weights)

    def arrays(self) -> Mapping[str, NDArray[Any]]:
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
    """Return landmarks from the input of a user; None for None.

    The input has vertices (L, 2), or is a pair of SurfacePoints. Vertices are rows of the mesh or,
    if ``as_file``, numbers of the file, which also counts vertices without faces.
    """
    if given is None:
        if weights is not None:
            raise ParameterError("landmark_weights have no landmarks; give landmarks as well")
        return None
    unit = mesh.normalized()
    if isinstance(given, tuple | list) and any(isinstance(p, SurfacePoints) for p in given):
        pair = [_on_mesh(mesh, points) for points in given]
        if len(pair) != 2 or len(pair[0].faces) != len(pair[1].faces):
            counts = " and ".join(str(len(points.faces)) for points in pair)
            raise ParameterError(
                f"landmarks have {counts} points; expected two SurfacePoints with equal numbers of "
                "points"
            )
    else:
        vertices = real_numbers(given, "landmarks", ParameterError)
        if vertices.ndim != 2 or vertices.shape[1] != 2:
            raise ParameterError(
                f"landmarks have shape {vertices.shape}; expected (L, 2), a vertex and a target in "
                "each row, or a pair of SurfacePoints"
            )
        count = len(mesh.vertices)
        rows = mesh.local_vertices(vertices) if as_file else vertices
        wrong = vertices[~np.isin(rows, np.arange(count))]
        if wrong.size:
            largest = (mesh.file_vertex_count if as_file else count) - 1
            raise ParameterError(
                f"landmarks contain vertex {wrong[0]:g}; expected vertices 0 to {largest} that "
                "belong to a face"
            )
        pair = [vertex_points(mesh, column) for column in rows.astype(np.int64).T]
    size = len(pair[0].faces)
    if not size:
        raise ParameterError("landmarks are empty; give at least one pair, or None")
    checked = checked_weights(weights, size, "landmark_weights", "landmark")
    faces = np.stack([points.faces for points in pair], axis=1)
    return Landmarks(unit, faces, np.stack([p.barycentric for p in pair], axis=1), checked)


def residual_of_errors(errors: FloatArray) -> float:
    """Convert the largest of landmark errors (L,) to a residual; see `MATCHED_ERROR`."""
    return float(errors.max()) * (_USUAL_GOAL / MATCHED_ERROR)


def error_of(residual: float) -> float:
    """Return the landmark error that corresponds to a residual, as a fraction of sqrt(area)."""
    return residual * (MATCHED_ERROR / _USUAL_GOAL)


def _on_mesh(mesh: TriangleMesh, points: Any) -> SurfacePoints:
    if not isinstance(points, SurfacePoints):
        raise ParameterError(f"landmarks contain {brief(points)}; expected a pair of SurfacePoints")
    if not np.array_equal(points.mesh.faces, mesh.faces):
        raise ParameterError(
            f"landmarks are on a mesh with {len(points.mesh.faces)} faces, but the problem has "
            f"{len(mesh.faces)}; use points of its mesh"
        )
    return points


def _roots(squares: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.maximum(squares, 0)))
