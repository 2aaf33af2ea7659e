"""What a mesh must be before anything is computed on it, and the repairs that are safe."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import MeshError, one_line
from abfm.mesh import topology
from abfm.mesh.topology import edges_of_faces
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


@dataclass
class Draft:
    """A mesh on its way through the checks; what it has is what a `TriangleMesh` has then."""

    vertices: FloatArray
    faces: IntArray
    vertex_ids: IntArray
    face_ids: IntArray
    file_vertex_count: int
    messages: list[str]
    edges: IntArray = field(init=False)
    face_edges: IntArray = field(init=False)
    edge_slots: IntArray = field(init=False)
    corner_fans: IntArray = field(init=False)

    def drop_unreferenced_vertices(self) -> None:
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces] = True
        self.vertices, self.vertex_ids = self.vertices[used], self.vertex_ids[used]
        self.faces = (np.cumsum(used) - 1)[self.faces]

    def corners(self, face: int | np.integer[Any]) -> str:
        """Return the vertices of a face, as the input counts."""
        return ", ".join(str(vertex) for vertex in self.vertex_ids[self.faces[face]])


def check(
    vertices: ArrayLike,
    faces: ArrayLike,
    largest_component: bool,
    numbers: tuple[IntArray, int] | None,
) -> Draft:
    """Refuse, repair or accept a mesh; see :class:`abfm.mesh.TriangleMesh` for the rules."""
    meaning = "(V, 3), coordinates as numbers"
    points = np.array(_number_array(vertices, "vertices", meaning), dtype=np.float64)
    triangles = _face_array(faces, len(points))
    vertex_ids, count = numbers or (np.arange(len(points)), len(points))
    draft = Draft(points, triangles, vertex_ids, np.arange(len(triangles)), count, [])
    draft.drop_unreferenced_vertices()
    kept = len(draft.vertices)
    if dropped := count - kept:
        gaps = np.flatnonzero(draft.vertex_ids != np.arange(kept))
        were = _count(dropped, "vertex that no face uses was", "vertices that no face uses were")
        draft.messages.append(
            f"{were} dropped (for example vertex {gaps[0] if len(gaps) else kept})"
        )
    _refuse_unusable_coordinates(draft)
    _make_one_component(draft, largest_component)
    a, b, c = draft.faces.T
    _refuse_faces(draft, (a == b) | (b == c) | (c == a), "a vertex twice", "remove")
    flat = flat_faces(draft.vertices, draft.faces)
    _refuse_faces(draft, flat, "no area, up to rounding", "remove or collapse")
    _note_distance(draft)
    vertex_count, face_count = len(draft.vertices), len(draft.faces)
    if 3 * face_count > vertex_count * (vertex_count - 1):
        # before edges, maybe many more than vertices, are looked for
        raise MeshError(
            f"{face_count} faces on {vertex_count} vertices have more sides than there are pairs "
            "of vertices, twice each: "
            f"faces repeat or edges have more than two faces; remove the extra ones, {CLEANING}"
        )
    draft.edges, draft.face_edges = edges_of_faces(draft.faces, vertex_count)
    _refuse_duplicate_faces(draft)
    _refuse_non_manifold_edges(draft)
    _make_faces_agree(draft)
    draft.corner_fans = topology.corner_fans(draft.edge_slots, face_count)
    pinched = topology.pinched_vertices(draft.faces, draft.corner_fans, vertex_count)
    if pinched.any():
        draft.messages.append(
            f"warning: {_count(pinched.sum(), 'vertex is', 'vertices are')} pinched, joining "
            "parts that share no edge "
            f"(for example vertex {draft.vertex_ids[np.argmax(pinched)]}): nothing flows across it"
        )
    return draft


def twice_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute twice the area of every face, (F,)."""
    found = np.empty(len(faces))
    for start in range(0, len(faces), AT_A_TIME):
        a, b, c = _corners(vertices, faces[start : start + AT_A_TIME])
        found[start : start + AT_A_TIME] = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return found


def flat_faces(vertices: FloatArray, faces: IntArray) -> BoolArray:
    """Compute the faces (F,) without area: so flat that gradients on them would be noise.

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


def _corners(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return where the corners of faces are, (3, F, 3)."""
    return np.moveaxis(vertices.take(faces, axis=0), 1, 0)  # several times as fast as by index


def _squares(vectors: FloatArray) -> FloatArray:
    """Compute squared lengths of rows, (n,)."""
    found: FloatArray = np.einsum("nx,nx->n", vectors, vectors)
    return found


def _count(number: int | np.integer[Any], one: str, many: str) -> str:
    return f"1 {one}" if number == 1 else f"{number} {many}"


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
    meaning = "(F, 3), vertex indices counted from 0 (split larger polygons)"
    array = _number_array(faces, "faces", meaning)
    if array.dtype.kind == "f":
        fractional = np.any(array != np.floor(array), axis=1)
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


def _refuse_unusable_coordinates(draft: Draft) -> None:
    bad = ~np.isfinite(draft.vertices).all(axis=1)
    if bad.any():
        vertex = np.argmax(bad)
        raise MeshError(
            f"{_count(bad.sum(), 'vertex has', 'vertices have')} coordinates that are not finite "
            f"(vertex {draft.vertex_ids[vertex]}, counting from 0: "
            f"{draft.vertices[vertex].tolist()}): correct or remove them"
        )
    reach, size = _reach_and_size(draft)
    if reach > LARGEST or 0 < size < SMALLEST:
        vertex = np.abs(draft.vertices).max(axis=1).argmax()
        raise MeshError(
            f"the mesh is {size:.3g} wide and reaches {reach:.3g} (vertex "
            f"{draft.vertex_ids[vertex]}), where areas "
            f"over- or underflow: rescale it to between {SMALLEST:g} and {LARGEST:g}"
        )


def _reach_and_size(draft: Draft) -> tuple[float, float]:
    """Return the largest coordinate and the largest width."""
    width = draft.vertices.max(axis=0) - draft.vertices.min(axis=0)
    return np.abs(draft.vertices).max(), width.max()


def _note_distance(draft: Draft) -> None:
    """Say where coordinates are so large that they leave few digits to the shape itself."""
    reach, size = _reach_and_size(draft)
    if reach / size >= FAR:
        draft.messages.append(
            f"warning: the surface lies {reach / size:.1g} times its width from the origin, where "
            f"rounding moves its vertices by {np.finfo(np.float64).eps * (reach / size):.0g} of "
            "its width: move it to the origin in the program that made it"
        )


def _make_one_component(draft: Draft, largest_component: bool) -> None:
    vertices, faces = draft.vertices, draft.faces
    sides = np.concatenate(
        [faces[:, :2], faces[:, 1:]]
    )  # faces that share a vertex belong together
    component = topology.connected(len(vertices), sides)[faces[:, 0]]
    count = component.max() + 1
    if count == 1:
        return
    largest = component == np.argmax(np.bincount(component, twice_areas(vertices, faces)))
    if not largest_component:
        stray = np.argmin(largest)
        repeated = len(vertices) - len(np.unique(vertices, axis=0))
        seams = f"; {repeated} vertices repeat the position of another, so merging them may join it"
        raise MeshError(
            f"the surface has {count} components that do not touch (the largest has "
            f"{largest.sum()} of {len(largest)} faces; face {draft.face_ids[stray]}, counting from "
            f"0, is outside it){seams if repeated else ''}: keep only the largest with "
            "--largest-component (in Python: largest_component=True), or join them"
        )
    draft.faces, draft.face_ids = faces[largest], draft.face_ids[largest]
    draft.drop_unreferenced_vertices()
    draft.messages.append(
        f"kept the largest of {count} components: {len(draft.vertices)} of {len(vertices)} "
        f"vertices, {len(draft.faces)} of {len(faces)} faces"
    )


def _refuse_faces(draft: Draft, bad: BoolArray, defect: str, remedy: str) -> None:
    if bad.any():
        face = np.argmax(bad)
        raise MeshError(
            f"{_count(bad.sum(), 'face is', 'faces are')} degenerate: {defect} (face "
            f"{draft.face_ids[face]}, counting from 0: vertices {draft.corners(face)}): {remedy} "
            f"them, {CLEANING}"
        )


def _refuse_duplicate_faces(draft: Draft) -> None:
    a, b, c = draft.face_edges.T
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    # two edges of a triangle tell its vertices
    keys = least * (draft.face_edges.max() + 1) + (a + b + c - least - most)
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


def _refuse_non_manifold_edges(draft: Draft) -> None:
    uses = np.bincount(draft.face_edges.ravel())
    if uses.max() > 2:
        edge = np.argmax(uses > 2)
        start, end = draft.vertex_ids[draft.edges[edge]]
        faces = draft.face_ids[np.flatnonzero((draft.face_edges == edge).any(axis=1))]
        raise MeshError(
            f"{_count(int(np.sum(uses > 2)), 'edge has', 'edges have')} more than two faces "
            f"(vertices {start} and {end}, counting from 0: faces "
            f"{', '.join(map(str, faces[:4]))}): remove the extra sheets, {CLEANING}"
        )


def _make_faces_agree(draft: Draft) -> None:
    """Turn faces over so that neighbours agree, or raise a MeshError if the surface is one-sided.

    Each piece joined through edges is settled by itself: a closed one ends with its normals
    outward, one with a boundary keeps the side that most of its faces have.
    """
    count = len(draft.faces)
    draft.edge_slots = topology.edge_slots(draft.face_edges, len(draft.edges))
    inner = draft.edge_slots[draft.edge_slots[:, 1] >= 0]
    start = draft.faces.ravel()[topology.next_corner(inner)]
    disagree = start[:, 0] == start[:, 1]
    if not disagree.any():
        return
    # components of the faces as given and of their turned copies in the orientation double cover
    f, g = inner.T // 3
    same = np.stack([f, g + count * disagree], axis=1)
    opposite = np.stack([f + count, g + count * ~disagree], axis=1)
    labels = topology.connected(2 * count, np.concatenate([same, opposite]))
    as_given, turned = labels[:count], labels[count:]
    one_sided = as_given == turned
    if one_sided.any():
        raise MeshError(
            f"the surface is not orientable, like a Moebius strip ({one_sided.sum()} of "
            f"{count} faces lie on a one-sided piece, for example face "
            f"{draft.face_ids[np.argmax(one_sided)]}, counting from 0): cut it open"
        )
    flip, piece = turned < as_given, np.minimum(as_given, turned)
    flip = flip ^ _prefers_other_side(draft, flip, piece)[piece]
    if flip.any():
        for name in ("faces", "face_edges"):
            of_corners = getattr(draft, name)
            setattr(draft, name, np.where(flip[:, None], of_corners[:, [0, 2, 1]], of_corners))
        draft.edge_slots = topology.edge_slots(draft.face_edges, len(draft.edges))
        draft.messages.append(
            f"{_count(flip.sum(), 'face was', 'faces were')} turned over so that all agree on a "
            f"side (for example face {draft.face_ids[np.argmax(flip)]})"
        )


def _prefers_other_side(draft: Draft, flip: BoolArray, piece: IntArray) -> BoolArray:
    """Return per piece label whether the flips proposed for it are the wrong one of two choices."""
    a, b, c = np.moveaxis((draft.vertices - draft.vertices.mean(axis=0))[draft.faces], 1, 0)
    volume = np.einsum("fx,fx->f", a, np.cross(b, c)) * np.where(flip, -1, 1)
    inward = np.bincount(piece, volume) < 0
    mostly_flipped = 2 * np.bincount(piece, flip) > np.bincount(piece)
    has_boundary = np.zeros(len(inward), dtype=bool)
    has_boundary[piece[draft.edge_slots[draft.edge_slots[:, 1] < 0, 0] // 3]] = True
    return np.where(has_boundary, mostly_flipped, inward)
