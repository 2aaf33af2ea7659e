"""Points of a surface, by the faces that hold them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.errors import AbfmError, ParameterError
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray, IntArray

_ROUNDING = 1e-9  # of barycentric weights


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """P points of a mesh.

    Attributes
    ----------
    mesh : TriangleMesh
    faces : (P,) array of int
        The face that holds each point.
    barycentric : (P, 3) array
        Weights of its corners, not negative, summing to 1.

    Raises
    ------
    ParameterError
        If these are not points of the mesh.
    """

    mesh: TriangleMesh
    faces: IntArray
    barycentric: FloatArray

    def __post_init__(self) -> None:
        faces = np.asarray(self.faces)
        weights = real_numbers(self.barycentric, "barycentric", ParameterError)
        if faces.ndim != 1 or faces.dtype.kind not in "iu" or weights.shape != (len(faces), 3):
            raise ParameterError(
                f"points have faces {faces.shape} of {faces.dtype} and barycentric "
                f"{weights.shape}; expected (P,) whole numbers and (P, 3)"
            )
        last = len(self.mesh.faces) - 1
        if len(faces) and not (faces.min() >= 0 and faces.max() <= last):
            raise ParameterError(
                f"points have faces {faces.min()} to {faces.max()}; expected 0 to {last}"
            )
        off = np.abs(weights.sum(axis=1) - 1)
        if not ((weights >= -_ROUNDING).all() and (off <= _ROUNDING).all()):
            raise ParameterError(
                "points have barycentric weights that are negative or do not sum to 1: give "
                "points of faces"
            )
        object.__setattr__(self, "faces", faces.astype(np.int64, copy=False))
        object.__setattr__(self, "barycentric", weights)

    @cached_property
    def positions(self) -> FloatArray:
        """The points in space, (P, 3), in the mesh's units."""
        corners = self.mesh.vertices[self.mesh.faces[self.faces]]
        return np.asarray(np.einsum("pc,pcx->px", self.barycentric, corners))

    def __getitem__(self, rows: IntArray) -> SurfacePoints:
        """Return some of the points."""
        return SurfacePoints(self.mesh, self.faces[rows], self.barycentric[rows])

    def pull_back(self, h: ArrayLike) -> FloatArray:
        """Evaluate a vertex function (V,) or (V, C) at the points, linear inside each face, (P,) or
        (P, C).

        Raises
        ------
        FunctionError
            If ``h`` does not fit the mesh.
        """
        at_corners = channels(self.mesh, h, "h")[:, self.mesh.faces[self.faces]]
        values: FloatArray = np.einsum("pc,kpc->pk", self.barycentric, at_corners)
        return values.reshape(-1, *np.shape(h)[1:])

    def nearest_vertices(self) -> IntArray:
        """Round each point to the nearest corner of its face, (P,).

        Only the face's own corners are considered, so that a point on one side of a thin part stays
        on that side.
        """
        corners = self.mesh.faces[self.faces]
        squared = ((self.mesh.vertices[corners] - self.positions[:, None]) ** 2).sum(axis=2)
        return np.take_along_axis(corners, squared.argmin(axis=1)[:, None], axis=1)[:, 0]

    def distances_from(self, places: FloatArray) -> FloatArray:
        """Return how far each point is from its own place in space (P, 3), (P,)."""
        return np.asarray(np.linalg.norm(places - self.positions, axis=1))


def vertex_points(mesh: TriangleMesh, vertices: ArrayLike | None = None) -> SurfacePoints:
    """Return vertices (P,), by index, as points of the surface; all of them by default.

    Raises
    ------
    AbfmError
        If an index is not a whole number or not among the mesh's own vertices.
    """
    count = len(mesh.vertices)
    given = np.arange(count) if vertices is None else np.asarray(vertices)
    if given.ndim != 1 or given.dtype.kind not in "iu":
        raise AbfmError(
            f"vertices have shape {given.shape} of {given.dtype}; expected (P,) whole numbers"
        )
    if len(given) and not 0 <= given.min() <= given.max() < count:
        raise AbfmError(f"vertices are {given.min()} to {given.max()}; expected 0 to {count - 1}")
    corner = np.empty(count, dtype=np.int64)
    corner[mesh.faces.ravel()] = np.arange(mesh.faces.size)
    faces, corners = np.divmod(corner[given], 3)
    return SurfacePoints(mesh, faces, np.eye(3)[corners])
