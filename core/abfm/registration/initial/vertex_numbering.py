"""Check whether landmarks count vertices from 0 or from 1."""

import warnings

import numpy as np

from abfm.calculus.operators import edge_graph
from abfm.errors import AbfmWarning
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_LANDMARKS_MIN = 3
_LANDMARKS_MAX = 30  # largest number of landmarks that are compared
# a warning is issued if the other numbering lowers the cost below this share of it. For correct
# landmarks on human shapes, the share is at least 0.54.
_COST_RATIO = 0.5


def pair_cost(a: TriangleMesh, b: TriangleMesh, of_a: IntArray, of_b: IntArray) -> float:
    """Return the mean difference, in sqrt(area), of the distances between landmarks on A and on B.

    Distances are along edges. The landmarks are vertices (L,), and the mean is over all pairs.
    """
    return float(np.abs(_distances(a, of_a) - _distances(b, of_b)).mean())


def warn_of_numbering(
    a: TriangleMesh, b: TriangleMesh, numbers_a: IntArray, numbers_b: IntArray, first: int
) -> None:
    """Warn if landmarks agree much better when vertices are counted from ``1 - first``.

    ``numbers_a`` and ``numbers_b`` (L,) are vertices counted from ``first``, 0 or 1. Surfaces with
    the same faces are not checked, as equal vertex numbers correspond in both cases.
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
            f"the vertices of landmarks seem to be counted from {other} instead of {first}. "
            "Distances between landmarks on A and on B then differ by a mean of "
            f"{lower:.2g} instead of {cost:.2g} sqrt(area). "
            f"{'Remove' if first else 'Use'} --one-based",
            AbfmWarning,
            stacklevel=3,
        )


def _distances(mesh: TriangleMesh, vertices: IntArray) -> FloatArray:
    from scipy.sparse.csgraph import dijkstra  # imported here, as it is slow to import

    found = dijkstra(edge_graph(mesh), directed=False, indices=vertices)[:, vertices]
    return np.asarray(found / mesh.length_scale)
