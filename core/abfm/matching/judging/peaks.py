"""Peaks and pits of a function, and how far each stands out: what no flow changes.

The 0-dimensional persistence of a peak is how far one must go down from it to reach a higher one
(Edelsbrunner and Harer, Computational Topology, 2010, chapter VII). A flow carries a function along
a homeomorphism, so all of its peaks and pits arrive with their persistence. If two functions differ
by less than ``e`` everywhere, their peaks pair up with persistences that differ by less than
``2 e``, but for those below ``2 e`` (Cohen-Steiner, Edelsbrunner and Harer 2007).
"""

from typing import NamedTuple

import numpy as np

from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray

SHARE = 0.2
"""Share of the range by which a peak stands out that is counted."""

# shares that bound SHARE where two functions are compared: half of what is between is the error
_LOW, _HIGH = 0.1, 0.3
_CONSTANT = 1e-12  # of the largest value: a smaller range is rounding


class Extrema(NamedTuple):
    """How many peaks and pits a function has."""

    peaks: int
    pits: int

    def __str__(self) -> str:
        return f"{_counted(self.peaks, 'peak')} and {_counted(self.pits, 'pit')}"


def persistence(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    """Persistence of each peak of a function (V,), largest first, in the function's units, all
    above 0.

    The first is that of the highest peak, the range ``max f - min f``. A plateau is one peak. A
    constant has none. The boundary is like the rest of the surface: a function that rises up to it
    has a peak there. For pits give ``-f``.
    """
    if not np.ptp(f) > _CONSTANT * np.abs(f).max():
        return np.empty(0)
    # of equal values the one that comes first counts as higher
    falling = np.argsort(-f, kind="stable")
    rank = np.empty(len(f), dtype=np.int64)
    rank[falling] = np.arange(len(f))
    sorted_values = f[falling]
    found = sorted_values - sorted_values[_deaths(mesh.edges, rank)]
    return np.sort(found[found > 0])[::-1]


def peaks(mesh: TriangleMesh, f: FloatArray, share: float = SHARE) -> Extrema:
    """Number of peaks and pits of a function (V,) that stand out by a share of its range; of a
    constant 0 and 0.

    Parameters
    ----------
    share : float
        Least persistence, as a fraction of ``max f - min f``, 0 to 1.
    """
    return _count(_both(mesh, f), share * float(np.ptp(f)))


def peaks_apart(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> tuple[Extrema, Extrema] | None:
    """Peaks and pits of two functions (V,) where they differ beyond doubt, else None.

    Beyond doubt: one has more that stand out by 0.3 of the larger range than the other has by 0.1
    of it. Then every flow leaves a difference of at least 0.1 of that range somewhere. The numbers
    told are those by 0.2, and differ too.
    """
    scale = float(max(np.ptp(f), np.ptp(g)))
    one, other = _both(mesh, f), _both(mesh, g)
    for first, second in ((one, other), (other, one)):
        high, low = _count(first, _HIGH * scale), _count(second, _LOW * scale)
        if high.peaks > low.peaks or high.pits > low.pits:
            return _count(one, SHARE * scale), _count(other, SHARE * scale)
    return None


def _both(mesh: TriangleMesh, f: FloatArray) -> tuple[FloatArray, FloatArray]:
    return persistence(mesh, f), persistence(mesh, -f)


def _count(persistences: tuple[FloatArray, FloatArray], least: float) -> Extrema:
    return Extrema(*(int((values >= least).sum()) for values in persistences))


def _counted(number: int, name: str) -> str:
    return f"{number} {name}" + ("" if number == 1 else "s")


@kernel
def _deaths(edges: IndexArray, rank: IndexArray) -> IndexArray:
    """Rank at which the peak at each rank meets a higher one, (V,); rank 0 is the highest vertex.

    A vertex that is no peak meets a higher one at its own rank; the highest peak lasts to the end.
    Edges (E, 2) are looked at in the order of their lower ends; components of what is above are
    kept by their highest ranks. SciPy's components of a graph would not tell when they meet.
    """
    size = rank.size
    starts = np.zeros(size + 1, dtype=np.int64)
    for e in range(edges.shape[0]):
        starts[max(rank[edges[e, 0]], rank[edges[e, 1]]) + 1] += 1
    starts = np.cumsum(starts)
    # the neighbours above each rank, one rank after the other
    higher = np.empty(edges.shape[0], dtype=np.int64)
    free = starts.copy()
    for e in range(edges.shape[0]):
        a, b = rank[edges[e, 0]], rank[edges[e, 1]]
        higher[free[max(a, b)]] = min(a, b)
        free[max(a, b)] += 1
    parents = np.arange(size)
    deaths = np.full(size, size - 1)
    for low in range(size):
        top = low
        for k in range(starts[low], starts[low + 1]):
            other = higher[k]
            while parents[other] != other:
                parents[other] = parents[parents[other]]
                other = parents[other]
            if other != top:
                deaths[max(top, other)] = low
                parents[max(top, other)] = min(top, other)
                top = min(top, other)
    return deaths
