"""Merging of vertices at the same position, or close to each other."""

import numpy as np

from abfm.errors import MeshError
from abfm.mesh.draft import Draft
from abfm.mesh.face_sizes import side_lengths
from abfm.mesh.topology import connected, equal_rows
from abfm.types import FloatArray
from abfm.wording import counted

RELATIVE_DISTANCE = 1e-6  # default distance, over the diagonal of the bounding box
_PAIRS_MAX = 30_000_000


def merge_vertices(draft: Draft, distance: bool | float, may_collapse: bool) -> None:
    """Merge groups of close vertices into the first vertex of each group.

    Vertices of a group are connected by steps of at most ``distance``, which must be smaller than
    the shortest edge. If it is True, the distance is 1e-6 of the diagonal of the bounding box, and
    at most half the shortest edge. If ``may_collapse``, faces may collapse: a number must then be
    smaller than the median edge, and True has no upper limit.
    """
    first, place = equal_rows(draft.vertices)
    points = draft.vertices[first]
    same = np.stack([first[place], np.arange(len(place))], axis=1)
    reach = _merging_distance(draft, distance, may_collapse)
    _check_crowding(points, reach)
    from scipy.spatial import KDTree  # imported here: it takes longer than reading a mesh

    tree = KDTree(points)
    if tree.count_neighbors(tree, reach) - len(points) > 2 * _PAIRS_MAX:
        raise _crowded(reach)
    close = first[tree.query_pairs(reach, output_type="ndarray")]
    pairs = draft.merge(connected(len(draft.vertices), np.concatenate([same, close])))
    if len(pairs):
        copy, original = pairs[0]
        where = f"at most {reach:.3g} apart" if len(close) else "at the same position"
        draft.messages.append(
            f"{counted(len(pairs), 'vertex was', 'vertices were')} merged into another one, "
            f"{where} (for example vertex {copy} into vertex {original})"
        )


def _merging_distance(draft: Draft, distance: bool | float, may_collapse: bool) -> float:
    """Return the distance for `merge_vertices`; MeshError if the requested one is too large."""
    lengths = side_lengths(draft.vertices, draft.faces)
    lengths[lengths == 0] = np.inf
    face = int(lengths.min(axis=1).argmin())
    shortest = float(lengths[face].min())
    if distance is True:
        width = draft.vertices.max(axis=0) - draft.vertices.min(axis=0)
        reach = RELATIVE_DISTANCE * float(np.linalg.norm(width))
        return reach if may_collapse else min(reach, shortest / 2)
    middle = float(np.median(lengths))
    if distance >= (middle if may_collapse else shortest):
        which, where = "shortest", f" (face {draft.face_ids[face]}, counting from 0)"
        if may_collapse:
            which, where, shortest = "median", "", middle
        raise MeshError(
            f"the merge distance is {distance:g}, but the {which} edge has length "
            f"{shortest:.4g}{where}, and its face would collapse. Use a smaller distance"
        )
    return float(distance)


def _check_crowding(points: FloatArray, reach: float) -> None:
    """Raise a MeshError if so many points are close that the search for pairs would be slow."""
    low = points.min(axis=0)
    size = max(reach, 1e-12 * float((points - low).max())) or 1.0
    cells = np.floor((points - low) / size).astype(np.int64)
    counts = np.unique(cells, axis=0, return_counts=True)[1].astype(np.float64)
    if (counts**2).sum() > 16 * len(points) + 1_000_000:
        raise _crowded(reach)


def _crowded(reach: float) -> MeshError:
    return MeshError(
        f"too many vertices are less than the merge distance {reach:.3g} apart. Use a smaller one"
    )
