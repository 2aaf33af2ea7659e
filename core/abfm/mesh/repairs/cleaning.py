"""Removal of faces without area, repeated faces, and sheets attached to a surface.

The removal of a face without area must not leave a hole. If two of its corners are very close, they
are merged, so that the faces on both sides of it meet. Otherwise one corner lies on the longest
side. Then the neighbour at the longest side is split at this corner.
"""

from __future__ import annotations

import heapq

import numpy as np

from abfm.errors import MeshError
from abfm.mesh.draft import Draft
from abfm.mesh.face_sizes import flat_faces, side_lengths, twice_areas
from abfm.mesh.topology import connected, edges_of_faces, equal_rows
from abfm.types import BoolArray, IntArray
from abfm.wording import counted

# the ends of the shortest side are merged up to this ratio to the longest side
_ASPECT_RATIO_MAX = 1e-6
_FLAT_FACES_MAX = 100_000  # if more faces have no area, all are kept
_ROUNDS_MAX = 5
_SPLITS_EACH_MAX = 20  # mean number of neighbours split for each face without area
_NO_FACE_MESSAGE = "no face remains after the mesh was cleaned. Use a file of a surface"


def clean(draft: Draft) -> None:
    """Clean a mesh, with a message for every change; defects without a safe repair remain."""
    _merge_short_sides(draft)
    _drop(draft, draft.has_vertex_twice(), "with a vertex twice")
    _drop_repeated(draft)
    _remove_flat(draft)
    for _ in range(_ROUNDS_MAX):  # sheets may be attached to attached sheets
        attached = _attached_sheets(draft)
        if not attached.any():
            break
        _drop(draft, attached, "of sheets attached to the surface")


def _drop(draft: Draft, bad: BoolArray, what: str, example: str = "") -> None:
    if bad.all():
        raise MeshError(_NO_FACE_MESSAGE)
    if bad.any():
        example, count = example or str(draft.face_ids[np.argmax(bad)]), len(draft.vertices)
        draft.keep_faces(~bad)
        lost = count - len(draft.vertices)
        alone = f", with {counted(lost, 'vertex', 'vertices')} that only they used" if lost else ""
        draft.messages.append(
            f"{counted(bad.sum(), 'face', 'faces')} {what} {'was' if bad.sum() == 1 else 'were'} "
            f"removed{alone} (for example face {example})"
        )


def _merge_short_sides(draft: Draft) -> None:
    is_flat = flat_faces(draft.vertices, draft.faces) & ~draft.has_vertex_twice()
    faces = draft.faces[is_flat]
    lengths = side_lengths(draft.vertices, faces)
    short = lengths <= _ASPECT_RATIO_MAX * lengths.max(axis=1, initial=0, keepdims=True)
    if short.any():
        ends = np.stack([np.roll(faces, -1, axis=1)[short], np.roll(faces, -2, axis=1)[short]], 1)
        pairs = draft.merge(connected(len(draft.vertices), ends))
        draft.messages.append(
            f"{counted(len(pairs), 'vertex was', 'vertices were')} merged into the other end of a "
            "very short side of a face without area (for example vertex "
            f"{pairs[0, 0]} into vertex {pairs[0, 1]})"
        )


def _drop_repeated(draft: Draft) -> None:
    """Drop faces that have the vertices of an earlier face, in any order.

    If repeated faces stand like a wall on a surface that continues below it, both copies are
    dropped.
    """
    first, group = equal_rows(np.sort(draft.faces, axis=1))
    is_repeat = first[group] != np.arange(len(draft.faces))
    if not is_repeat.any():
        return
    example = np.argmax(is_repeat)
    like = f"{draft.face_ids[example]}, as face {draft.face_ids[first[group[example]]]}"
    edges = edges_of_faces(draft.faces, len(draft.vertices))[1]
    repeats = np.bincount(group)[group] > 1
    others = np.bincount(edges[~repeats].ravel(), minlength=int(edges.max()) + 1)
    # patches of repeated faces, connected by edges
    label = connected(len(others), np.concatenate([edges[repeats][:, :2], edges[repeats][:, 1:]]))
    ends, joins = np.zeros(len(others), dtype=bool), np.zeros(len(others), dtype=bool)
    at = edges[repeats].ravel()
    ends[label[at[others[at] >= 2]]] = True
    joins[label[at[others[at] == 1]]] = True
    patch = label[edges[:, 0]]
    wall = repeats & ends[patch] & ~joins[patch]
    _drop(draft, is_repeat | wall, "repeating another one", like)


def _remove_flat(draft: Draft) -> None:
    """Remove faces without area, and split their neighbours so that no hole remains.

    The neighbour at the longest side of a face is split at the corner opposite this side. It has
    area, because the face with the longest side is removed first.
    """
    is_flat = flat_faces(draft.vertices, draft.faces)
    count = int(is_flat.sum())
    if not 0 < count <= _FLAT_FACES_MAX:
        return
    is_near = _faces_around(draft.faces, _faces_around(draft.faces, is_flat))
    patch = _Patch(draft, np.flatnonzero(is_near))
    patch.enqueue(np.flatnonzero(is_flat).tolist())
    splits = 0
    while patch.queue and splits <= _SPLITS_EACH_MAX * count:
        splits += patch.remove_flat(*heapq.heappop(patch.queue)[1:])
    if is_near.all() and not patch.faces:
        raise MeshError(_NO_FACE_MESSAGE)
    example = draft.face_ids[np.argmax(is_flat)]
    ids = np.concatenate([draft.face_ids[~is_near], [patch.ids[face] for face in patch.faces]])
    order = np.argsort(ids, kind="stable").astype(np.int64)
    changed = np.array([*patch.faces.values()], dtype=np.int64).reshape(-1, 3)
    draft.faces = np.concatenate([draft.faces[~is_near], changed])[order]
    draft.face_ids = ids[order].astype(np.int64)
    draft.drop_unreferenced_vertices()
    _drop_repeated(draft)
    split = f"; {counted(splits, 'neighbour was', 'neighbours were')} split so that no hole remains"
    draft.messages.append(
        f"{counted(count, 'face without area was', 'faces without area were')} removed (for "
        f"example face {example}){split if splits else ''}"
    )


class _Patch:
    """Part of a mesh around the faces without area, changed while these are removed."""

    def __init__(self, draft: Draft, near: IntArray) -> None:
        self.vertices = draft.vertices
        # numbers in the file of the faces, and of the parts of split faces
        self.ids: list[int] = draft.face_ids.tolist()
        self.faces: dict[int, list[int]] = {}
        self.queue: list[tuple[float, int, int]] = []
        self._around: dict[tuple[int, int], set[int]] = {}
        for face, corners in zip(near.tolist(), draft.faces[near].tolist(), strict=True):
            self._add(face, corners)

    def enqueue(self, faces: list[int]) -> None:
        """Add the faces without area to the queue of faces to remove."""
        corners = np.array([self.faces[face] for face in faces])
        lengths = side_lengths(self.vertices, corners)
        for k in np.flatnonzero(flat_faces(self.vertices, corners)).tolist():
            entry = -float(lengths[k].max()), faces[k], int(lengths[k].argmax())
            heapq.heappush(self.queue, entry)

    def remove_flat(self, face: int, corner: int) -> int:
        """Remove a face without area, and split the neighbours opposite its ``corner`` there.

        Return the number of neighbours.
        """
        if face not in self.faces:
            return 0
        ends = self._remove(face)
        apex = ends.pop(corner)
        beyond = sorted(self._around[min(ends), max(ends)])
        for other in beyond:
            corners, new = self._remove(other), [len(self.ids), len(self.ids) + 1]
            self.ids += [self.ids[other]] * 2
            for part, end in zip(new, ends, strict=True):
                self._add(part, [apex if vertex == end else vertex for vertex in corners])
            self.enqueue(new)
        return len(beyond)

    def _add(self, face: int, corners: list[int]) -> None:
        self.faces[face] = corners
        for side in _sides(corners):
            self._around.setdefault(side, set()).add(face)

    def _remove(self, face: int) -> list[int]:
        for side in _sides(self.faces[face]):
            self._around[side].discard(face)
        return self.faces.pop(face)


def _faces_around(faces: IntArray, is_chosen: BoolArray) -> BoolArray:
    """Return whether each face (F,) shares a vertex with a chosen face."""
    is_used = np.zeros(int(faces.max()) + 1, dtype=bool)
    is_used[faces[is_chosen]] = True
    return np.asarray(is_used[faces].any(axis=1))


def _sides(corners: list[int]) -> list[tuple[int, int]]:
    a, b, c = corners
    return [(min(b, c), max(b, c)), (min(c, a), max(c, a)), (min(a, b), max(a, b))]


def _attached_sheets(draft: Draft) -> BoolArray:
    """Return whether each face (F,) belongs to a sheet attached to a surface that continues.

    A sheet is a set of faces connected by edges with two faces. It is attached if each edge with
    more faces has exactly three, and the two others belong to the same sheet of larger area.
    """
    _, edges = edges_of_faces(draft.faces, len(draft.vertices))
    uses = np.bincount(edges.ravel())
    if uses.max() <= 2:
        return np.zeros(len(edges), dtype=bool)
    order = np.argsort(edges, axis=None, kind="stable")
    first = np.cumsum(uses) - uses
    inner = first[uses == 2]
    sheet = connected(len(edges), np.stack([order[inner], order[inner + 1]], axis=1) // 3)
    areas = np.bincount(sheet, twice_areas(draft.vertices, draft.faces))
    is_attached, at_edges = np.ones(len(areas), dtype=bool), np.zeros(len(areas), dtype=bool)
    is_crowded = np.repeat(uses > 2, uses)
    at_edges[sheet[order[is_crowded] // 3]] = True
    is_attached[sheet[order[np.repeat(uses > 3, uses)] // 3]] = False
    three = np.sort(sheet[order[first[uses == 3][:, None] + np.arange(3)] // 3], axis=1)
    low, middle, high = three.T
    single = np.where(low == middle, high, low)
    has_single = (low == middle) != (middle == high)
    for each in three.T:
        is_smaller = has_single & (each == single) & (areas[each] < areas[middle])
        is_attached[each[~is_smaller]] = False
    return np.asarray((is_attached & at_edges)[sheet])
