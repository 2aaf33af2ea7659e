"""The fixed sparsity of ``D_v``: assembling it for a new field is one pass over the faces."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from abfm.calculus.operators import face_areas, hat_gradients, vertex_areas
from abfm.flow import derivative_kernels
from abfm.flow.clusters import vertex_clusters
from abfm.flow.derivative_kernels import GROUP
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IndexArray

_BLOCK = 256  # rows at least
_BLOCKED = 20_000  # vertices from which blocks pay


@dataclass(frozen=True)
class DerivativePattern:
    """The fixed sparsity of ``D_v`` on a mesh (vertex adjacency with diagonal) and what fills it from a field.

    Vertices are renumbered so that neighbours are close in memory; entries come in groups, see `derivative_kernels`.
    Where vertices are held together (`abfm.flow.clusters`), rows and columns are clusters, with one value each.
    """

    order: IndexArray  # (V,): f[order] is a function in the pattern's order; of clusters, their vertices in a row
    rank: IndexArray  # (V,): f[rank] is a function back in the mesh's order; of clusters, each vertex's own one
    shares: FloatArray | None  # (V,), of each vertex in its cluster's area; None where each vertex is one
    indptr: IndexArray  # (V + 1,), first group of each row
    indices: IndexArray  # (G, 7), columns; the row itself where a group is padded
    bounds: IndexArray  # (B + 1,), blocks of rows whose neighbours are in the same, the next or the last block
    faces: IndexArray  # what `assemble_derivative` takes, as slopes and inverse_areas: in the mesh's order
    positions: IndexArray  # (F, 3, 3), entry of row corner a, column corner b, among all 7 G
    transpose: IndexArray  # (7 G,), entry with row and column exchanged
    slopes: FloatArray
    inverse_areas: FloatArray

    @property
    def size(self) -> int:
        """Rows and columns."""
        return len(self.indptr) - 1

    def restricted(self, f: FloatArray) -> FloatArray:
        """A function (V,) in the pattern's order; means over clusters."""
        return f[self.order] if self.shares is None else self._summed(self.shares * f)

    def extended(self, f: FloatArray) -> FloatArray:
        """A function in the pattern's order as one of the vertices (V,)."""
        return f[self.rank]

    def restricted_dual(self, mu: FloatArray) -> FloatArray:
        """Adjoint of `extended`."""
        return mu[self.order] if self.shares is None else self._summed(mu)

    def extended_dual(self, mu: FloatArray) -> FloatArray:
        """Adjoint of `restricted`."""
        return mu[self.rank] if self.shares is None else self.shares * mu[self.rank]

    def _summed(self, f: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self.rank, f, self.size), dtype=np.float64)

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
    return _pattern(mesh, np.arange(len(mesh.vertices)), mesh.edges, mesh.face_edges)


@per_mesh
def clustered_pattern(mesh: TriangleMesh) -> DerivativePattern:
    """The same for functions with one value on each of `vertex_clusters`."""
    clusters = vertex_clusters(mesh)
    if clusters is None:
        return derivative_pattern(mesh)
    ends = np.sort(clusters[mesh.edges], axis=1)
    apart = ends[:, 0] != ends[:, 1]
    edges, found = np.unique(ends[apart], axis=0, return_inverse=True)
    edge_of = np.full(len(ends), -1)
    edge_of[apart] = found.reshape(-1)  # NumPy 2.0 gives a column
    return _pattern(mesh, clusters, edges, edge_of[mesh.face_edges])


def _pattern(mesh: TriangleMesh, clusters: IndexArray, edges: IndexArray, face_edges: IndexArray) -> DerivativePattern:
    """For the cluster of each vertex (V,), edges between clusters and those of faces (F, 3), opposite their corners."""
    count = int(clusters.max()) + 1
    place = np.argsort(_local_order(edges, count))
    rank = place[clusters]
    groups = -(-(np.bincount(edges.ravel(), minlength=count)[np.argsort(place)] + 1) // GROUP)
    indptr = np.concatenate([[0], np.cumsum(groups)])
    small = np.uint32 if GROUP * indptr[-1] < 2**32 else np.uint64
    indptr = indptr.astype(small)
    indices = np.repeat(np.arange(count, dtype=small), GROUP * groups)
    transpose = np.arange(len(indices))
    positions = np.empty((len(mesh.faces), 3, 3), dtype=small)
    derivative_kernels.fill_pattern(
        clusters[mesh.faces], face_edges, edges, place, indptr, indices, transpose, positions
    )
    areas = vertex_areas(mesh)
    totals = np.bincount(rank, areas, count)[rank]
    return DerivativePattern(
        np.argsort(rank, kind="stable"),
        rank,
        None if count == len(clusters) else areas / totals,
        indptr,
        indices.reshape(-1, GROUP),
        _blocks(indptr, indices.reshape(-1, GROUP)).astype(small),
        mesh.faces.astype(small),
        positions,
        transpose,
        hat_gradients(mesh) * (face_areas(mesh) / 3)[:, None, None],
        1 / totals,
    )


def _local_order(edges: IndexArray, count: int) -> IndexArray:
    """Nodes of a graph in layers from one end to the other (reverse Cuthill-McKee)."""
    a, b = np.concatenate([edges, edges[:, ::-1]]).T
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
