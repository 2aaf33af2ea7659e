"""A surface on about a thousand vertices: the distances, coordinates and descriptors by which maps
to it are relaxed and compared.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.csgraph import dijkstra

from abfm.calculus.eigenbasis import unit_eigenbasis
from abfm.calculus.operators import cotangent_laplacian, vertex_areas
from abfm.calculus.smoothing import smoothed
from abfm.errors import FunctionError
from abfm.functions.local_shape import Curvature, ShapeDiameter
from abfm.functions.spectral import HeatKernelSignature
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh, per_mesh
from abfm.mesh.coarsening import coarsened
from abfm.mesh.topology import next_corner
from abfm.types import FloatArray, IntArray

COORDINATES = 8  # of the classical scaling of the distances
EIGENFUNCTIONS = 30  # by which maps commute with the Laplacian, or do not
_COTANGENT_RANGE = (0.01, 20.0)  # to which weights of edges are clipped; those of slivers diverge
_HEAT_TIMES = (0.01, 0.05)
_CURVATURE_SCALES = (0.045, 0.1)  # sqrt(area) over which the mean curvature is smoothed
_CURVATURE_MAX = 30.0  # over sqrt(area); more is a crease or noise


class CoarseShape(NamedTuple):
    """A surface of unit area on V vertices."""

    mesh: TriangleMesh
    areas: FloatArray  # (V,), of sum 1
    stiffness: sparse.csr_array  # (V, V), of clipped cotangent weights
    distances: FloatArray  # (V, V), along the surface
    coordinates: FloatArray  # (V, 8), whose Euclidean distances are near those along the surface
    stretch: float  # Dirichlet energy of the coordinates
    descriptors: FloatArray  # (V, 5), by rank
    eigenvalues: FloatArray  # (K,)
    eigenfunctions: FloatArray  # (V, K)

    def sampled(self, mesh: TriangleMesh, values: ArrayLike) -> FloatArray:
        """Return values of the fine mesh, (V',) or (V', C), at the coarse vertices."""
        points = project_onto_surface(mesh.normalized(), self.mesh.vertices)
        return points.pull_back(values)


@per_mesh
def coarse_shape(mesh: TriangleMesh, count: int) -> CoarseShape:
    """Return the surface on about ``count`` vertices, or on its own if it has fewer."""
    coarse = (coarsened(mesh, count) or mesh).normalized()
    areas = vertex_areas(coarse)
    areas = areas / areas.sum()
    weights = _clipped(coarse)
    distances = _distances(coarse)
    coordinates = _scaling(distances, areas)
    size = min(EIGENFUNCTIONS, len(areas))
    values, functions = unit_eigenbasis(coarse, size)
    stretch = float((coordinates * (weights @ coordinates)).sum())
    return CoarseShape(
        coarse,
        areas,
        weights,
        distances,
        coordinates,
        stretch,
        _descriptors(coarse, areas),
        values,
        functions,
    )


def ranks(values: FloatArray, areas: FloatArray) -> FloatArray:
    """Return functions (V, C) as the share of the area on which they are less, of mean 0 and
    deviation 1 where no values are equal; equal values have equal ranks.
    """
    found = np.empty(values.shape)
    for c, column in enumerate(values.T):
        _, inverse = np.unique(column, return_inverse=True)
        sizes = np.bincount(inverse, areas)
        found[:, c] = (np.cumsum(sizes) - sizes / 2)[inverse]
    return np.asarray(np.sqrt(12) * (found - 0.5))


def _clipped(mesh: TriangleMesh) -> sparse.csr_array:
    edges = sparse.coo_array(cotangent_laplacian(mesh))
    off = edges.row != edges.col
    weights = np.clip(-edges.data[off], *_COTANGENT_RANGE)
    shape = edges.shape
    adjacent = sparse.csr_array((weights, (edges.row[off], edges.col[off])), shape=shape)
    return sparse.csr_array(sparse.diags_array(adjacent.sum(axis=1)) - adjacent)


def _distances(mesh: TriangleMesh) -> FloatArray:
    """Return distances between all vertices along edges and, across each edge, along the line
    between its opposite corners once both faces are unfolded.
    """
    inner = mesh.edge_slots[~mesh.is_boundary_edge]
    corners = mesh.faces.ravel()
    start, end = corners[next_corner(inner[:, 0])], corners[next_corner(next_corner(inner[:, 0]))]
    left, right = corners[inner[:, 0]], corners[inner[:, 1]]
    points = mesh.vertices
    along = points[end] - points[start]
    length = np.linalg.norm(along, axis=1)
    unit = along / length[:, None]

    def unfolded(corner: IntArray) -> tuple[FloatArray, FloatArray]:
        offset = points[corner] - points[start]
        x = (offset * unit).sum(axis=1)
        return x, np.linalg.norm(offset - x[:, None] * unit, axis=1)

    (x1, y1), (x2, y2) = unfolded(left), unfolded(right)
    across = np.hypot(x1 - x2, y1 + y2)
    crossing = x1 + (x2 - x1) * y1 / (y1 + y2)
    direct = (crossing >= 0) & (crossing <= length)
    one, other = mesh.edges.T
    rows = np.concatenate([one, left[direct]])
    columns = np.concatenate([other, right[direct]])
    sizes = np.concatenate([np.linalg.norm(points[one] - points[other], axis=1), across[direct]])
    count = len(points)
    # of two lines between the same corners the shorter one: a sparse matrix would add them
    order = np.lexsort((sizes, columns, rows))
    first = np.unique(np.stack([rows, columns], axis=1)[order], axis=0, return_index=True)[1]
    kept = order[first]
    graph = sparse.csr_array((sizes[kept], (rows[kept], columns[kept])), shape=(count, count))
    return np.asarray(dijkstra(graph, directed=False))


def _scaling(distances: FloatArray, areas: FloatArray) -> FloatArray:
    """Return classical scaling weighted by area: the coordinates with the largest variance."""
    squared = distances**2
    mean = squared @ areas
    gram = -0.5 * (squared - mean[:, None] - mean + areas @ mean)
    root = np.sqrt(areas)
    count = len(areas)
    size = min(COORDINATES, count)
    values, vectors = eigh(root[:, None] * gram * root, subset_by_index=(count - size, count - 1))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)) / root[:, None])


def _descriptors(mesh: TriangleMesh, areas: FloatArray) -> FloatArray:
    """Return functions (V, 5) that mean the same on surfaces of different people, by rank."""
    found = [HeatKernelSignature(time=time).evaluate(mesh) for time in _HEAT_TIMES]
    try:
        found.append(ShapeDiameter().evaluate(mesh))
    except FunctionError:  # flat or inside out
        found.append(np.zeros(len(areas)))
    if mesh.is_boundary_vertex.all():
        found += [np.zeros(len(areas))] * len(_CURVATURE_SCALES)
    else:
        curvature = Curvature(kind="mean").evaluate(mesh)
        curvature = np.clip(curvature, -_CURVATURE_MAX, _CURVATURE_MAX)
        found += [smoothed(mesh, curvature[:, None], scale)[:, 0] for scale in _CURVATURE_SCALES]
    return ranks(np.stack(found, axis=1), areas)
