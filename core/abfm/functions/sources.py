"""Interpolation of source estimates of MNE between the sources."""

import numpy as np
from scipy import sparse

from abfm.calculus.operators import cotangent_laplacian, vertex_areas
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.reading import Columns
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import stepped

_FSAVERAGE = 163_842  # vertices; the first ones are the vertices of coarser versions
_COARSER_COPIES = {
    642: "fsaverage3",
    2562: "fsaverage4",
    10_242: "fsaverage5",
    40_962: "fsaverage6",
}


def interpolate_sources(columns: Columns, mesh: TriangleMesh) -> tuple[FloatArray, tuple[str, ...]]:
    """Interpolate values at sources to all vertices; return them, (T, V), and notes for the user.

    Raises ValueError if the sources are not vertices of the mesh, or interpolation is impossible.
    """
    sources = np.zeros(0, dtype=np.int64) if columns.vertices is None else columns.vertices
    values = columns.table().T
    if sources.max() >= mesh.file_vertex_count:
        raise ValueError(
            f"there is a value of vertex {sources.max()}, but the mesh has "
            f"{mesh.file_vertex_count} vertices. Use the surface of the sources, of the same "
            "hemisphere"
        )
    rows, places = np.full(len(mesh.vertices), -1), mesh.local_vertices(sources)[::-1]
    rows[places[places >= 0]] = np.arange(len(places))[::-1][places >= 0]  # the first of equal ones
    count = int(np.count_nonzero(rows >= 0))
    if count == len(rows):
        return values[:, rows], ()
    if not count:
        raise ValueError("the only values are those of vertices that no face of the mesh uses")
    note = f"{count:,} of {len(rows):,} vertices have values; the others are interpolated"
    are_first = count == sources.max() + 1
    if mesh.file_vertex_count == _FSAVERAGE and are_first and count in _COARSER_COPIES:
        note += f". The surface {_COARSER_COPIES[count]} has exactly those vertices and is faster"
    return _interpolated(mesh, values, rows), (note,)


def _interpolated(mesh: TriangleMesh, values: FloatArray, rows: IntArray) -> FloatArray:
    """Interpolate values (T, n) at n sources to all vertices, (T, V), like a thin plate.

    ``rows`` (V,) is the index of the source at each vertex, or -1 for vertices to interpolate.
    """
    known = rows >= 0
    frames = np.zeros((len(values), len(rows)))
    frames[:, known] = values[:, rows[known]]
    if not np.isfinite(frames).all():
        raise ValueError(
            "some values are not finite, so values between the sources cannot be interpolated. "
            "Remove these sources, or use the surface of the sources alone"
        )
    laplacian = cotangent_laplacian(mesh)
    inverse_areas = sparse.diags_array(1 / vertex_areas(mesh))
    rows_of_unknown = sparse.csr_array(laplacian[~known] @ inverse_areas @ laplacian)
    solve = factor(sparse.csr_array(rows_of_unknown[:, ~known]))
    of_known = sparse.csr_array(rows_of_unknown[:, known])
    with stepped("interpolating between sources", frames) as counted_frames:
        for frame in counted_frames:
            frame[~known] = solve(-(of_known @ frame[known]))
    return frames
