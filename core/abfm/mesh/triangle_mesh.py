"""A triangle mesh that has been checked once and never changes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, wraps
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Result = TypeVar("Result")


def per_mesh(build: Callable[[TriangleMesh], Result]) -> Callable[[TriangleMesh], Result]:
    """Decorate ``build(mesh)`` so that its result is made once per mesh and kept with it."""

    @wraps(build)
    def cached(mesh: TriangleMesh) -> Result:
        key = (build.__module__, build.__qualname__)
        if key not in mesh.cache:
            mesh.cache[key] = build(mesh)
        return mesh.cache[key]  # type: ignore[no-any-return]

    return cached


class TriangleMesh:
    """An oriented, connected, edge-manifold triangle mesh, with or without boundary.

    Parameters
    ----------
    vertices : (V, 3) array of float
    faces : (F, 3) array of int
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        self.vertices: FloatArray = np.array(vertices, dtype=np.float64)
        self.faces: IntArray = np.array(faces, dtype=np.int64)
        self.vertex_ids: IntArray = np.arange(len(self.vertices))
        self.file_vertex_count = len(self.vertices)
        self.messages: tuple[str, ...] = ()
        self.cache: dict[Any, Any] = {}

    @cached_property
    def length_scale(self) -> float:
        """Square root of the total area: the length unit of the solver."""
        corners = self.vertices[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return float(np.sqrt(0.5 * np.linalg.norm(normals, axis=1).sum()))

    def normalized(self) -> TriangleMesh:
        """The same mesh scaled to unit area (made once)."""
        return _normalized(self)

    @cached_property
    def _edge_data(self) -> tuple[IntArray, IntArray]:
        f = self.faces
        half = np.stack([f[:, [1, 2]], f[:, [2, 0]], f[:, [0, 1]]], axis=1).reshape(-1, 2)
        edges, inverse = np.unique(np.sort(half, axis=1), axis=0, return_inverse=True)
        return edges, inverse.reshape(-1, 3)

    @property
    def edges(self) -> IntArray:
        """(E, 2) vertex pairs, smaller index first."""
        return self._edge_data[0]

    @property
    def face_edges(self) -> IntArray:
        """(F, 3) index of the edge opposite each corner."""
        return self._edge_data[1]

    @cached_property
    def is_boundary_edge(self) -> BoolArray:
        """(E,) True where an edge has one face."""
        return np.bincount(self.face_edges.ravel(), minlength=len(self.edges)) == 1

    @cached_property
    def is_boundary_vertex(self) -> BoolArray:
        """(V,) True where a vertex lies on the boundary."""
        mask = np.zeros(len(self.vertices), dtype=bool)
        mask[self.edges[self.is_boundary_edge].ravel()] = True
        return mask


@per_mesh
def _normalized(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices / mesh.length_scale, mesh.faces)
