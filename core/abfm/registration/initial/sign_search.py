"""Maps between two surfaces that are nearly isometric, searched without descriptors.

The first eigenfunctions of such surfaces agree up to their signs and order. Every choice of signs
of a few is refined by ZoomOut, which mends the order; what comes near an isometry is kept. There
are several of these where a surface is nearly symmetric: the map itself, and the map followed by
symmetries. Three of them, one and the inverse of another and a third, give one more, so that those
that no choice of signs leads to are found, too.

References
----------
Ren, Melzi, Ovsjanikov, Wonka: MapTree: Recovering Multiple Solutions in the Space of Maps, ACM TOG
39(6), 2020, which searches a tree of signs.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import permutations, product

import numpy as np

from abfm.registration.initial.spectra import Spectra
from abfm.types import FloatArray
from abfm.workers.control import checkpoint

SIZE = 24  # of the functional maps that are compared
_SIGNS = (4, 5, 6, 7)  # eigenfunctions, after the constant, whose signs are tried
_COMBINED_MAPS = 7  # of the best that are followed by each other
_MAP_DISTANCE_MIN = 0.4  # distance of functional maps, over sqrt(size), that go to the same places


def candidates(spectra: Spectra, others: Iterable[FloatArray], most: int) -> list[FloatArray]:
    """Return different functional maps, of `SIZE` or of what the surfaces have, least defect first:
    at most so many of the best; others are starts to be tried as well.
    """
    size = min(SIZE, len(spectra.values[0]))
    found = list(others)
    for count in _SIGNS:
        if count < size:
            found += [np.diag([1.0, *signs]) for signs in product([1.0, -1.0], repeat=count)]
    best = _different(spectra, (_refined(spectra, C, size) for C in found))
    # i and k may be exchanged where symmetries commute
    triples = [
        (i, j, k) for i, j, k in permutations(range(min(_COMBINED_MAPS, len(best))), 3) if i < k
    ]
    combined = [best[i] @ best[j].T @ best[k] for i, j, k in triples]
    more = (_refined(spectra, C, size) for C in combined)
    return _different(spectra, [*best, *more])[:most]


def _refined(spectra: Spectra, C: FloatArray, size: int) -> FloatArray:
    """Refine a start to a size, at which it settles for a few turns. Sizes grow by two: by one the
    right maps of three of 22 pairs of bodies were not found.
    """
    checkpoint()
    return spectra.refined(C, [*range(len(C) + 2, size, 2), *[size] * 3])


def _different(spectra: Spectra, maps: Iterable[FloatArray]) -> list[FloatArray]:
    """Return functional maps by ascending defect, without those that are like an earlier one."""
    kept: list[FloatArray] = []
    for C in sorted(maps, key=spectra.defect):
        if all(np.linalg.norm(C - D) > _MAP_DISTANCE_MIN * np.sqrt(len(C)) for D in kept):
            kept.append(C)
    return kept
