"""A mesh on its way through the checks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from abfm.types import BoolArray, FloatArray, IntArray

NO_COPIES = np.zeros((0, 2), dtype=np.int64)


class FileNumbers(NamedTuple):
    """How the vertices (V,) of a mesh are counted in its file; see `TriangleMesh`."""

    vertex_ids: IntArray
    file_vertex_count: int
    copies: IntArray = NO_COPIES


@dataclass(repr=False)
class Draft:
    """A mesh on its way through the checks; what it has is what a `TriangleMesh` has then."""

    vertices: FloatArray
    faces: IntArray
    vertex_ids: IntArray
    face_ids: IntArray
    file_vertex_count: int
    copies: IntArray
    messages: list[str]
    kept: str = ""
    """How many of the vertices and faces were kept, in words."""
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

    def keep(self, kept: BoolArray) -> None:
        """Keep some faces (F,), and the vertices that these use."""
        self.faces, self.face_ids = self.faces[kept], self.face_ids[kept]
        self.drop_unreferenced_vertices()

    def join(self, labels: IntArray) -> IntArray:
        """Make the vertices with the same label (V,) one, the first of them; labels rise in order
        of first appearance. Return the file's numbers of those that are gone and of what they
        became, (n, 2).
        """
        first = np.unique(labels, return_index=True)[1]
        gone = np.delete(np.arange(len(labels)), first)
        pairs = self.vertex_ids[np.stack([gone, first[labels[gone]]], axis=1)]
        became = np.arange(self.file_vertex_count)
        became[pairs[:, 0]] = pairs[:, 1]
        earlier = np.stack([self.copies[:, 0], became[self.copies[:, 1]]], axis=1)
        copies = np.concatenate([earlier, pairs])
        self.copies = copies[np.argsort(copies[:, 0])]
        self.vertices, self.vertex_ids = self.vertices[first], self.vertex_ids[first]
        self.faces = labels[self.faces]
        return pairs

    def has_vertex_twice(self) -> BoolArray:
        """Return the faces (F,) with fewer than three vertices."""
        a, b, c = self.faces.T
        return np.asarray((a == b) | (b == c) | (c == a))

    def corners(self, face: int | np.integer[Any]) -> str:
        """Return the vertices of a face, as the input counts."""
        return ", ".join(str(vertex) for vertex in self.vertex_ids[self.faces[face]])


def counted(number: int | np.integer[Any], one: str, many: str) -> str:
    """Return a number with the noun and verb that go with it."""
    return f"1 {one}" if number == 1 else f"{number} {many}"
