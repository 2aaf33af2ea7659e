"""What a mesh must be before anything is computed on it, and the repairs that are safe."""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import MeshError, one_line
from abfm.mesh import topology
from abfm.mesh.draft import Draft, FileNumbers, counted
from abfm.mesh.face_sizes import flat_faces
from abfm.mesh.options import MeshOptions
from abfm.mesh.repairs.cleaning import clean as clean_faces
from abfm.mesh.repairs.components import components, keep_hemisphere, keep_largest_component
from abfm.mesh.repairs.merging import merge_vertices
from abfm.mesh.repairs.remedies import FACES_MAX, DefectError, with_remedies
from abfm.mesh.topology import edges_of_faces
from abfm.numerics.real_numbers import plain_array
from abfm.types import BoolArray, IntArray

# squared areas of such sizes neither underflow nor overflow
SIZE_MIN = 1e-60
SIZE_MAX = 1e60
# distance from the origin over width, from which on rounding takes more than 2e-9 of the width
OFFSET_RATIO_MAX = 1e7
CLEANING = "in MeshLab for example with Filters > Cleaning and Repairing"


def check(
    vertices: ArrayLike,
    faces: ArrayLike,
    options: MeshOptions,
    given: FileNumbers | tuple[IntArray, int] | None,
) -> Draft:
    """Refuse, repair or accept a mesh; see :class:`abfm.mesh.TriangleMesh` for the rules."""
    meaning = "(V, 3), coordinates as numbers"
    points = np.array(_number_array(vertices, "vertices", meaning), dtype=np.float64)
    triangles = _face_array(faces, len(points))
    numbers = FileNumbers(*given) if given else FileNumbers(np.arange(len(points)), len(points))
    draft = Draft(
        points,
        triangles,
        numbers.vertex_ids,
        np.arange(len(triangles)),
        numbers.file_vertex_count,
        numbers.copies,
        [],
    )
    draft.drop_unreferenced_vertices()
    kept = len(draft.vertices)
    if dropped := draft.file_vertex_count - kept - len(draft.copies):
        gaps = np.flatnonzero(draft.vertex_ids != np.arange(kept))
        were = counted(dropped, "vertex that no face uses was", "vertices that no face uses were")
        draft.messages.append(
            f"{were} dropped (for example vertex {gaps[0] if len(gaps) else kept})"
        )
    _refuse_unusable_coordinates(draft)

    @cache
    def repaired(merge: bool | float | None, clean: bool) -> Draft:
        found = _copied(draft)
        if merge:
            merge_vertices(found, merge, clean)
        if clean:
            clean_faces(found)
        return found

    def attempt(options: MeshOptions) -> Draft:
        found = _copied(repaired(options.merge, options.clean))
        place = keep_hemisphere(found, options.hemisphere) if options.hemisphere else ""
        if options.largest_component:
            keep_largest_component(found)
        found.kept = (
            f"{len(found.vertices)} of {len(draft.vertices)} vertices and {len(found.faces)} of "
            f"{len(draft.faces)} faces{place}"
        )
        return _checked(found)

    try:
        return attempt(options)
    except DefectError as defect:
        if len(draft.faces) > FACES_MAX:
            raise MeshError(
                f"{defect.problem}: try --merge, --clean or --largest-component (in Python: "
                "merge=True, ...)"
            ) from None
        merged = None if options.merge else _merged(draft)
        joins = merged is not None and components(merged).max() < components(draft).max()
        raise with_remedies(defect, options, attempt, merged is not None, joins) from None


def _copied(draft: Draft) -> Draft:
    found = copy.copy(draft)
    found.messages = draft.messages.copy()
    return found


def _merged(draft: Draft) -> Draft | None:
    """Return the mesh with vertices at the same position merged; None if there are none, or if its
    components all lie on one of them, as the spheres of two hemispheres do.
    """
    found = _copied(draft)
    try:
        merge_vertices(found, True, False)
    except MeshError:
        return None
    component = components(draft)
    different = topology.equal_rows(np.sort(found.faces, axis=1))[0]
    alike = component.max() > 0 and np.ptp(component[different]) == 0
    return None if alike or len(found.vertices) == len(draft.vertices) else found


def _checked(draft: Draft) -> Draft:
    _refuse_several_components(draft)
    _refuse_faces(draft, draft.has_vertex_twice(), "a vertex twice", "remove")
    flat = flat_faces(draft.vertices, draft.faces)
    _refuse_faces(draft, flat, "no area, up to rounding", "remove or collapse")
    _note_distance(draft)
    vertex_count, face_count = len(draft.vertices), len(draft.faces)
    if 3 * face_count > vertex_count * (vertex_count - 1):
        # before edges, maybe many more than vertices, are looked for
        raise DefectError(
            f"{face_count} faces on {vertex_count} vertices have more sides than there are pairs "
            "of vertices, twice each: faces repeat or edges have more than two faces",
            f"remove the extra ones, {CLEANING}",
        )
    draft.edges, draft.face_edges = edges_of_faces(draft.faces, vertex_count)
    _refuse_duplicate_faces(draft)
    _refuse_non_manifold_edges(draft)
    _make_faces_agree(draft)
    draft.corner_fans = topology.corner_fans(draft.edge_slots, face_count)
    _note_seams(draft)
    pinched = topology.pinched_vertices(draft.faces, draft.corner_fans, vertex_count)
    if pinched.any():
        draft.messages.append(
            f"warning: {counted(pinched.sum(), 'vertex is', 'vertices are')} pinched, joining "
            "parts that share no edge "
            f"(for example vertex {draft.vertex_ids[np.argmax(pinched)]}): nothing flows across it"
        )
    return draft


def _note_seams(draft: Draft) -> None:
    """Warn of parts of the boundary at one position, where the surface only looks connected."""
    slots = draft.edge_slots[draft.edge_slots[:, 1] < 0, 0]
    rim = np.unique(draft.faces.ravel()[topology.next_corner(slots)])
    _, first = np.unique(draft.vertices[rim], axis=0, return_index=True)
    if repeats := len(rim) - len(first):
        example = draft.vertex_ids[np.delete(rim, first)[0]]
        draft.messages.append(
            f"warning: {counted(repeats, 'boundary vertex repeats', 'boundary vertices repeat')} "
            f"the position of another (for example vertex {example}), as at a seam: nothing flows "
            "across it; --merge joins it (in Python: merge=True)"
        )


def _refuse_several_components(draft: Draft) -> None:
    component = components(draft)
    count = component.max() + 1
    if count == 1:
        return
    sizes = np.bincount(component)
    stray = np.argmax(component != sizes.argmax())
    merged = _merged(draft)
    fewer = components(merged).max() + 1 if merged else count
    joined = f", {fewer} after merging vertices" if fewer < count else ""
    raise DefectError(
        f"the surface has {count} components that do not touch{joined} (the one with most faces "
        f"has {sizes.max()} of {len(component)}; face {draft.face_ids[stray]}, counting from 0, is "
        "outside it)",
        "join them, or give one of them",
    )


def _number_array(rows: ArrayLike, name: str, meaning: str) -> NDArray[Any]:
    """Return the rows of three real numbers, or a MeshError."""
    try:
        array = plain_array(rows)
    except (TypeError, RuntimeError) as error:
        raise MeshError(f"{name} are no array: {one_line(error, 80)}") from error
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
                f"{counted(fractional.sum(), 'face has', 'faces have')} indices that are no whole "
                f"numbers (face {face}: {array[face].tolist()}): give vertex indices counted from 0"
            )
    outside = (array < 0) | (array >= vertex_count)
    if outside.any():
        face, corner = np.argwhere(outside)[0]
        named = one_line(f"{array[face, corner]:.0f}", 40)
        advice = "correct the indices, or complete the vertices"
        if array.min() == 1 and array.max() == vertex_count:
            advice = "all indices count from 1; subtract 1"
        raise MeshError(
            f"{counted(outside.any(axis=1).sum(), 'face names', 'faces name')} a vertex that does "
            f"not exist (face {face}, counting from 0, names vertex {named} of {vertex_count} "
            f"numbered from 0): {advice}"
        )
    return array.astype(np.int64, copy=False)


def _refuse_unusable_coordinates(draft: Draft) -> None:
    bad = ~np.isfinite(draft.vertices).all(axis=1)
    if bad.any():
        vertex = np.argmax(bad)
        raise MeshError(
            f"{counted(bad.sum(), 'vertex has', 'vertices have')} coordinates that are not finite "
            f"(vertex {draft.vertex_ids[vertex]}, counting from 0: "
            f"{draft.vertices[vertex].tolist()}): correct or remove them"
        )
    reach, size = _reach_and_size(draft)
    if reach > SIZE_MAX or 0 < size < SIZE_MIN:
        vertex = np.abs(draft.vertices).max(axis=1).argmax()
        raise MeshError(
            f"the mesh is {size:.3g} wide and reaches {reach:.3g} (vertex "
            f"{draft.vertex_ids[vertex]}), where areas "
            f"over- or underflow: rescale it to between {SIZE_MIN:g} and {SIZE_MAX:g}"
        )


def _reach_and_size(draft: Draft) -> tuple[float, float]:
    """Return the largest coordinate and the largest width."""
    width = draft.vertices.max(axis=0) - draft.vertices.min(axis=0)
    return np.abs(draft.vertices).max(), width.max()


def _note_distance(draft: Draft) -> None:
    """Say where coordinates are so large that they leave few digits to the shape itself."""
    reach, size = _reach_and_size(draft)
    if reach / size >= OFFSET_RATIO_MAX:
        draft.messages.append(
            f"warning: the surface lies {reach / size:.1g} times its width from the origin, where "
            f"rounding moves its vertices by {np.finfo(np.float64).eps * (reach / size):.0g} of "
            "its width: move it to the origin in the program that made it"
        )


def _refuse_faces(draft: Draft, bad: BoolArray, defect: str, remedy: str) -> None:
    if bad.any():
        face = np.argmax(bad)
        raise DefectError(
            f"{counted(bad.sum(), 'face is', 'faces are')} degenerate: {defect} (face "
            f"{draft.face_ids[face]}, counting from 0: vertices {draft.corners(face)})",
            f"{remedy} them, {CLEANING}",
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
        raise DefectError(
            f"{counted(again.sum(), 'face repeats', 'faces repeat')} the vertices of another "
            f"(faces {first} and {second}, counting from 0: vertices "
            f"{draft.corners(order[position])})",
            f"remove the copies, {CLEANING}",
        )


def _refuse_non_manifold_edges(draft: Draft) -> None:
    uses = np.bincount(draft.face_edges.ravel())
    if uses.max() > 2:
        edge = np.argmax(uses > 2)
        start, end = draft.vertex_ids[draft.edges[edge]]
        faces = draft.face_ids[np.flatnonzero((draft.face_edges == edge).any(axis=1))]
        raise DefectError(
            f"{counted(int(np.sum(uses > 2)), 'edge has', 'edges have')} more than two faces "
            f"(vertices {start} and {end}, counting from 0: faces "
            f"{', '.join(map(str, faces[:4]))})",
            "remove some of their faces, in MeshLab for example with Repair non Manifold Edges "
            "(--clean only removes sheets that hang on a larger one)",
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
        raise DefectError(
            f"the surface is not orientable, like a Moebius strip ({one_sided.sum()} of "
            f"{count} faces lie on a one-sided piece, for example face "
            f"{draft.face_ids[np.argmax(one_sided)]}, counting from 0)",
            "cut it open",
        )
    flip, piece = turned < as_given, np.minimum(as_given, turned)
    flip = flip ^ _prefers_other_side(draft, flip, piece)[piece]
    if flip.any():
        for name in ("faces", "face_edges"):
            of_corners = getattr(draft, name)
            setattr(draft, name, np.where(flip[:, None], of_corners[:, [0, 2, 1]], of_corners))
        draft.edge_slots = topology.edge_slots(draft.face_edges, len(draft.edges))
        draft.messages.append(
            f"{counted(flip.sum(), 'face was', 'faces were')} turned over so that all agree on a "
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
