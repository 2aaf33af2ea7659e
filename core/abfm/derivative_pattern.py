"""The fixed sparsity of ``D_v``: assembling it for a new field is one pass over the faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from abfm import derivative_kernels
from abfm.derivative_kernels import GROUP
from abfm.kernels import IndexArray
from abfm.mesh import FloatArray, TriangleMesh, per_mesh
from abfm.operators import face_areas, hat_gradients, vertex_areas

_BLOCK = 256  # rows at least
_BLOCKED = 20_000  # vertices from which blocks pay


@dataclass(frozen=True)
class DerivativePattern:
    """The fixed sparsity of ``D_v`` on a mesh (vertex adjacency with diagonal) and what fills it from a field.

    Vertices are renumbered so that neighbours are close in memory. Entries come in groups, see `derivative_kernels`.

    Attributes
    ----------
    order, rank : (V,) arrays
        ``f[order]`` is a function in the pattern's order, ``f[rank]`` back in the mesh's.
    indptr : (V + 1,) array
        First group of each row.
    indices : (G, 7) array
        Columns; the row itself where a group is padded.
    bounds : (B + 1,) array
        Blocks of rows whose neighbours are in the same, the next or the last block.
    faces, slopes, inverse_areas
        What `assemble_derivative` takes, in the mesh's order.
    positions : (F, 3, 3) array
        Entry of row corner a, column corner b, among all ``7 G``.
    transpose : (7 G,) array
        Entry with row and column exchanged.
    """

    order: IndexArray
    rank: IndexArray
    indptr: IndexArray
    indices: IndexArray
    bounds: IndexArray
    faces: IndexArray
    positions: IndexArray
    transpose: IndexArray
    slopes: FloatArray
    inverse_areas: FloatArray

    def values(self, v: FloatArray) -> FloatArray:
        """Entries (G, 7) of ``D_v`` for frame coefficients ``v`` (F, 2)."""
        out = np.empty(self.indices.size)
        derivative_kernels.assemble_derivative(self.faces, self.positions, self.slopes, self.inverse_areas, v, out)
        return out.reshape(self.indices.shape)

    def transposed(self, values: FloatArray) -> FloatArray:
        """Entries of the transposed matrix."""
        return values.ravel()[self.transpose].reshape(values.shape)

    def product(self, values: FloatArray, f: FloatArray) -> FloatArray:
        """Matrix of these entries times a function, both in the pattern's order."""
        out = np.empty_like(f)
        derivative_kernels.grouped_product(self.indptr, self.indices, values, f, out)
        return out

    def add_chain_rule(self, entries: FloatArray, out: FloatArray) -> None:
        """Add to ``out`` (F, 2) the derivative by ``v`` for the derivative ``entries`` by the values of ``D_v``."""
        derivative_kernels.assemble_derivative_transposed(
            self.faces, self.positions, self.slopes, self.inverse_areas, entries.ravel(), out
        )


@per_mesh
def derivative_pattern(mesh: TriangleMesh) -> DerivativePattern:
    """Sparsity of ``D_v`` and the linear map from field coefficients to its values."""
    count = len(mesh.vertices)
    order = _local_order(mesh)
    rank = np.argsort(order)
    ends = rank[mesh.edges]
    groups = -(-(np.bincount(ends.ravel(), minlength=count) + 1) // GROUP)
    indptr = np.concatenate([[0], np.cumsum(groups)])
    small = np.uint32 if GROUP * indptr[-1] < 2**32 else np.uint64
    indptr = indptr.astype(small)
    indices = np.repeat(np.arange(count, dtype=small), GROUP * groups)
    transpose = np.arange(len(indices))
    positions = np.empty((len(mesh.faces), 3, 3), dtype=small)
    derivative_kernels.fill_pattern(
        mesh.faces, mesh.face_edges, mesh.edges, rank, indptr, indices, transpose, positions
    )
    return DerivativePattern(
        order,
        rank,
        indptr,
        indices.reshape(-1, GROUP),
        _blocks(indptr, indices.reshape(-1, GROUP)).astype(small),
        mesh.faces.astype(small),
        positions,
        transpose,
        hat_gradients(mesh) * (face_areas(mesh) / 3)[:, None, None],
        1 / vertex_areas(mesh),
    )


def _local_order(mesh: TriangleMesh) -> IndexArray:
    """Vertices in layers from one end of the surface to the other (reverse Cuthill-McKee)."""
    count = len(mesh.vertices)
    a, b = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T
    adjacency = sparse.csr_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))
    return np.asarray(reverse_cuthill_mckee(adjacency, symmetric_mode=True), dtype=np.int64)


def _blocks(indptr: IndexArray, indices: IndexArray) -> IndexArray:
    """Ends of blocks, each with at least so many rows and with all the neighbours of the block before."""
    count = len(indptr) - 1
    if count < _BLOCKED:
        return np.array([0, count])
    farthest = np.maximum.reduceat(indices.max(axis=1), indptr[:-1].astype(np.int64))
    reach = np.maximum.accumulate(farthest) + 1
    bounds = [0, _BLOCK]
    while bounds[-1] < count:
        bounds.append(min(count, max(bounds[-1] + _BLOCK, int(reach[bounds[-1] - 1]))))
    return np.array(bounds)
