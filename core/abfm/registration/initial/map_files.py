"""Initial maps from files: a vertex, or a point of a face, of A for each vertex of B; or pairs."""

import numpy as np

from abfm.errors import AbfmError, ParameterError, brief
from abfm.functions.files import mapped_vertices
from abfm.functions.value_files import read_map_table
from abfm.maps.point_maps import PointMap
from abfm.mesh import TriangleMesh
from abfm.reading import Format, open_file
from abfm.registration.initial.landmark_pairs import Landmarks, read_landmarks
from abfm.types import FloatArray, IntArray

_WEIGHT_ROUNDING = 1e-3  # what weights of a file may miss 1 by, or be below 0


def map_from_file(a: TriangleMesh, b: TriangleMesh, path: str) -> PointMap | Landmarks:
    """Read a map from B to A from a .npy, .csv, .txt, .vts, .map or .gii file, which counts
    vertices and faces as the files of the meshes do.

    One column
        The vertex of A for each vertex of B, counted from 0 or from 1 as
        `abfm.functions.read_vertex_map` tells.
    Four columns
        For each vertex of B a face of A, counted in the same way, and the weights of its three
        corners, which may be rounded.
    Two columns
        Pairs of a vertex of A and one of B, counted from 0 (in .vts files from 1): these are
        landmarks, unless every vertex of B is in one pair.

    Raises
    ------
    AbfmError
        If the file cannot be read or holds none of these; the first line that is wrong, and why.
    """
    table = read_map_table(path, b)
    columns = table.shape[1]
    if columns == 1:
        return PointMap.of_vertices(b, a, mapped_vertices(b, a, path, table))
    if columns == 2:
        return _of_pairs(a, b, path, table)
    if columns == 4:
        try:
            rows = b.restrict(table)
            faces = _faces(a, b, path, rows[:, 0])
            return PointMap(b, a, faces, _weights(a, b, rows[:, 1:]))
        except AbfmError as error:
            raise AbfmError(f"map {brief(path)}: {error}") from None
    raise AbfmError(
        f"map {brief(path)} has {columns} columns; expected 1 (a vertex of A for each of B), 2 "
        "(pairs of a vertex of A and one of B) or 4 (a face of A and three weights)"
    )


def _of_pairs(
    a: TriangleMesh, b: TriangleMesh, path: str, table: FloatArray
) -> PointMap | Landmarks:
    numbers = table - 1 if path.lower().endswith(".vts") else table
    # of a map, unlike landmarks, several may have one image
    is_map = np.array_equal(np.sort(numbers[:, 1]), b.numbered[0])
    if not is_map and open_file(path).format is Format.TABLE:  # which may have words, too
        return read_landmarks(a, b, path)
    wrong = np.flatnonzero(~(np.isfinite(table) & (table == np.rint(table))).all(axis=1))
    try:
        if len(wrong):
            raise ParameterError(
                f"row {wrong[0] + 1} holds {table[wrong[0]]}; expected whole numbers"
            )
        pairs = zip((a, b), numbers.T.tolist(), strict=True)
        of_a, of_b = ([mesh.local_vertex(int(x)) for x in side] for mesh, side in pairs)
    except AbfmError as error:
        raise AbfmError(f"landmarks {brief(path)}: {error}") from None
    if is_map:
        return PointMap.of_vertices(b, a, np.array(of_a)[np.unique(of_b, return_index=True)[1]])
    return Landmarks.of_vertices(a, b, of_a, of_b)


def _faces(a: TriangleMesh, b: TriangleMesh, path: str, numbers: FloatArray) -> IntArray:
    """Return the rows in A of faces (V,) as its file counts them."""
    if any("turned over" in message for message in a.messages):
        raise AbfmError(
            "faces of A were turned over when it was read, so that their corners are no longer in "
            "the file's order: save A anew and give weights for that, or a vertex for each of B's"
        )
    fitting = []
    for first in (1, 0) if path.lower().endswith(".vts") else (0, 1):
        row = np.searchsorted(a.face_ids, numbers - first).clip(max=len(a.faces) - 1)
        missing = a.face_ids[row] != numbers - first
        if not missing.any():
            return row
        fitting.append((int(missing.sum()), first, int(np.argmax(missing))))
    count, first, worst = min(fitting)
    raise AbfmError(
        f"{count} of {len(numbers)} entries are no numbers of faces of A, which count {first} to "
        f"{a.face_ids[-1] + first} (vertex {b.vertex_ids[worst]} has {numbers[worst]:g})"
    )


def _weights(a: TriangleMesh, b: TriangleMesh, given: FloatArray) -> FloatArray:
    off = np.maximum(np.abs(given.sum(axis=1) - 1), -given.min(axis=1))
    wrong = np.flatnonzero(~(off <= _WEIGHT_ROUNDING))
    if len(wrong):
        raise AbfmError(
            f"{len(wrong)} of {len(given)} rows of weights are negative or do not sum to 1 (vertex "
            f"{b.vertex_ids[wrong[0]]} has {', '.join(f'{w:g}' for w in given[wrong[0]])})"
        )
    positive = np.maximum(given, 0)
    return np.asarray(positive / positive.sum(axis=1, keepdims=True))
