"""Whether landmarks count vertices from 0 or from 1."""

import warnings

import numpy as np

from abfm.calculus.operators import edge_graph
from abfm.errors import AbfmWarning
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_LANDMARKS_MIN = 3
_LANDMARKS_MAX = 30  # that are compared, of more landmarks
_COST_RATIO = 0.5  # shifted right landmarks have at least 0.54 of the cost, on human shapes


def pair_cost(a: TriangleMesh, b: TriangleMesh, of_a: IntArray, of_b: IntArray) -> float:
    """Return how much distances between landmarks (L,) differ from A to B, in sqrt(area): the mean
    over all pairs, along edges.
    """
    return float(np.abs(_distances(a, of_a) - _distances(b, of_b)).mean())


def warn_of_numbering(
    a: TriangleMesh, b: TriangleMesh, numbers_a: IntArray, numbers_b: IntArray, first: int
) -> None:
    """Warn if landmarks (L,), numbers of vertices counted from ``first``, 0 or 1, correspond much
    better if counted from the other one. Nothing is known of surfaces with the same faces, where
    any vertices correspond.
    """
    if len(numbers_a) < _LANDMARKS_MIN or np.array_equal(a.faces, b.faces):
        return
    other = 1 - first
    some = np.unique(np.linspace(0, len(numbers_a) - 1, _LANDMARKS_MAX).astype(int))
    pairs = (a, numbers_a[some]), (b, numbers_b[some])
    given, shifted = ([mesh.local_vertices(n - k) for mesh, n in pairs] for k in (first, other))
    if any((rows < 0).any() for rows in (*given, *shifted)):
        return
    cost, lower = pair_cost(a, b, *given), pair_cost(a, b, *shifted)
    if lower < _COST_RATIO * cost:
        warnings.warn(
            f"landmarks are counted from {first}, but distances between them fit better if they "
            f"are counted from {other} (they differ by {lower:.2g} instead of {cost:.2g} "
            f"sqrt(area)): {'leave out ' * first}--one-based",
            AbfmWarning,
            stacklevel=3,
        )


def _distances(mesh: TriangleMesh, vertices: IntArray) -> FloatArray:
    from scipy.sparse.csgraph import dijkstra  # slow to import

    found = dijkstra(edge_graph(mesh), directed=False, indices=vertices)[:, vertices]
    return np.asarray(found / mesh.length_scale)
