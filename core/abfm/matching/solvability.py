"""What the functions alone say of a match: what no flow can do, or this mesh, and what goes astray.

A flow makes no new values, and neither splits nor joins peaks: functions that need this have no
match. The discrete flow can do both, between vertices, and its own residual does not show it.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.csgraph import maximum_bipartite_matching

from abfm.calculus.channels import channels
from abfm.calculus.operators import edge_areas, edge_lengths
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh import TriangleMesh
from abfm.mesh.topology import grouped
from abfm.numerics.kernels import kernel
from abfm.types import FloatArray, IndexArray, IntArray

SHARE = 0.2  # of the range, by which a peak stands out that is counted
_DIFFERENCE_SHARE = 0.1  # of the range, by which what a flow leaves is beyond doubt
_ZERO_SHARE = 0.005  # of the range: values nearer to 0 are reported as 0
_DETAIL_SHARE = 0.02  # of the range, by which what is counted as detail stands out
# peaks and pits: functions with more are measured, or as hard to match exactly
_EXTREMA_MAX = 20
# edges per width below which advection over a quarter of a body (half of sqrt(area)) is off by
# several percent
RESOLUTION_MIN = 5.0
_VARIATION_SHARE = 0.75  # of the variation lies on edges along which the function changes less
# of source's and target's deviations: what has vanished has less. Of 18 matches of Gaussians
# those that ended at a mismatch of 1 had a share below 0.01, all others one above 0.4
_DEVIATION_SHARE = 0.2
# of what source and target differ by: what moves changes by 0.4 or more within five iterations
_STILL_SHARE = 0.1
_ROUNDING_SHARE = 1e-12  # of the largest value: a function of a smaller range has no peaks
_CONSTANT_SHARE = 1e-9  # of the largest value: a smaller range is a constant


def within_range(functions: FunctionTerm) -> FloatArray:
    """Clip the target (C, V) to the values that the source has: the best that they allow."""
    source = functions.source
    low, high = source.min(axis=1, keepdims=True), source.max(axis=1, keepdims=True)
    return np.asarray(np.clip(functions.target, low, high))


def range_bound(functions: FunctionTerm) -> float:
    """Return the least residual that any flow can leave; 0 if the source has all values:
    ``|f_tau - g| >= |clip(g, min f, max f) - g|`` everywhere.
    """
    return functions.residual(within_range(functions))


def value_gap(functions: FunctionTerm) -> float:
    """Return the larger residual of the values that one of two functions has and the other lacks.

    It is the same for the match from g to f: values of the source that the target lacks cannot
    vanish along a flow either, although their area can.
    """
    return max(range_bound(functions), range_bound(functions.reversed()))


def worst_channel(functions: FunctionTerm) -> int:
    """Return the channel in which one of the functions lacks most of the other's values."""
    sides = (functions, functions.reversed())
    gaps = [((within_range(side) - side.target) ** 2) @ side.areas for side in sides]
    return int(np.argmax(np.maximum(*gaps) * functions.weights))


def source_is_constant(functions: FunctionTerm) -> bool:
    """Tell whether every channel that counts has one value all over the surface."""
    return _constant(functions.source[_counting(functions)])


def target_is_constant(functions: FunctionTerm) -> bool:
    """Tell whether every channel that counts has one value wherever the mask is above 0."""
    return _constant(functions.target[_counting(functions)][:, functions.areas > 0])


def distance(functions: FunctionTerm) -> float:
    """Return how far the source has to go straight through space, in sqrt(area), in the channel
    where it is most: between the centres of what it has too much and too little of, or 0.
    """
    excess = (functions.source - functions.target)[_counting(functions)] * functions.areas
    more, less = np.maximum(excess, 0), np.maximum(-excess, 0)
    known = (more.sum(axis=1) > 0) & (less.sum(axis=1) > 0)
    if not known.any():
        return 0.0
    mesh = functions.mesh
    here, there = (
        part @ mesh.vertices / part.sum(axis=1)[:, None] for part in (more[known], less[known])
    )
    return float(np.linalg.norm(here - there, axis=1).max()) / mesh.length_scale


def squeezed(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Tell whether the flow gained more by shrinking the source, to half or less, than by moving.

    With ``a`` the advected source (C, V), and all less their means, ``|a - g|^2`` falls by
    ``|f|^2 - |a|^2``, which is shrinking, and by ``2 <a - f, g>``, which is moving.
    """
    size = min(functions.deviation(functions.source), functions.deviation(functions.target)) ** 2
    left = functions.deviation(advected) ** 2
    moved = 2 * functions.covariance(advected - functions.source, functions.target)
    return left < size / 2 and size - left > moved


def vanished(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Tell whether the flow squeezed the source to nothing (C, V) though the target is not flat."""
    least = min(functions.deviation(functions.source), functions.deviation(functions.target))
    return functions.deviation(advected) < _DEVIATION_SHARE * least


def stood_still(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Tell whether the flow left the source where it was, though the target is elsewhere."""
    apart = functions.norm(functions.source - functions.target)
    return functions.norm(advected - functions.source) < _STILL_SHARE * apart


def resolution(mesh: TriangleMesh, f: ArrayLike) -> float:
    """Return how many edges the narrow features of a function (V,) or (V, C) span; of several
    channels the least, inf for constants.

    Half the function's range over its change along an edge: over that which the function exceeds on
    a quarter of its variation ``int |grad f|^2``. That makes it the width over the edge length, to
    within 15 percent, of a Gaussian ``exp(-r^2 / (2 width^2))`` on an even mesh, if it is at least
    one edge wide. A jump spans half an edge. Bumps that are much lower than others do not count.
    """
    return min(_of_channel(mesh, channel) for channel in channels(mesh, f, "f"))


def narrowest(functions: FunctionTerm) -> float:
    """Return `resolution` of source and target, of the channels that count, and of the target where
    the mask does.
    """
    mesh, counting, known = functions.mesh, functions.weights > 0, functions.areas > 0
    sources = [_of_channel(mesh, f) for f in functions.source[counting]]
    targets = [_of_channel(mesh, g, known) for g in functions.target[counting]]
    return min(sources + targets, default=np.inf)


def _of_channel(mesh: TriangleMesh, f: FloatArray, known: IndexArray | None = None) -> float:
    known = np.ones(len(f), dtype=bool) if known is None else known
    span = float(np.ptp(f[known])) if known.any() else 0.0
    if span <= _CONSTANT_SHARE * np.abs(f[known]).max(initial=0.0):
        return np.inf
    within = known[mesh.edges].all(axis=1)
    start, end = mesh.edges[within].T
    changes = np.abs(f[end] - f[start]) / span
    variation = edge_areas(mesh)[within] * (changes / edge_lengths(mesh)[within]) ** 2
    if not variation.any():
        return np.inf
    order = np.argsort(changes, kind="stable")
    below = np.cumsum(variation[order])
    return 0.5 / float(changes[order[np.searchsorted(below, _VARIATION_SHARE * below[-1])]])


def _counting(functions: FunctionTerm) -> IntArray:
    return np.flatnonzero(functions.weights)


def _constant(values: FloatArray) -> bool:
    return bool((np.ptp(values, axis=1) <= _CONSTANT_SHARE * np.abs(values).max(axis=1)).all())


# The 0-dimensional persistence of a peak is how far one must go down from it to the pass to a
# higher one (Edelsbrunner and Harer, Computational Topology, 2010, chapter VII). A flow carries a
# function along a homeomorphism, so all of its peaks and pits arrive with their values and those of
# their passes. If two functions differ by at most ``e`` everywhere, their peaks pair up, but for
# those that stand out by at most ``2 e``, with values and passes that differ by at most ``e``
# (Cohen-Steiner, Edelsbrunner and Harer 2007).


class Extrema(NamedTuple):
    peaks: int
    pits: int

    def __str__(self) -> str:
        counts = ((self.peaks, "peak"), (self.pits, "pit"))
        return " and ".join(f"{n} {name}{'s' * (n != 1)}" for n, name in counts)


Counted: TypeAlias = Extrema | str
Difference: TypeAlias = tuple[Counted, Counted]


def persistence(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    """Persistence above 0 of each peak of a function (V,), largest first; for pits give ``-f``."""
    births, deaths = diagram(mesh, f).T
    return np.asarray(births - deaths)


def diagram(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    """Return the value of each peak of a function (V,), and that at which it meets a higher one,
    (K, 2), where they differ; the peak that stands out most comes first.
    """
    if not np.ptp(f) > _ROUNDING_SHARE * np.abs(f).max():
        return np.empty((0, 2))
    falling = np.argsort(-f, kind="stable")  # of equal values the first one counts as higher
    rank = np.empty(len(f), dtype=np.int64)
    rank[falling] = np.arange(len(f))
    births = f[falling]
    found = np.stack([births, births[_deaths(mesh.edges, rank)]], axis=1)
    found = found[found[:, 0] > found[:, 1]]
    return np.asarray(found[np.argsort(found[:, 1] - found[:, 0], kind="stable")])


def is_measured(functions: FunctionTerm) -> bool:
    """Tell whether functions have so much detail that they are taken for measured ones, which match
    as far as they are alike: the peaks and pits of source or target, in any channel, that stand out
    by a share of the range that noise of a tenth of a deviation makes, too. Approximate functions
    are treated alike.
    """
    if functions.approximate and not functions.is_constant:
        return True
    counts = [
        sum(peaks(functions.mesh, f, _DETAIL_SHARE))
        for both in (functions.source, functions.target)
        for f in both[_counting(functions)]
    ]
    return max(counts, default=0) > _EXTREMA_MAX


def peaks(mesh: TriangleMesh, f: FloatArray, share: float = SHARE) -> Extrema:
    """Count peaks and pits of a function (V,) that stand out by a share of its range."""
    return _count(_both(mesh, f), share * float(np.ptp(f)))


def extrema_difference(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> Difference | None:
    """Tell what peaks and pits two functions (V,) have, where they differ beyond doubt: one of them
    has no counterpart whose value and whose pass differ by at most 0.1 of the larger range, and
    stands out by more than twice that. Then every flow leaves a difference of as much somewhere.

    Returned are those by 0.2 of the range, or, of equal numbers, what has no counterpart.
    """
    scale = float(max(np.ptp(f), np.ptp(g)))
    counts = tuple(_count(_both(mesh, values), SHARE * scale) for values in (f, g))
    for kind, side, sign in (("peak", "above", 1), ("pit", "below", -1)):
        one, other = (sign * diagram(mesh, sign * values) for values in (f, g))
        alone = (
            _alone(one, other, _DIFFERENCE_SHARE * scale),
            _alone(other, one, _DIFFERENCE_SHARE * scale),
        )
        if not any(map(len, alone)):
            continue
        if counts[0] != counts[1]:
            return counts[0], counts[1]
        least = _ZERO_SHARE * scale
        here, there = (
            " ".join(
                f"{word} {0 if abs(value) < least else value:.2g}"
                for word, value in zip((f"a {kind} at", f"{side} a pass at"), rows[0], strict=True)
            )
            if len(rows)
            else f"no such {kind}"
            for rows in alone
        )
        return here, there
    return None


def _alone(one: FloatArray, other: FloatArray, most: float) -> FloatArray:
    """Return which rows of a diagram (K, 2) stand out by more than twice a difference, and go
    without a counterpart in the other (L, 2) that is within it, as few of them as can be.
    """
    one = one[np.abs(one[:, 0] - one[:, 1]) > 2 * most]
    near = np.abs(one[:, None] - other[None]).max(axis=-1, initial=0.0) <= most
    pairs = maximum_bipartite_matching(sparse.csr_array(near), perm_type="column")
    alone: FloatArray = one[pairs < 0]
    return alone


def boundary_difference(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> Difference | None:
    """Tell where the values of two functions (V,) differ most, and by more than 0.1 of the larger
    range, of the places that a flow leads to themselves: pieces of the boundary, and parts of the
    surface that touch the rest at pinched vertices.
    """
    scale = float(max(np.ptp(f), np.ptp(g)))
    most, told, at = _DIFFERENCE_SHARE * scale, None, ""
    parts = grouped(mesh.faces, mesh.parts) if mesh.parts.any() else []
    for name, places in (
        ("a boundary", mesh.boundary_loops),
        ("a part joined at vertices alone", parts),
    ):
        for place in places:
            ranges = np.array([[h[place].min(), h[place].max()] for h in (f, g)])
            apart = float(np.abs(ranges[0] - ranges[1]).max())
            if apart > most:
                most, told, at = apart, ranges, name
    if told is None:
        return None
    told[np.abs(told) < _ZERO_SHARE * scale] = 0.0
    here, there = (f"from {low:.2g} to {high:.2g}" for low, high in told)
    return f"values {here} on {at}", f"{there} there"


def first_difference(functions: FunctionTerm) -> tuple[int, Counted, Counted] | None:
    """Return the first channel with features that no flow changes, and the features of both sides.

    None if neither `extrema_difference` nor `boundary_difference` finds any, or if a vertex is
    masked, since the mask may hide the difference.
    """
    if (functions.areas > 0).all():
        for channel in _counting(functions):
            f, g = functions.source[channel], functions.target[channel]
            for apart in (extrema_difference, boundary_difference):
                found = apart(functions.mesh, f, g)
                if found is not None:
                    return int(channel), *found
    return None


def _both(mesh: TriangleMesh, f: FloatArray) -> tuple[FloatArray, FloatArray]:
    return persistence(mesh, f), persistence(mesh, -f)


def _count(persistences: tuple[FloatArray, FloatArray], least: float) -> Extrema:
    return Extrema(*(int((values >= least).sum()) for values in persistences))


@kernel
def _deaths(edges: IndexArray, rank: IndexArray) -> IndexArray:
    """Rank at which the peak at each rank meets a higher one, (V,); rank 0 is the highest vertex.

    Other vertices meet one at their own rank; the highest peak lasts to the end.
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
