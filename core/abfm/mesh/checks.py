"""Checks that every mesh must pass, and the repairs that are always safe."""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import MeshError, one_line
from abfm.mesh import topology
from abfm.mesh.draft import Draft, FileNumbers
from abfm.mesh.face_sizes import flat_faces
from abfm.mesh.options import MeshOptions
from abfm.mesh.repairs.cleaning import clean as clean_faces
from abfm.mesh.repairs.components import components, keep_hemisphere, keep_largest_component
from abfm.mesh.repairs.merging import merge_vertices
from abfm.mesh.repairs.remedies import FACES_MAX, DefectError, with_remedies
from abfm.mesh.topology import edges_of_faces
from abfm.numerics.real_numbers import plain_array
from abfm.types import BoolArray, IntArray
from abfm.wording import counted

# squared areas of meshes of these sizes neither underflow nor overflow
SIZE_MIN = 1e-60
SIZE_MAX = 1e60
# Distance from the origin over width. Above it, rounding errors of the coordinates exceed 2e-9 of
# the width.
OFFSET_RATIO_MAX = 1e7
CLEANING = "for example in MeshLab with Filters > Cleaning and Repairing"


def check(
    vertices: ArrayLike,
    faces: ArrayLike,
    options: MeshOptions,
    file_numbers: FileNumbers | tuple[IntArray, int] | None,
) -> Draft:
    """Check and repair a mesh; see :class:`abfm.mesh.TriangleMesh` for the rules.

    ``file_numbers`` are the numbers of the vertices in the file; None if they are 0, 1, 2, ...
    """
    meaning = "(V, 3) with numbers as coordinates"
    points = np.array(_number_array(vertices, "vertices", meaning), dtype=np.float64)
    triangles = _face_array(faces, len(points))
    by_row = FileNumbers(np.arange(len(points)), len(points))
    numbers = FileNumbers(*file_numbers) if file_numbers else by_row
    ids, face_ids = numbers.vertex_ids, np.arange(len(triangles))
    draft = Draft(points, triangles, ids, face_ids, numbers.file_vertex_count, numbers.copies, [])
    draft.drop_unreferenced_vertices()
    used_count = len(draft.vertices)
    if dropped := draft.file_vertex_count - used_count - len(draft.copies):
        gaps = np.flatnonzero(draft.vertex_ids != np.arange(used_count))
        were = counted(dropped, "vertex that no face uses was", "vertices that no face uses were")
        draft.messages.append(
            f"{were} dropped (for example vertex {gaps[0] if len(gaps) else used_count})"
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
        found.kept_counts = (
            f"{len(found.vertices)} of {len(draft.vertices)} vertices and {len(found.faces)} of "
            f"{len(draft.faces)} faces{place}"
        )
        return _checked(found)

    try:
        return attempt(options)
    except DefectError as defect:
        if len(draft.faces) > FACES_MAX:
            raise MeshError(
                f"{defect.problem}. Try --merge, --clean or --largest-component (in Python: "
                "merge=True, ...)"
            ) from None
        merged = None if options.merge else _merged(draft)
        merging_joins = merged is not None and components(merged).max() < components(draft).max()
        raise with_remedies(defect, options, attempt, merged is not None, merging_joins) from None


def _copied(draft: Draft) -> Draft:
    found = copy.copy(draft)
    found.messages = draft.messages.copy()
    return found


def _merged(draft: Draft) -> Draft | None:
    """Return a copy with the vertices at the same position merged, or None.

    None is returned if no positions are equal, or if merging would take too long. The same holds if
    all components lie at the same place, as the spheres of two hemispheres do.
    """
    found = _copied(draft)
    try:
        merge_vertices(found, True, False)
    except MeshError:
        return None
    component = components(draft)
    different = topology.equal_rows(np.sort(found.faces, axis=1))[0]
    at_same_place = component.max() > 0 and np.ptp(component[different]) == 0
    return None if at_same_place or len(found.vertices) == len(draft.vertices) else found


def _checked(draft: Draft) -> Draft:
    _refuse_several_components(draft)
    twice = draft.has_vertex_twice()
    _refuse_faces(draft, twice, "degenerate, with the same vertex twice", "Remove")
    flat = flat_faces(draft.vertices, draft.faces)
    _refuse_faces(draft, flat, "degenerate, with no area up to rounding", "Remove or collapse")
    _warn_of_large_offset(draft)
    vertex_count, face_count = len(draft.vertices), len(draft.faces)
    if 3 * face_count > vertex_count * (vertex_count - 1):
        # refused before edges are built, of which there may be many more than vertices
        raise DefectError(
            f"{face_count} faces on {vertex_count} vertices are too many: some faces repeat, or "
            "some edges have more than two faces",
            f"Remove the extra faces, {CLEANING}",
        )
    draft.edges, draft.face_edges = edges_of_faces(draft.faces, vertex_count)
    _refuse_duplicate_faces(draft)
    _refuse_non_manifold_edges(draft)
    _orient_consistently(draft)
    draft.corner_fans = topology.corner_fans(draft.edge_slots, face_count)
    _warn_of_seams(draft)
    pinched = topology.pinched_vertices(draft.faces, draft.corner_fans, vertex_count)
    if pinched.any():
        draft.messages.append(
            f"warning: {counted(pinched.sum(), 'vertex is', 'vertices are')} pinched, joining "
            "parts that share no edge "
            f"(for example vertex {draft.vertex_ids[np.argmax(pinched)]}). Nothing flows across "
            "a pinched vertex"
        )
    return draft


def _warn_of_seams(draft: Draft) -> None:
    """Warn if boundary vertices have the same position, where the surface only looks connected."""
    slots = draft.edge_slots[draft.edge_slots[:, 1] < 0, 0]
    rim = np.unique(draft.faces.ravel()[topology.next_corner(slots)])
    _, first = np.unique(draft.vertices[rim], axis=0, return_index=True)
    if repeats := len(rim) - len(first):
        example = draft.vertex_ids[np.delete(rim, first)[0]]
        draft.messages.append(
            f"warning: {counted(repeats, 'boundary vertex repeats', 'boundary vertices repeat')} "
            f"the position of another one (for example vertex {example}), as at a seam of a "
            "texture. Nothing flows across such a seam; --merge closes it (in Python: merge=True)"
        )


def _refuse_several_components(draft: Draft) -> None:
    component = components(draft)
    count = component.max() + 1
    if count == 1:
        return
    sizes = np.bincount(component)
    outside = np.argmax(component != sizes.argmax())
    merged = _merged(draft)
    fewer = components(merged).max() + 1 if merged else count
    joined = f", {fewer} after merging vertices" if fewer < count else ""
    raise DefectError(
        f"the surface has {count} components that do not touch{joined}; expected one. The largest "
        f"has {sizes.max()} of {len(component)} faces; face {draft.face_ids[outside]}, counting "
        "from 0, is outside it",
        "Join the components, or use a mesh of one of them",
    )


def _number_array(rows: ArrayLike, name: str, meaning: str) -> NDArray[Any]:
    """Return an array with rows of three real numbers, or raise a MeshError about ``name``."""
    try:
        array = plain_array(rows)
    except (TypeError, RuntimeError) as error:
        raise MeshError(
            f"{name} cannot be converted to an array ({one_line(error, 80)}). Use an array of "
            f"shape {meaning}"
        ) from error
    except ValueError as error:
        raise MeshError(
            f"the rows of {name} differ in length; expected an array of shape {meaning}"
        ) from error
    if array.size == 0:
        raise MeshError(
            f"the mesh has no {name}; expected a surface with vertices and triangles, not a point "
            "cloud"
        )
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iuf":
        raise MeshError(
            f"{name} has shape {array.shape} and type {one_line(array.dtype, 40)}; expected an "
            f"array of shape {meaning}"
        )
    return array


def _face_array(faces: ArrayLike, vertex_count: int) -> IntArray:
    meaning = "(F, 3) with vertex indices counted from 0 (split larger polygons)"
    array = _number_array(faces, "faces", meaning)
    if array.dtype.kind == "f":
        fractional = np.any(array != np.floor(array), axis=1)
        if fractional.any():
            face = np.argmax(fractional)
            raise MeshError(
                f"{counted(fractional.sum(), 'face has', 'faces have')} indices that are not "
                f"integers (face {face}: {array[face].tolist()}); expected vertex indices counted "
                "from 0"
            )
    outside = (array < 0) | (array >= vertex_count)
    if outside.any():
        face, corner = np.argwhere(outside)[0]
        named = one_line(f"{array[face, corner]:.0f}", 40)
        advice = "Correct the indices, or add the missing vertices"
        if array.min() == 1 and array.max() == vertex_count:
            advice = "All indices count from 1: subtract 1"
        raise MeshError(
            f"{counted(outside.any(axis=1).sum(), 'face refers', 'faces refer')} to a vertex that "
            f"does not exist (face {face}, counting from 0, refers to vertex {named}, but the "
            f"{vertex_count} vertices are numbered from 0). {advice}"
        )
    return array.astype(np.int64, copy=False)


def _refuse_unusable_coordinates(draft: Draft) -> None:
    bad = ~np.isfinite(draft.vertices).all(axis=1)
    if bad.any():
        vertex = np.argmax(bad)
        raise MeshError(
            f"{counted(bad.sum(), 'vertex has', 'vertices have')} coordinates that are not finite "
            f"(vertex {draft.vertex_ids[vertex]}, counting from 0: "
            f"{draft.vertices[vertex].tolist()}). Correct or remove them"
        )
    extent, width = _extent_and_width(draft)
    if extent > SIZE_MAX or 0 < width < SIZE_MIN:
        vertex = np.abs(draft.vertices).max(axis=1).argmax()
        raise MeshError(
            f"the mesh is {width:.3g} wide, and its largest coordinate is {extent:.3g} (vertex "
            f"{draft.vertex_ids[vertex]}), so areas overflow or underflow. Rescale it to a size "
            f"between {SIZE_MIN:g} and {SIZE_MAX:g}"
        )


def _extent_and_width(draft: Draft) -> tuple[float, float]:
    width = draft.vertices.max(axis=0) - draft.vertices.min(axis=0)
    return np.abs(draft.vertices).max(), width.max()


def _warn_of_large_offset(draft: Draft) -> None:
    """Warn if the surface is so far from the origin that rounding changes its shape."""
    extent, width = _extent_and_width(draft)
    if extent / width >= OFFSET_RATIO_MAX:
        draft.messages.append(
            f"warning: the surface lies {extent / width:.1g} times its width from the origin. "
            "Rounding moves its vertices there by "
            f"{np.finfo(np.float64).eps * (extent / width):.0g} of its width. Move it to the "
            "origin in the program that made it"
        )


def _refuse_faces(draft: Draft, bad: BoolArray, defect: str, remedy: str) -> None:
    if bad.any():
        face = np.argmax(bad)
        raise DefectError(
            f"{counted(bad.sum(), 'face is', 'faces are')} {defect} (face "
            f"{draft.face_ids[face]}, counting from 0: vertices {draft.corners(face)})",
            f"{remedy} them, {CLEANING}",
        )


def _refuse_duplicate_faces(draft: Draft) -> None:
    a, b, c = draft.face_edges.T
    smallest, largest = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    # two edges of a triangle determine its vertices
    keys = smallest * (draft.face_edges.max() + 1) + (a + b + c - smallest - largest)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    is_repeat = np.append(False, keys[1:] == keys[:-1])
    if is_repeat.any():
        position = np.argmax(is_repeat)
        first, second = np.sort(draft.face_ids[order[position - 1 : position + 1]])
        raise DefectError(
            f"{counted(is_repeat.sum(), 'face has', 'faces have')} the same vertices as another "
            f"one (faces {first} and {second}, counting from 0: vertices "
            f"{draft.corners(order[position])})",
            f"Remove the copies, {CLEANING}",
        )


def _refuse_non_manifold_edges(draft: Draft) -> None:
    uses = np.bincount(draft.face_edges.ravel())
    if uses.max() > 2:
        edge = np.argmax(uses > 2)
        start, end = draft.vertex_ids[draft.edges[edge]]
        faces = draft.face_ids[np.flatnonzero((draft.face_edges == edge).any(axis=1))]
        raise DefectError(
            f"{counted(int(np.sum(uses > 2)), 'edge has', 'edges have')} more than two faces "
            f"(vertices {start} and {end}, counting from 0, with faces "
            f"{', '.join(map(str, faces[:4]))})",
            "Remove some of these faces, for example in MeshLab with Repair non Manifold Edges "
            "(--clean only removes sheets attached to a larger surface)",
        )


def _orient_consistently(draft: Draft) -> None:
    """Flip faces to one orientation, or raise a MeshError if the surface is one-sided.

    Pieces whose faces are joined by edges are oriented separately. The normals of a closed piece
    point outward. A piece with a boundary keeps the orientation of most of its faces.
    """
    count = len(draft.faces)
    draft.edge_slots = topology.edge_slots(draft.face_edges, len(draft.edges))
    inner = draft.edge_slots[draft.edge_slots[:, 1] >= 0]
    start = draft.faces.ravel()[topology.next_corner(inner)]
    disagree = start[:, 0] == start[:, 1]
    if not disagree.any():
        return
    # components of the orientation double cover: faces as in the input, and their flipped copies
    f, g = inner.T // 3
    same = np.stack([f, g + count * disagree], axis=1)
    opposite = np.stack([f + count, g + count * ~disagree], axis=1)
    labels = topology.connected(2 * count, np.concatenate([same, opposite]))
    original, flipped = labels[:count], labels[count:]
    one_sided = original == flipped
    if one_sided.any():
        raise DefectError(
            f"the surface is not orientable, like a Moebius strip ({one_sided.sum()} of "
            f"{count} faces on a one-sided piece, for example face "
            f"{draft.face_ids[np.argmax(one_sided)]}, counting from 0)",
            "Cut the surface open",
        )
    flip, piece = flipped < original, np.minimum(original, flipped)
    flip = flip ^ _prefers_other_side(draft, flip, piece)[piece]
    if flip.any():
        for name in ("faces", "face_edges"):
            of_corners = getattr(draft, name)
            setattr(draft, name, np.where(flip[:, None], of_corners[:, [0, 2, 1]], of_corners))
        draft.edge_slots = topology.edge_slots(draft.face_edges, len(draft.edges))
        draft.has_flipped_faces = True
        draft.messages.append(
            f"{counted(flip.sum(), 'face was', 'faces were')} flipped so that all have the same "
            f"orientation (for example face {draft.face_ids[np.argmax(flip)]})"
        )


def _prefers_other_side(draft: Draft, flip: BoolArray, piece: IntArray) -> BoolArray:
    """Return for each piece of the surface whether its orientation must be reversed.

    ``piece`` (F,) is the label of the piece of each face. ``flip`` (F,) is True for faces whose
    reversal makes the orientation of each piece consistent. A piece with a boundary is reversed if
    most of its faces would be flipped, and a closed piece if its normals would point inward.
    """
    a, b, c = np.moveaxis((draft.vertices - draft.vertices.mean(axis=0))[draft.faces], 1, 0)
    volume = np.einsum("fx,fx->f", a, np.cross(b, c)) * np.where(flip, -1, 1)
    inward = np.bincount(piece, volume) < 0
    mostly_flipped = 2 * np.bincount(piece, flip) > np.bincount(piece)
    has_boundary = np.zeros(len(inward), dtype=bool)
    has_boundary[piece[draft.edge_slots[draft.edge_slots[:, 1] < 0, 0] // 3]] = True
    return np.where(has_boundary, mostly_flipped, inward)
