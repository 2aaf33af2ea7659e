"""Properties of functions that prevent or limit a match, and signs of a failing match.

A flow neither makes new values nor splits or joins peaks. Functions that need this have no match.
The discrete flow can do both between vertices, and its residual does not show it.
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

# shares of the range of a function
SHARE = 0.2  # least persistence of a peak that is counted
_DIFFERENCE_SHARE = 0.1  # functions with a larger difference of values certainly differ
_ZERO_SHARE = 0.005  # values closer to 0 are reported as 0
_DETAIL_SHARE = 0.02  # least persistence of peaks and pits that count as detail
# functions with more peaks and pits are treated as measured, since no match is exact
_EXTREMA_MAX = 20
# edges per width of a feature. With fewer, advection over half of sqrt(area) has errors of
# several percent.
RESOLUTION_MIN = 5.0
_VARIATION_SHARE = 0.75  # share of variation on edges with smaller changes, see `resolution`
# a source has vanished if its standard deviation is below this share of the original one. Among 18
# matches of Gaussians, those with a final mismatch of 1 had a share below 0.01, others above 0.4.
_DEVIATION_SHARE = 0.2
# a source that changed by a smaller share of its difference from the target stood still. Sources
# that move change by 0.4 within five iterations.
_STILL_SHARE = 0.1
_ROUNDING_SHARE = 1e-12  # functions with a smaller range, relative to their size, have no peaks
_CONSTANT_SHARE = 1e-9  # functions with a smaller range, relative to their size, are constant


def within_range(functions: FunctionTerm) -> FloatArray:
    """Return the target (C, V), clipped to the range of the source: the best possible match."""
    source = functions.source
    low, high = source.min(axis=1, keepdims=True), source.max(axis=1, keepdims=True)
    return np.asarray(np.clip(functions.target, low, high))


def range_bound(functions: FunctionTerm) -> float:
    """Return a lower bound of the residual of every flow from the source to the target.

    A flow preserves the range of the source, so ``|f_tau - g| >= |clip(g, min f, max f) - g|``
    everywhere. The bound is 0 if the source has all values of the target. Values that only the
    source has do not count, because a flow can squeeze them to an arbitrarily small area.
    """
    return functions.residual(within_range(functions))


def value_gap(functions: FunctionTerm) -> float:
    """Return the larger `range_bound` of the matches from f to g and from g to f."""
    return max(range_bound(functions), range_bound(functions.reversed()))


def worst_channel(functions: FunctionTerm) -> int:
    """Return the index of the channel in which the ranges of the functions differ most."""
    sides = (functions, functions.reversed())
    gaps = [((within_range(side) - side.target) ** 2) @ side.areas for side in sides]
    return int(np.argmax(np.maximum(*gaps) * functions.weights))


def source_is_constant(functions: FunctionTerm) -> bool:
    """Return whether the source is constant in every channel with a weight above 0."""
    return _constant(functions.source[_weighted_channels(functions)])


def target_is_constant(functions: FunctionTerm) -> bool:
    return _constant(functions.target[_weighted_channels(functions)][:, functions.areas > 0])


def distance(functions: FunctionTerm) -> float:
    """Return the straight distance over which the source has to move, in sqrt(area).

    The difference of source and target has a positive and a negative part. The distance is that
    between their centres, in the channel where it is largest; 0 if no channel has both parts.
    """
    excess = (functions.source - functions.target)[_weighted_channels(functions)] * functions.areas
    more, less = np.maximum(excess, 0), np.maximum(-excess, 0)
    known = (more.sum(axis=1) > 0) & (less.sum(axis=1) > 0)
    if not known.any():
        return 0.0
    mesh = functions.mesh
    start, end = (
        part @ mesh.vertices / part.sum(axis=1)[:, None] for part in (more[known], less[known])
    )
    return float(np.linalg.norm(start - end, axis=1).max()) / mesh.length_scale


def squeezed(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Return whether shrinking the source reduced the mismatch more than moving it.

    Let ``a`` be the advected source (C, V), and subtract the mean of each function. Shrinking then
    lowers ``|a - g|^2`` by ``|f|^2 - |a|^2``, and motion lowers it by ``2 <a - f, g>``.
    """
    size = min(functions.deviation(functions.source), functions.deviation(functions.target)) ** 2
    remaining = functions.deviation(advected) ** 2
    moved = 2 * functions.covariance(advected - functions.source, functions.target)
    return remaining < size / 2 and size - remaining > moved


def vanished(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Return whether the advected source (C, V) is almost constant, unlike source and target."""
    least = min(functions.deviation(functions.source), functions.deviation(functions.target))
    return functions.deviation(advected) < _DEVIATION_SHARE * least


def hardly_moved(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Return whether the flow hardly moved the source, although source and target differ."""
    difference = functions.norm(functions.source - functions.target)
    return functions.norm(advected - functions.source) < _STILL_SHARE * difference


def resolution(mesh: TriangleMesh, f: ArrayLike) -> float:
    """Return the width of the narrow features of a function (V,) or (V, C), in edges.

    The width is half the range of the function, divided by a large change along an edge. Edges with
    larger changes have a quarter of the variation ``int |grad f|^2``. With several channels, the
    result is the smallest width. It is infinite for constants.

    A Gaussian ``exp(-r^2 / (2 width^2))`` on a regular mesh spans its width divided by the edge
    length, to within 15%. Its width has to be at least one edge. A jump spans half an edge. Bumps
    that are much lower than others are ignored.
    """
    return min(_of_channel(mesh, channel) for channel in channels(mesh, f, "f"))


def narrowest(functions: FunctionTerm) -> float:
    """Return the smallest `resolution` of source and target in weighted channels, in edges.

    Masked vertices of the source count, but not those of the target.
    """
    mesh, weighted, known = functions.mesh, functions.weights > 0, functions.areas > 0
    sources = [_of_channel(mesh, f) for f in functions.source[weighted]]
    targets = [_of_channel(mesh, g, known) for g in functions.target[weighted]]
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


def _weighted_channels(functions: FunctionTerm) -> IntArray:
    return np.flatnonzero(functions.weights)


def _constant(values: FloatArray) -> bool:
    return bool((np.ptp(values, axis=1) <= _CONSTANT_SHARE * np.abs(values).max(axis=1)).all())


# The 0-dimensional persistence of a peak is its height above the pass to a higher peak
# (Edelsbrunner and Harer, Computational Topology, 2010, chapter VII). A flow advects a function
# along a homeomorphism, which preserves the values of all peaks, pits and passes. If two functions
# differ by at most ``e`` everywhere, their peaks of a persistence above ``2 e`` form pairs. Values
# and passes of a pair differ by at most ``e`` (Cohen-Steiner, Edelsbrunner and Harer 2007).


class Extrema(NamedTuple):
    """The numbers of peaks (maxima) and pits (minima) of a function."""

    peaks: int
    pits: int

    def __str__(self) -> str:
        counts = ((self.peaks, "peak"), (self.pits, "pit"))
        return " and ".join(f"{n} {name}{'s' * (n != 1)}" for n, name in counts)


Counted: TypeAlias = Extrema | str
Difference: TypeAlias = tuple[Counted, Counted]


def persistence(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    """Return the persistence of each peak of f (V,), if above 0, in descending order.

    Use -f for pits. The persistence is the height of the peak above its pass to a higher peak.
    """
    births, deaths = diagram(mesh, f).T
    return np.asarray(births - deaths)


def diagram(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    """Return the persistence diagram of the peaks of a function (V,), as rows (K, 2).

    A row has the value at a peak and the value at its pass to a higher peak. For the highest peak,
    the second value is the minimum of the function. Peaks of persistence 0 are omitted, and the
    peak of the largest persistence is the first one.
    """
    if not np.ptp(f) > _ROUNDING_SHARE * np.abs(f).max():
        return np.empty((0, 2))
    falling = np.argsort(-f, kind="stable")  # the first one of equal values counts as higher
    rank = np.empty(len(f), dtype=np.int64)
    rank[falling] = np.arange(len(f))
    births = f[falling]
    found = np.stack([births, births[_deaths(mesh.edges, rank)]], axis=1)
    found = found[found[:, 0] > found[:, 1]]
    return np.asarray(found[np.argsort(found[:, 1] - found[:, 0], kind="stable")])


def is_measured(functions: FunctionTerm) -> bool:
    """Return whether functions have so much detail that they are treated as measured.

    Measured functions match only approximately. They have more than 20 peaks and pits with a
    persistence above 2% of the range, in any channel of source or target. Noise whose standard
    deviation is a tenth of that of the function also causes such peaks. Functions that the user
    declares as approximate are also treated as measured.
    """
    if functions.approximate and not functions.is_constant:
        return True
    counts = [
        sum(peaks(functions.mesh, f, _DETAIL_SHARE))
        for both in (functions.source, functions.target)
        for f in both[_weighted_channels(functions)]
    ]
    return max(counts, default=0) > _EXTREMA_MAX


def peaks(mesh: TriangleMesh, f: FloatArray, share: float = SHARE) -> Extrema:
    """Count the peaks and pits of a function (V,) with a persistence above a share of its range."""
    return _count(_both(mesh, f), share * float(np.ptp(f)))


def extrema_difference(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> Difference | None:
    """Return the peaks and pits of two functions (V,) if they certainly differ, else None.

    The functions differ if a peak or pit has no counterpart, and a persistence above 0.2 of the
    larger range. Value and pass of a counterpart differ by at most 0.1 of that range. For every
    flow, the advected source then differs from the target by at least 0.1 of the range somewhere.

    The result has the numbers of peaks and pits with a persistence above 0.2 of the range. If these
    numbers are equal, it describes the peaks or pits without a counterpart.
    """
    scale = float(max(np.ptp(f), np.ptp(g)))
    counts = tuple(_count(_both(mesh, values), SHARE * scale) for values in (f, g))
    for kind, side, sign in (("peak", "above", 1), ("pit", "below", -1)):
        one, other = (sign * diagram(mesh, sign * values) for values in (f, g))
        least = _DIFFERENCE_SHARE * scale
        unpaired = _unpaired(one, other, least), _unpaired(other, one, least)
        if not any(map(len, unpaired)):
            continue
        if counts[0] != counts[1]:
            return counts[0], counts[1]
        zero = _ZERO_SHARE * scale
        of_f, of_g = (
            " ".join(
                f"{word} {0 if abs(value) < zero else value:.2g}"
                for word, value in zip((f"a {kind} at", f"{side} a pass at"), rows[0], strict=True)
            )
            if len(rows)
            else f"no such {kind}"
            for rows in unpaired
        )
        return of_f, of_g
    return None


def _unpaired(one: FloatArray, other: FloatArray, difference: float) -> FloatArray:
    """Return the rows of a diagram (K, 2) without a counterpart in another diagram (L, 2).

    A counterpart differs by at most ``difference``. Only rows with a persistence above ``2 *
    difference`` are considered. Rows are paired so that as few as possible remain.
    """
    one = one[np.abs(one[:, 0] - one[:, 1]) > 2 * difference]
    is_close = np.abs(one[:, None] - other[None]).max(axis=-1, initial=0.0) <= difference
    pairs = maximum_bipartite_matching(sparse.csr_array(is_close), perm_type="column")
    unpaired: FloatArray = one[pairs < 0]
    return unpaired


def boundary_difference(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> Difference | None:
    """Return the ranges of functions f and g (V,) on the invariant part where they differ most.

    A flow maps two kinds of parts to themselves: boundary loops, and parts of the surface that
    touch the rest only at pinched vertices. The ranges are returned as texts. None if they differ
    nowhere by more than 0.1 of the larger range.
    """
    scale = float(max(np.ptp(f), np.ptp(g)))
    largest, ranges_there, at = _DIFFERENCE_SHARE * scale, None, ""
    parts = grouped(mesh.faces, mesh.parts) if mesh.parts.any() else []
    for name, places in (
        ("a boundary", mesh.boundary_loops),
        ("a part joined only at vertices", parts),
    ):
        for place in places:
            ranges = np.array([[h[place].min(), h[place].max()] for h in (f, g)])
            difference = float(np.abs(ranges[0] - ranges[1]).max())
            if difference > largest:
                largest, ranges_there, at = difference, ranges, name
    if ranges_there is None:
        return None
    ranges_there[np.abs(ranges_there) < _ZERO_SHARE * scale] = 0.0
    of_f, of_g = (f"values from {low:.2g} to {high:.2g}" for low, high in ranges_there)
    return f"{of_f} on {at}", f"{of_g} there"


def first_difference(functions: FunctionTerm) -> tuple[int, Counted, Counted] | None:
    """Return the index of the first channel that no flow can match, and its features of f and g.

    None if neither `extrema_difference` nor `boundary_difference` finds a difference, or if a
    vertex is masked, since the mask may hide the difference.
    """
    if (functions.areas > 0).all():
        for channel in _weighted_channels(functions):
            f, g = functions.source[channel], functions.target[channel]
            for difference in (extrema_difference, boundary_difference):
                found = difference(functions.mesh, f, g)
                if found is not None:
                    return int(channel), *found
    return None


def _both(mesh: TriangleMesh, f: FloatArray) -> tuple[FloatArray, FloatArray]:
    return persistence(mesh, f), persistence(mesh, -f)


def _count(persistences: tuple[FloatArray, FloatArray], least: float) -> Extrema:
    return Extrema(*(int((values >= least).sum()) for values in persistences))


@kernel
def _deaths(edges: IndexArray, rank: IndexArray) -> IndexArray:
    """Return the rank of the vertex at which each peak meets a higher peak, (V,).

    Ranks number the vertices from the highest value (rank 0) to the lowest. The result is ordered
    by the rank of the peak. A vertex that is not a peak has its own rank, and the highest peak has
    the last rank.
    """
    size = rank.size
    starts = np.zeros(size + 1, dtype=np.int64)
    for e in range(edges.shape[0]):
        starts[max(rank[edges[e, 0]], rank[edges[e, 1]]) + 1] += 1
    starts = np.cumsum(starts)
    # higher neighbours of all ranks, sorted by rank
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
