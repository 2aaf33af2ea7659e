"""A mesh while it is checked and repaired."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from abfm.types import BoolArray, FloatArray, IntArray

NO_COPIES = np.zeros((0, 2), dtype=np.int64)


class FileNumbers(NamedTuple):
    """Vertex numbers of a mesh in the file that it is read from, see `TriangleMesh`."""

    vertex_ids: IntArray
    file_vertex_count: int
    copies: IntArray = NO_COPIES


@dataclass(repr=False)
class Draft:
    """A mesh while it is checked and repaired; its attributes become those of `TriangleMesh`."""

    vertices: FloatArray
    faces: IntArray
    vertex_ids: IntArray
    face_ids: IntArray
    file_vertex_count: int
    copies: IntArray
    messages: list[str]
    has_flipped_faces: bool = False
    kept_counts: str = ""
    """Text with the numbers of vertices and faces that were kept, such as "5 of 6 vertices ..."."""
    edges: IntArray = field(init=False)
    face_edges: IntArray = field(init=False)
    edge_slots: IntArray = field(init=False)
    corner_fans: IntArray = field(init=False)

    def drop_unreferenced_vertices(self) -> None:
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces] = True
        self.vertices, self.vertex_ids = self.vertices[used], self.vertex_ids[used]
        self.faces = (np.cumsum(used) - 1)[self.faces]
        if len(self.copies):
            self.copies = self.copies[np.isin(self.copies[:, 1], self.vertex_ids)]

    def keep_faces(self, is_kept: BoolArray) -> None:
        """Keep the faces where ``is_kept`` (F,) is True, and the vertices that they use."""
        self.faces, self.face_ids = self.faces[is_kept], self.face_ids[is_kept]
        self.drop_unreferenced_vertices()

    def merge(self, labels: IntArray) -> IntArray:
        """Merge the vertices with the same label (V,) into the first of them.

        Labels increase in order of first appearance. Return pairs (n, 2) of numbers in the file: a
        merged vertex, and the vertex that it was merged into.
        """
        first = np.unique(labels, return_index=True)[1]
        merged = np.delete(np.arange(len(labels)), first)
        pairs = self.vertex_ids[np.stack([merged, first[labels[merged]]], axis=1)]
        became = np.arange(self.file_vertex_count)
        became[pairs[:, 0]] = pairs[:, 1]
        earlier = np.stack([self.copies[:, 0], became[self.copies[:, 1]]], axis=1)
        copies = np.concatenate([earlier, pairs])
        self.copies = copies[np.argsort(copies[:, 0])]
        self.vertices, self.vertex_ids = self.vertices[first], self.vertex_ids[first]
        self.faces = labels[self.faces]
        return pairs

    def has_vertex_twice(self) -> BoolArray:
        a, b, c = self.faces.T
        return np.asarray((a == b) | (b == c) | (c == a))

    def corners(self, face: int | np.integer[Any]) -> str:
        """Return a text with the vertices of a face, numbered as in the input."""
        return ", ".join(str(vertex) for vertex in self.vertex_ids[self.faces[face]])
