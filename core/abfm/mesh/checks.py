"""What a mesh must be before anything is computed on it, and the repairs that are safe."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import MeshError, one_line
from abfm.mesh.orientation import faces_to_flip
from abfm.mesh.topology import (
    corner_fans,
    edge_slots,
    edges_of_faces,
    pinched_vertices,
    vertex_components,
)
from abfm.types import BoolArray, FloatArray, IntArray

SMALLEST, LARGEST = 1e-60, 1e60  # squared areas of such sizes neither underflow nor overflow
FLATNESS = 1e-12  # height over longest edge at which a face has no usable gradient
# height over distance from the origin at which it is a matter of rounding
ROUNDING = 4 * np.finfo(np.float64).eps
# distance from the origin over width, from which on rounding takes more than 2e-9 of the width
FAR = 1e7
# faces whose corners are looked at together, as many as the processor's caches hold
AT_A_TIME = 1 << 15
CLEANING = "in MeshLab for example with Filters > Cleaning and Repairing"


@dataclass(frozen=True)
class Draft:
    """A mesh on its way through the checks, with the rows of the input that its vertices and
    faces came from.
    """

    vertices: FloatArray
    faces: IntArray
    vertex_ids: IntArray
    face_ids: IntArray
    input_vertex_count: int
    messages: tuple[str, ...] = ()

    def noting(self, message: str) -> Draft:
        return replace(self, messages=(*self.messages, message))

    def without_unreferenced_vertices(self) -> Draft:
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces] = True
        renumbered = np.cumsum(used) - 1
        return replace(
            self,
            vertices=self.vertices[used],
            faces=renumbered[self.faces],
            vertex_ids=self.vertex_ids[used],
        )

    def corners(self, face: int) -> str:
        """Return the vertices of a face, as the input counts."""
        return ", ".join(str(vertex) for vertex in self.vertex_ids[self.faces[face]])


class Connectivity(NamedTuple):
    """See :mod:`abfm.mesh.topology`."""

    edges: IntArray
    face_edges: IntArray
    edge_slots: IntArray
    corner_fans: IntArray


def check(
    vertices: ArrayLike,
    faces: ArrayLike,
    largest_component: bool,
    numbers: tuple[IntArray, int] | None = None,
) -> tuple[Draft, Connectivity]:
    """Refuse, repair or accept a mesh; see :class:`abfm.mesh.TriangleMesh` for the rules."""
    draft = _drop_unreferenced(_draft(vertices, faces, numbers))
    _refuse_unusable_coordinates(draft)
    draft = _one_component(draft, largest_component)
    _refuse_degenerate_faces(draft)
    draft = _note_distance(draft)
    _refuse_more_faces_than_edges_allow(draft)
    edges, face_edges = edges_of_faces(draft.faces, len(draft.vertices))
    _refuse_duplicate_faces(draft, face_edges)
    _refuse_non_manifold_edges(draft, edges, face_edges)
    slots = edge_slots(face_edges, len(edges))
    flip = faces_to_flip(draft.vertices, draft.faces, draft.face_ids, slots)
    if flip.any():
        draft = replace(draft, faces=_flipped(draft.faces, flip))
        draft = draft.noting(
            f"{_count(flip.sum(), 'face was', 'faces were')} turned over so that all agree on a "
            f"side (for example face {draft.face_ids[np.argmax(flip)]})"
        )
        face_edges = _flipped(face_edges, flip)
        slots = edge_slots(face_edges, len(edges))
    fans = corner_fans(slots, len(draft.faces))
    pinched = pinched_vertices(draft.faces, fans, len(draft.vertices))
    if pinched.any():
        draft = draft.noting(
            f"warning: {_count(pinched.sum(), 'vertex is', 'vertices are')} pinched, joining "
            "parts that share no edge "
            f"(for example vertex {draft.vertex_ids[np.argmax(pinched)]}): nothing flows across it"
        )
    return draft, Connectivity(edges, face_edges, slots, fans)


def twice_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute twice the area of every face, (F,)."""
    found = np.empty(len(faces))
    for start in range(0, len(faces), AT_A_TIME):
        a, b, c = _corners(vertices, faces[start : start + AT_A_TIME])
        found[start : start + AT_A_TIME] = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return found


def flat_faces(vertices: FloatArray, faces: IntArray) -> BoolArray:
    """Compute the faces (F,) so flat that gradients on them would be noise: what counts as a face
    without area.

    The height over the longest edge is at most 1e-12 of that edge, or what rounding does to the
    coordinates: 9e-16 of how far the face reaches from the origin. That is the same in every unit
    of length and after every rotation.
    """
    distances = np.sqrt(_squares(vertices))
    found = np.empty(len(faces), dtype=bool)
    for start in range(0, len(faces), AT_A_TIME):
        some = slice(start, start + AT_A_TIME)
        a, b, c = _corners(vertices, faces[some])
        sides = [b - a, c - b, a - c]
        twice = np.sqrt(_squares(np.cross(sides[0], sides[2])))
        longest = np.sqrt(np.maximum.reduce([_squares(side) for side in sides]))
        reach = distances.take(faces[some].T).max(axis=0)
        found[some] = ~(twice > (FLATNESS * longest + ROUNDING * reach) * longest)
    return found


def _draft(vertices: ArrayLike, faces: ArrayLike, numbers: tuple[IntArray, int] | None) -> Draft:
    """Return the copies of the input, if they are of the right shapes and types."""
    points = np.array(
        _number_array(vertices, "vertices", "(V, 3), coordinates as numbers"), dtype=np.float64
    )
    triangles = _face_array(faces, len(points))
    vertex_ids, count = numbers or (np.arange(len(points)), len(points))
    return Draft(points, triangles, vertex_ids, np.arange(len(triangles)), count)


def _count(number: int | np.integer[Any], one: str, many: str) -> str:
    return f"1 {one}" if number == 1 else f"{number} {many}"


def _flipped(corner_values: IntArray, flip: BoolArray) -> IntArray:
    return np.where(flip[:, None], corner_values[:, [0, 2, 1]], corner_values)


def _number_array(rows: ArrayLike, name: str, meaning: str) -> NDArray[Any]:
    """Return the rows of three real numbers, or a MeshError."""
    try:
        array = np.asarray(rows)
    except ValueError as error:
        raise MeshError(
            f"the rows of {name} differ in length: give an array of shape {meaning}"
        ) from error
    if array.size == 0:
        raise MeshError(
            f"the mesh has no {name}: a surface of vertices and triangles is needed (not a point "
            "cloud)"
        )
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iuf":
        raise MeshError(
            f"{name} has shape {array.shape} and type {one_line(array.dtype, 40)}: give an array "
            f"of shape {meaning}"
        )
    return array


def _face_array(faces: ArrayLike, vertex_count: int) -> IntArray:
    array = _number_array(
        faces, "faces", "(F, 3), vertex indices counted from 0 (split larger polygons)"
    )
    fractional = (
        np.any(array != np.floor(array), axis=1)
        if array.dtype.kind == "f"
        else np.zeros(0, dtype=bool)
    )
    if fractional.any():
        face = np.argmax(fractional)
        raise MeshError(
            f"{_count(fractional.sum(), 'face has', 'faces have')} indices that are no whole "
            f"numbers (face {face}: {array[face].tolist()}): give vertex indices counted from 0"
        )
    outside = (array < 0) | (array >= vertex_count)
    if outside.any():
        face, corner = np.argwhere(outside)[0]
        named = one_line(f"{array[face, corner]:.0f}", 40)
        raise MeshError(
            f"{_count(outside.any(axis=1).sum(), 'face names', 'faces name')} a vertex that does "
            f"not exist (face {face}, counting from 0, names vertex {named} of {vertex_count} "
            "numbered from 0): correct the indices, or complete the vertices"
        )
    return array.astype(np.int64)


def _corners(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return where the corners of faces are, (3, F, 3)."""
    return np.moveaxis(vertices.take(faces, axis=0), 1, 0)  # several times as fast as by index


def _squares(vectors: FloatArray) -> FloatArray:
    """Compute squared lengths of rows, (n,)."""
    found: FloatArray = np.einsum("nx,nx->n", vectors, vectors)
    return found


def _drop_unreferenced(draft: Draft) -> Draft:
    kept = draft.without_unreferenced_vertices()
    dropped = draft.input_vertex_count - len(kept.vertices)
    if dropped == 0:
        return draft
    gaps = np.flatnonzero(kept.vertex_ids != np.arange(len(kept.vertices)))
    return kept.noting(
        f"{_count(dropped, 'vertex that no face uses was', 'vertices that no face uses were')} "
        f"dropped (for example vertex {gaps[0] if len(gaps) else len(kept.vertices)})"
    )


def _refuse_unusable_coordinates(draft: Draft) -> None:
    bad = ~np.isfinite(draft.vertices).all(axis=1)
    if bad.any():
        vertex = np.argmax(bad)
        raise MeshError(
            f"{_count(bad.sum(), 'vertex has', 'vertices have')} coordinates that are not finite "
            f"(vertex {draft.vertex_ids[vertex]}, counting from 0: "
            f"{draft.vertices[vertex].tolist()}): correct or remove them"
        )
    reach = np.abs(draft.vertices).max()
    size = (draft.vertices.max(axis=0) - draft.vertices.min(axis=0)).max()
    if reach > LARGEST or 0 < size < SMALLEST:
        vertex = np.abs(draft.vertices).max(axis=1).argmax()
        raise MeshError(
            f"the mesh is {size:.3g} wide and reaches {reach:.3g} (vertex "
            f"{draft.vertex_ids[vertex]}), where areas "
            f"over- or underflow: rescale it to between {SMALLEST:g} and {LARGEST:g}"
        )


def _note_distance(draft: Draft) -> Draft:
    """Say where coordinates are so large that they leave few digits to the shape itself."""
    reach, low, high = (
        np.abs(draft.vertices).max(),
        draft.vertices.min(axis=0),
        draft.vertices.max(axis=0),
    )
    ratio = reach / (high - low).max()
    if ratio < FAR:
        return draft
    return draft.noting(
        f"warning: the surface lies {ratio:.1g} times its width from the origin, where rounding "
        f"moves its vertices by {np.finfo(np.float64).eps * ratio:.0g} of its width: move it to "
        "the origin in the program that made it"
    )


def _one_component(draft: Draft, largest_component: bool) -> Draft:
    component = vertex_components(draft.faces, len(draft.vertices))[draft.faces[:, 0]]
    count = component.max() + 1
    if count == 1:
        return draft
    largest = component == np.argmax(
        np.bincount(component, twice_areas(draft.vertices, draft.faces))
    )
    if not largest_component:
        stray = np.argmin(largest)
        repeated = len(draft.vertices) - len(np.unique(draft.vertices, axis=0))
        seams = (
            f"; {repeated} vertices repeat the position of another, so merging them may join it"
            if repeated
            else ""
        )
        raise MeshError(
            f"the surface has {count} components that do not touch (the largest has "
            f"{largest.sum()} of {len(largest)} faces; face {draft.face_ids[stray]}, counting from "
            f"0, is outside it){seams}: keep only the largest with --largest-component (in Python: "
            "largest_component=True), or join them"
        )
    kept = replace(
        draft, faces=draft.faces[largest], face_ids=draft.face_ids[largest]
    ).without_unreferenced_vertices()
    return kept.noting(
        f"kept the largest of {count} components: {len(kept.vertices)} of {len(draft.vertices)} "
        f"vertices, {len(kept.faces)} of {len(draft.faces)} faces"
    )


def _refuse_degenerate_faces(draft: Draft) -> None:
    a, b, c = draft.faces.T
    _refuse_faces(draft, (a == b) | (b == c) | (c == a), "a vertex twice", "remove")
    flat = flat_faces(draft.vertices, draft.faces)
    _refuse_faces(draft, flat, "no area, up to rounding", "remove or collapse")


def _refuse_faces(draft: Draft, bad: BoolArray, defect: str, remedy: str) -> None:
    if bad.any():
        face = int(np.argmax(bad))
        raise MeshError(
            f"{_count(bad.sum(), 'face is', 'faces are')} degenerate: {defect} (face "
            f"{draft.face_ids[face]}, counting from 0: vertices {draft.corners(face)}): {remedy} "
            f"them, {CLEANING}"
        )


def _refuse_duplicate_faces(draft: Draft, face_edges: IntArray) -> None:
    a, b, c = face_edges.T
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    # two edges of a triangle tell its vertices
    keys = least * (face_edges.max() + 1) + (a + b + c - least - most)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    again = np.append(False, keys[1:] == keys[:-1])
    if again.any():
        position = np.argmax(again)
        first, second = np.sort(draft.face_ids[order[position - 1 : position + 1]])
        raise MeshError(
            f"{_count(again.sum(), 'face repeats', 'faces repeat')} the vertices of another (faces "
            f"{first} and {second}, counting from 0: vertices {draft.corners(order[position])}): "
            f"remove the copies, {CLEANING}"
        )


def _refuse_more_faces_than_edges_allow(draft: Draft) -> None:
    """Refuse what no surface has before its edges, which may be many more than its vertices, are
    looked for.
    """
    vertices, faces = len(draft.vertices), len(draft.faces)
    if 3 * faces > vertices * (vertices - 1):
        raise MeshError(
            f"{faces} faces on {vertices} vertices have more sides than there are pairs of "
            "vertices, twice each: "
            f"faces repeat or edges have more than two faces; remove the extra ones, {CLEANING}"
        )


def _refuse_non_manifold_edges(draft: Draft, edges: IntArray, face_edges: IntArray) -> None:
    uses = np.bincount(face_edges.ravel())
    if uses.max() > 2:
        edge = np.argmax(uses > 2)
        start, end = draft.vertex_ids[edges[edge]]
        faces = draft.face_ids[np.flatnonzero((face_edges == edge).any(axis=1))]
        raise MeshError(
            f"{_count(int(np.sum(uses > 2)), 'edge has', 'edges have')} more than two faces "
            f"(vertices {start} and {end}, counting from 0: faces "
            f"{', '.join(map(str, faces[:4]))}): remove the extra sheets, {CLEANING}"
        )
