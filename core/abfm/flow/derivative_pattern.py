"""The fixed sparsity of ``D_v``: assembling it for a new field is one pass over the faces."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from abfm.calculus.operators import face_areas, hat_gradients, vertex_areas
from abfm.flow import derivative_kernels
from abfm.flow.clusters import vertex_clusters
from abfm.flow.derivative_kernels import GROUP, Assembly
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IndexArray

_BLOCK = 256  # rows at least
_BLOCKED = 20_000  # vertices from which blocks pay


@dataclass(frozen=True)
class DerivativePattern:
    """The fixed sparsity of ``D_v`` on a mesh (vertex adjacency with diagonal) and what fills it
    from a field.

    Vertices are renumbered so that neighbours are close in memory; entries come in groups, see
    `derivative_kernels`. Where vertices are held together (`abfm.flow.clusters`), rows and columns
    are clusters, with one value each.
    """

    # (V,): f[order] is a function in the pattern's order; of clusters, their vertices in a row
    order: IndexArray
    # (V,): f[rank] is a function back in the mesh's order; of clusters, each vertex's own one
    rank: IndexArray
    # (V,), of each vertex in its cluster's area; None where each vertex is one
    shares: FloatArray | None
    indptr: IndexArray  # (V + 1,), first group of each row
    indices: IndexArray  # (G, 7), columns; the row itself where a group is padded
    # (B + 1,), blocks of rows whose neighbours are in the same, the next or the last block
    bounds: IndexArray
    transpose: IndexArray  # (7 G,), entry with row and column exchanged
    assembly: Assembly  # in the mesh's order

    @property
    def size(self) -> int:
        """Rows and columns."""
        return len(self.indptr) - 1

    def restricted(self, f: FloatArray) -> FloatArray:
        """Bring a function (V,) into the pattern's order; means over clusters."""
        return f[self.order] if self.shares is None else self._summed(self.shares * f)

    def extended(self, f: FloatArray) -> FloatArray:
        """Bring a function in the pattern's order back to the vertices (V,)."""
        return f[self.rank]

    def restricted_dual(self, mu: FloatArray) -> FloatArray:
        """Apply the adjoint of `extended`."""
        return mu[self.order] if self.shares is None else self._summed(mu)

    def extended_dual(self, mu: FloatArray) -> FloatArray:
        """Apply the adjoint of `restricted`."""
        return mu[self.rank] if self.shares is None else self.shares * mu[self.rank]

    def _summed(self, f: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self.rank, f, self.size), dtype=np.float64)

    def values(self, v: FloatArray) -> FloatArray:
        """Return the entries (G, 7) of ``D_v`` for frame coefficients ``v`` (F, 2)."""
        out = np.empty(self.indices.size)
        derivative_kernels.assemble_derivative(self.assembly, v, out)
        return out.reshape(self.indices.shape)

    def transposed(self, values: FloatArray) -> FloatArray:
        """Return the entries of the transposed matrix."""
        return values.ravel()[self.transpose].reshape(values.shape)

    def product(self, values: FloatArray, f: FloatArray) -> FloatArray:
        """Multiply the matrix of these entries with a function, both in the pattern's order."""
        out = np.empty_like(f)
        derivative_kernels.grouped_product(self.indptr, self.indices, values, f, out)
        return out

    def add_chain_rule(self, entries: FloatArray, out: FloatArray) -> None:
        """Add to ``out`` (F, 2) the derivative by ``v`` for that by the values of ``D_v``."""
        derivative_kernels.assemble_derivative_transposed(self.assembly, entries.ravel(), out)


@per_mesh
def derivative_pattern(mesh: TriangleMesh) -> DerivativePattern:
    """Return the sparsity of ``D_v`` and the linear map from field coefficients to its values."""
    return _pattern(mesh, np.arange(len(mesh.vertices)), mesh.edges, mesh.face_edges)


@per_mesh
def clustered_pattern(mesh: TriangleMesh) -> DerivativePattern:
    """Return the same for functions with one value on each of `vertex_clusters`."""
    clusters = vertex_clusters(mesh)
    if clusters is None:
        return derivative_pattern(mesh)
    ends = np.sort(clusters[mesh.edges], axis=1)
    apart = ends[:, 0] != ends[:, 1]
    edges, found = np.unique(ends[apart], axis=0, return_inverse=True)
    edge_of = np.full(len(ends), -1)
    edge_of[apart] = found.reshape(-1)  # NumPy 2.0 gives a column
    return _pattern(mesh, clusters, edges, edge_of[mesh.face_edges])


def _pattern(
    mesh: TriangleMesh, clusters: IndexArray, edges: IndexArray, face_edges: IndexArray
) -> DerivativePattern:
    """Build the pattern for the cluster of each vertex (V,), edges between clusters and those of
    faces (F, 3), opposite their corners.
    """
    count = int(clusters.max()) + 1
    place = np.argsort(_local_order(edges, count))
    rank = place[clusters]
    groups = -(-(np.bincount(edges.ravel(), minlength=count)[np.argsort(place)] + 1) // GROUP)
    indptr = np.concatenate([[0], np.cumsum(groups)])
    columns, slots = _entries(place[edges], indptr)
    small = np.uint32 if GROUP * indptr[-1] < 2**32 else np.uint64
    indices = np.repeat(np.arange(count, dtype=small), GROUP * groups)
    indices[slots] = columns
    transpose = np.arange(len(indices))
    ahead, back, diagonal = np.split(slots, [len(edges), 2 * len(edges)])
    transpose[ahead], transpose[back] = back, ahead
    corners = clusters[mesh.faces]
    positions = np.empty((len(corners), 3, 3), dtype=small)
    for a, b in np.ndindex(3, 3):
        edge = face_edges[:, (3 - a - b) % 3]  # opposite the third corner
        of_edge = np.where(edges[edge, 0] == corners[:, a], ahead[edge], back[edge])
        is_one = corners[:, a] == corners[:, b]
        positions[:, a, b] = np.where(is_one, diagonal[rank[mesh.faces[:, a]]], of_edge)
    areas = vertex_areas(mesh)
    totals = np.bincount(rank, areas, count)[rank]
    grouped = indices.reshape(-1, GROUP)
    return DerivativePattern(
        order=np.argsort(rank, kind="stable"),
        rank=rank,
        shares=None if count == len(clusters) else areas / totals,
        indptr=indptr.astype(small),
        indices=grouped,
        bounds=_blocks(indptr, grouped).astype(small),
        transpose=transpose,
        assembly=Assembly(
            mesh.faces.astype(small),
            positions,
            hat_gradients(mesh) * (face_areas(mesh) / 3)[:, None, None],
            1 / totals,
        ),
    )


def _entries(edges: IndexArray, indptr: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return the columns of the adjacency's entries, and where these lie in groups: for edges
    (E, 2), first one way, then the other, and then the diagonal, (2E + count,) each.
    """
    count = len(indptr) - 1
    diagonal = np.arange(count)
    rows, columns = (np.concatenate([edges[:, k], edges[:, 1 - k], diagonal]) for k in (0, 1))
    numbers = np.arange(len(rows))
    matrix = sparse.csr_array((numbers, (rows, columns)), shape=(count, count))
    matrix.sort_indices()
    slots = np.empty_like(numbers)
    slots[matrix.data] = numbers + np.repeat(
        GROUP * indptr[:-1] - matrix.indptr[:-1], np.diff(matrix.indptr)
    )
    return columns, slots


def _local_order(edges: IndexArray, count: int) -> IndexArray:
    """Order the nodes of a graph in layers from one end to the other (reverse Cuthill-McKee)."""
    a, b = np.concatenate([edges, edges[:, ::-1]]).T
    adjacency = sparse.csr_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))
    return np.asarray(reverse_cuthill_mckee(adjacency, symmetric_mode=True), dtype=np.int64)


def _blocks(indptr: IndexArray, indices: IndexArray) -> IndexArray:
    """Return the ends of blocks, each with all the neighbours of the block before."""
    count = len(indptr) - 1
    if count < _BLOCKED:
        return np.array([0, count])
    farthest = np.maximum.reduceat(indices.max(axis=1), indptr[:-1].astype(np.int64))
    reach = np.maximum.accumulate(farthest) + 1
    bounds = [0, _BLOCK]
    while bounds[-1] < count:
        bounds.append(min(count, max(bounds[-1] + _BLOCK, int(reach[bounds[-1] - 1]))))
    return np.array(bounds)
