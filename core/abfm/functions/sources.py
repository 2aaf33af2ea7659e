"""Values of MNE's source estimates, interpolated between the sources."""

import numpy as np
from scipy import sparse

from abfm.calculus.operators import cotangent_laplacian, vertex_areas
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.reading import Columns
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import stepped

_FSAVERAGE = 163_842  # vertices, of which the first ones are those of its coarser copies
_COARSER_COPIES = {
    642: "fsaverage3",
    2562: "fsaverage4",
    10_242: "fsaverage5",
    40_962: "fsaverage6",
}


def between_sources(film: Columns, mesh: TriangleMesh) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the values of sources at all vertices, (T, V), and notes.

    Raises
    ------
    ValueError
        If the sources are not vertices of the mesh, or values between them cannot be interpolated.
    """
    sources = np.zeros(0, dtype=np.int64) if film.vertices is None else film.vertices
    values = film.table().T
    if sources.max() >= mesh.file_vertex_count:
        raise ValueError(
            f"it has a value of vertex {sources.max()}, and the mesh has "
            f"{mesh.file_vertex_count}: give the surface that its sources lie on, of the same "
            "hemisphere"
        )
    rows, places = np.full(len(mesh.vertices), -1), mesh.local_vertices(sources)[::-1]
    rows[places[places >= 0]] = np.arange(len(places))[::-1][places >= 0]  # the first of copies
    known = int(np.count_nonzero(rows >= 0))
    if known == len(rows):
        return values[:, rows], ()
    if not known:
        raise ValueError("it has no value at a vertex of the mesh that is in a face")
    note = f"{known:,} of {len(rows):,} vertices have values; the others are interpolated"
    are_first = known == sources.max() + 1
    if mesh.file_vertex_count == _FSAVERAGE and are_first and known in _COARSER_COPIES:
        note += f": {_COARSER_COPIES[known]} has just those with values, and takes less time"
    return _interpolated(mesh, values, rows), (note,)


def _interpolated(mesh: TriangleMesh, film: FloatArray, rows: IntArray) -> FloatArray:
    """Return frames (T, V) with the values of these rows; between them, where rows are -1, they
    have the least square of the Laplacian, as thin plates have.
    """
    known = rows >= 0
    values = np.zeros((len(film), len(rows)))
    values[:, known] = film[:, rows[known]]
    if not np.isfinite(values).all():
        raise ValueError(
            "it has values that are not finite, and none between its sources, where nothing can be "
            "interpolated: leave these sources out, or give the surface of the sources alone"
        )
    laplacian = cotangent_laplacian(mesh)
    inverse_areas = sparse.diags_array(1 / vertex_areas(mesh))
    rows_of_unknown = sparse.csr_array(laplacian[~known] @ inverse_areas @ laplacian)
    solve = factor(sparse.csr_array(rows_of_unknown[:, ~known]))
    beside = sparse.csr_array(rows_of_unknown[:, known])
    with stepped("interpolating between sources", values) as frames:
        for frame in frames:
            frame[~known] = solve(-(beside @ frame[known]))
    return values
