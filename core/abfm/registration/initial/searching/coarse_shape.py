"""Coarse surfaces of about a thousand vertices, with data to relax and compare maps.

The data are distances along the surface, coordinates, and descriptors.
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

COORDINATES = 8  # dimensions of the classical scaling of the distances
EIGENFUNCTIONS = 30  # those by which the commutator of a map with the Laplacian is computed
_COTANGENT_RANGE = (0.01, 20.0)  # clips the edge weights, since those of slivers diverge
_HEAT_TIMES = (0.01, 0.05)
_CURVATURE_SCALES = (0.045, 0.1)  # lengths, in sqrt(area), that smooth the mean curvature
_CURVATURE_MAX = 30.0  # a larger mean curvature, in 1 / sqrt(area), is a crease or noise


class CoarseShape(NamedTuple):
    """A coarse surface of V vertices, scaled to unit area, with data to compare maps."""

    mesh: TriangleMesh
    areas: FloatArray  # (V,), areas with the sum 1
    stiffness: sparse.csr_array  # (V, V), Laplacian of clipped cotangent weights
    distances: FloatArray  # (V, V), along the surface
    coordinates: FloatArray  # (V, 8), with Euclidean distances close to those along the surface
    stretch: float  # Dirichlet energy of the coordinates
    descriptors: FloatArray  # (V, 5), ranks of functions
    eigenvalues: FloatArray  # (K,)
    eigenfunctions: FloatArray  # (V, K)

    def sampled(self, mesh: TriangleMesh, values: ArrayLike) -> FloatArray:
        """Interpolate values of the original mesh, (V',) or (V', C), at the coarse vertices."""
        points = project_onto_surface(mesh.normalized(), self.mesh.vertices)
        return points.pull_back(values)


@per_mesh
def coarse_shape(mesh: TriangleMesh, count: int) -> CoarseShape:
    """Return the coarse shape of a mesh, with about ``count`` vertices, or all if it has fewer."""
    coarse = (coarsened(mesh, count) or mesh).normalized()
    areas = vertex_areas(coarse)
    areas = areas / areas.sum()
    weights = _clipped(coarse)
    distances = _distances(coarse)
    coordinates = _scaling(distances, areas)
    values, functions = unit_eigenbasis(coarse, min(EIGENFUNCTIONS, len(areas)))
    stretch = float((coordinates * (weights @ coordinates)).sum())
    descriptors = _descriptors(coarse, areas)
    return CoarseShape(
        coarse, areas, weights, distances, coordinates, stretch, descriptors, values, functions
    )


def ranks(values: FloatArray, areas: FloatArray) -> FloatArray:
    """Return the ranks of functions (V, C): the shares of the area on which they are smaller.

    The ranks of different values are scaled to mean 0 and standard deviation 1. Equal values have
    equal ranks.
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
    adjacent = sparse.csr_array((weights, (edges.row[off], edges.col[off])), shape=edges.shape)
    return sparse.csr_array(sparse.diags_array(adjacent.sum(axis=1)) - adjacent)


def _distances(mesh: TriangleMesh) -> FloatArray:
    """Return shortest distances (V, V) between vertices, on paths along edges and across them.

    A path across an edge is the line between the two corners opposite the edge, after both faces
    are unfolded into a plane.
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
    # only the shorter one of two lines between the same corners, as a sparse matrix adds entries
    order = np.lexsort((sizes, columns, rows))
    first = np.unique(np.stack([rows, columns], axis=1)[order], axis=0, return_index=True)[1]
    chosen = order[first]
    graph = sparse.csr_array((sizes[chosen], (rows[chosen], columns[chosen])), shape=(count, count))
    return np.asarray(dijkstra(graph, directed=False))


def _scaling(distances: FloatArray, areas: FloatArray) -> FloatArray:
    """Return coordinates (V, 8) that reproduce distances (V, V), by classical scaling."""
    squared = distances**2
    mean = squared @ areas
    gram = -0.5 * (squared - mean[:, None] - mean + areas @ mean)
    root = np.sqrt(areas)
    count = len(areas)
    size = min(COORDINATES, count)
    values, vectors = eigh(root[:, None] * gram * root, subset_by_index=(count - size, count - 1))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)) / root[:, None])


def _descriptors(mesh: TriangleMesh, areas: FloatArray) -> FloatArray:
    """Return the ranks of functions (V, 5) with the same meaning on surfaces of different people.

    The functions are heat kernel signatures, the shape diameter and smoothed mean curvatures.
    """
    found = [HeatKernelSignature(time=time).evaluate(mesh) for time in _HEAT_TIMES]
    try:
        found.append(ShapeDiameter().evaluate(mesh))
    except FunctionError:  # the surface is flat or inside out
        found.append(np.zeros(len(areas)))
    if mesh.is_boundary_vertex.all():
        found += [np.zeros(len(areas))] * len(_CURVATURE_SCALES)
    else:
        curvature = Curvature(kind="mean").evaluate(mesh)
        curvature = np.clip(curvature, -_CURVATURE_MAX, _CURVATURE_MAX)
        found += [smoothed(mesh, curvature[:, None], scale)[:, 0] for scale in _CURVATURE_SCALES]
    return ranks(np.stack(found, axis=1), areas)
