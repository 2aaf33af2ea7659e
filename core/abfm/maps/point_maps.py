"""Maps from the vertices of one surface to points of another."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from abfm.errors import AbfmError
from abfm.maps.distortion import Distortion, SurfaceMap, chord_distortion, distortion_of_flow
from abfm.maps.surface_points import (
    ClosestPoints,
    SurfacePoints,
    project_onto_surface,
    vertex_points,
)
from abfm.mesh import TriangleMesh
from abfm.mesh.face_sizes import twice_areas
from abfm.numerics.real_numbers import real_numbers
from abfm.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class PointMap:
    """A map from the vertices of one surface, the domain, to points of another, the codomain.

    Attributes
    ----------
    domain, codomain : TriangleMesh
    faces : (V,) array of int
        Face of the codomain with the image of each of the domain's V vertices.
    barycentric : (V, 3) array
        Weights of the corners of the face with the image of each vertex, not negative, with sum 1.
    distances : (V,) array, optional
        Distances of the images from the codomain before their projection onto it, in its units; by
        default 0.
    interior_map : callable, optional
        Function that takes points inside faces of the domain (`SurfacePoints`) and returns points
        of the codomain. By default, the images are interpolated between the images of corners.
    """

    domain: TriangleMesh
    codomain: TriangleMesh
    faces: IntArray
    barycentric: FloatArray
    distances: FloatArray = field(default_factory=lambda: np.zeros(1))
    interior_map: SurfaceMap | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        count = len(self.domain.vertices)
        if len(self.points.faces) != count:
            raise AbfmError(
                f"the map has {len(self.points.faces)} points, but the domain has {count} "
                "vertices; expected one point per vertex"
            )
        distances = real_numbers(self.distances, "distances", AbfmError)
        if distances.shape not in ((), (1,), (count,)):
            raise AbfmError(
                f"distances have shape {distances.shape}; expected ({count},), one per point"
            )
        object.__setattr__(self, "distances", np.broadcast_to(distances, count))

    @classmethod
    def of_vertices(
        cls, domain: TriangleMesh, codomain: TriangleMesh, vertices: ArrayLike | None = None
    ) -> PointMap:
        """Return the map from vertex i of the domain to vertex ``vertices[i]`` of the codomain.

        Without ``vertices`` (V,), vertex i is mapped to vertex i.
        """
        return cls.of_points(domain, vertex_points(codomain, vertices))

    @classmethod
    def of_points(
        cls,
        domain: TriangleMesh,
        points: SurfacePoints,
        interior_map: SurfaceMap | None = None,
        distances: FloatArray | None = None,
    ) -> PointMap:
        """Return the map from the vertices of the domain to ``points`` (V,) of the codomain."""
        off = np.zeros(1) if distances is None else distances
        return cls(domain, points.mesh, points.faces, points.barycentric, off, interior_map)

    @classmethod
    def project(
        cls, domain: TriangleMesh, codomain: TriangleMesh, positions: ArrayLike
    ) -> PointMap:
        """Return the map to the points of the codomain closest to positions (V, 3) in space."""
        points = project_onto_surface(codomain, positions)
        return cls.of_points(domain, points, None, points.distances_from(np.asarray(positions)))

    @cached_property
    def points(self) -> SurfacePoints:
        """The images of the vertices."""
        return SurfacePoints(self.codomain, self.faces, self.barycentric)

    @property
    def positions(self) -> FloatArray:
        """The images of the vertices in space, shape (V, 3), in the codomain's units."""
        return self.points.positions

    def pull_back(self, h: ArrayLike) -> FloatArray:
        """Transfer a function (V',) or (V', C) of the codomain to the domain, (V,) or (V, C)."""
        return self.points.pull_back(h)

    def nearest_vertices(self) -> IntArray:
        """Return, for each vertex, the corner nearest to its image in the image's face, (V,)."""
        return self.points.nearest_vertices()

    def to_matrix(self) -> sparse.csr_array:
        """Return `pull_back` as a matrix, shape (V, V')."""
        count, columns = len(self.faces), self.codomain.faces[self.faces].ravel()
        entries = self.barycentric.flatten(), columns, 3 * np.arange(count + 1)
        return sparse.csr_array(entries, shape=(count, len(self.codomain.vertices)))

    def at(self, points: SurfacePoints) -> SurfacePoints:
        """Return the images of points of the domain.

        Without an interior map, images are interpolated between the images of corners and projected
        onto the codomain.
        """
        if self.interior_map is None:
            return project_onto_surface(self.codomain, points.pull_back(self.positions))
        return self.interior_map(points)

    def followed_by(self, other: PointMap) -> PointMap:
        """Return the map that applies first this map and then ``other``.

        The domain of ``other`` is the codomain of this map.
        """
        if not np.array_equal(other.domain.faces, self.codomain.faces):
            raise AbfmError(
                f"cannot compose maps: the domain of the second map has "
                f"{len(other.domain.faces)} faces, which differ from the "
                f"{len(self.codomain.faces)} faces of the codomain of the first map"
            )
        images = other.at(self.points)
        return PointMap.of_points(self.domain, images, lambda points: other.at(self.at(points)))

    def onto_mirror(self) -> PointMap:
        """Return the same map onto the mirror image of the codomain, which has reversed faces."""
        surface, order = self.codomain, np.array([0, 2, 1])
        mirror = TriangleMesh(surface.vertices * [-1, 1, 1], surface.faces[:, order])

        def reflected(found: SurfacePoints) -> SurfacePoints:
            return SurfacePoints(mirror, found.faces, found.barycentric[:, order])

        original = self.interior_map
        interior_map = None if original is None else lambda given: reflected(original(given))
        return PointMap.of_points(self.domain, reflected(self.points), interior_map)

    def inverse(self) -> PointMap:
        """Return an approximate inverse: a map from the codomain to the domain, by closest images.

        Each vertex of the codomain is mapped to the point of the domain whose image is closest. In
        this search, the image of a face is the flat triangle between the images of its corners. The
        result is not an inverse where the map leaves gaps or covers the codomain twice; its
        ``distances`` measure the gaps.
        """
        if not (twice_areas(self.positions, self.domain.faces) > 0).any():
            raise AbfmError(
                "the map has no inverse, because it takes all points to one point or to a line"
            )
        vertices = self.codomain.vertices
        found = self._nearest_image(vertices)
        images = np.einsum(
            "pc,pcx->px", found.barycentric, self.positions[self.domain.faces[found.faces]]
        )
        distances = np.linalg.norm(vertices - images, axis=1)

        def interior_map(points: SurfacePoints) -> SurfacePoints:
            return self._nearest_image(points.positions)

        return PointMap.of_points(self.codomain, found, interior_map, distances)

    def _nearest_image(self, positions: FloatArray) -> SurfacePoints:
        return ClosestPoints(self.domain, self.positions).to(positions)

    def distortion(self) -> Distortion:
        """Measure the distortion of each face of the domain.

        Without an interior map, the distortion is measured by the images of corners, see
        `chord_distortion`. Otherwise faces whose mapped corners are misleading are measured in
        parts, see ``abfm.maps.distortion.distortion_of_flow``.
        """
        if self.interior_map is None:
            return chord_distortion(self.domain, self.positions, self.codomain)
        faces = self.domain.faces
        corners = self.points[faces.ravel()]
        return distortion_of_flow(self.domain, np.arange(len(faces)), corners, self.interior_map)
