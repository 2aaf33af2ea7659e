"""Initial maps from files of vertices, of points in faces, or of vertex pairs."""

import numpy as np

from abfm.errors import AbfmError, ParameterError, brief
from abfm.functions.files import mapped_vertices
from abfm.functions.value_files import read_map_table
from abfm.maps.point_maps import PointMap
from abfm.mesh import TriangleMesh
from abfm.reading import Format, open_file
from abfm.registration.initial.landmark_pairs import Landmarks, read_landmarks
from abfm.types import FloatArray, IntArray
from abfm.wording import counted

_WEIGHT_ROUNDING = 1e-3  # tolerance for sums of weights other than 1, and for negative weights


def map_from_file(a: TriangleMesh, b: TriangleMesh, path: str) -> PointMap | Landmarks:
    """Read a map from B to A from a .npy, .csv, .txt, .vts, .map or .gii file.

    Vertices and faces are numbered as in the mesh files. The number of columns decides:

    - One column: the vertex of A for each vertex of B. `abfm.functions.read_vertex_map` documents
      whether the file counts from 0 or from 1.
    - Four columns: for each vertex of B a face of A, counted in the same way, and the weights of
      its three corners. The weights may be rounded.
    - Two columns: pairs of a vertex of A and a vertex of B, counted from 0 (in .vts files from 1).
      The pairs are landmarks, unless every vertex of B is in exactly one pair.

    Raises AbfmError if the file cannot be read or has another content. The message names the first
    wrong line.
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
            return PointMap(b, a, _faces(a, b, path, rows[:, 0]), _weights(b, rows[:, 1:]))
        except AbfmError as error:
            raise AbfmError(f"map {brief(path)}: {error}") from None
    raise AbfmError(
        f"map {brief(path)} has {counted(columns, 'column')}; expected 1 (vertices of A), 2 "
        "(vertices of A and B), or 4 (faces of A and weights)"
    )


def _of_pairs(
    a: TriangleMesh, b: TriangleMesh, path: str, table: FloatArray
) -> PointMap | Landmarks:
    numbers = table - 1 if path.lower().endswith(".vts") else table
    # several vertices may have the same image in a map, but not in landmarks
    is_map = np.array_equal(np.sort(numbers[:, 1]), b.numbered[0])
    if not is_map and open_file(path).format is Format.TABLE:  # a table may name landmarks
        return read_landmarks(a, b, path)
    wrong = np.flatnonzero(~(np.isfinite(table) & (table == np.rint(table))).all(axis=1))
    try:
        if len(wrong):
            raise ParameterError(f"row {wrong[0] + 1} has {table[wrong[0]]}; expected integers")
        pairs = zip((a, b), numbers.T.tolist(), strict=True)
        of_a, of_b = ([mesh.local_vertex(int(x)) for x in side] for mesh, side in pairs)
    except AbfmError as error:
        raise AbfmError(f"landmarks {brief(path)}: {error}") from None
    if is_map:
        return PointMap.of_vertices(b, a, np.array(of_a)[np.unique(of_b, return_index=True)[1]])
    return Landmarks.of_vertices(a, b, of_a, of_b)


def _faces(a: TriangleMesh, b: TriangleMesh, path: str, numbers: FloatArray) -> IntArray:
    """Convert numbers (V,) of faces in A's file, counted from 0 or 1, to indices of A's faces."""
    if a.has_flipped_faces:
        raise AbfmError(
            "faces of A were flipped on reading, so their corners are no longer in the order of "
            "the file. Save A again and give weights for the new file, or use a file with a vertex "
            "of A for each vertex of B"
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
        f"{count} of {len(numbers)} entries are not face numbers of A (vertex "
        f"{b.vertex_ids[worst]} has {numbers[worst]:g}); expected {first} to "
        f"{a.face_ids[-1] + first}"
    )


def _weights(b: TriangleMesh, given: FloatArray) -> FloatArray:
    off = np.maximum(np.abs(given.sum(axis=1) - 1), -given.min(axis=1))
    wrong = np.flatnonzero(~(off <= _WEIGHT_ROUNDING))
    if len(wrong):
        raise AbfmError(
            f"{len(wrong)} of {len(given)} rows of weights are negative or do not sum to 1 (vertex "
            f"{b.vertex_ids[wrong[0]]} has {', '.join(f'{w:g}' for w in given[wrong[0]])}); "
            "expected barycentric weights"
        )
    positive = np.maximum(given, 0)
    return np.asarray(positive / positive.sum(axis=1, keepdims=True))
