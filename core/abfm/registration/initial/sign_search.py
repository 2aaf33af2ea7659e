"""Search for nearly isometric maps between two surfaces without descriptors.

The first eigenfunctions of nearly isometric surfaces agree up to their signs and order. The search
tries every choice of signs of a few eigenfunctions, and ZoomOut refines it and corrects the order.
Maps that are nearly isometries are returned. A nearly symmetric surface has several of them: the
correct map, and its compositions with symmetries. Composing one map, the inverse of a second, and a
third gives another one. This also finds maps that no choice of signs leads to.

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

MAP_SIZE = 24  # eigenfunctions of the functional maps that are compared
_SIGNED_EIGENFUNCTIONS = (4, 5, 6, 7)  # numbers of first eigenfunctions; all signs are tried
_COMBINED_MAPS = 7  # best maps that are composed with each other
_MAP_DISTANCE_MIN = 0.4  # maps with a smaller distance / sqrt(size) count as the same


def candidates(spectra: Spectra, others: Iterable[FloatArray], most: int) -> list[FloatArray]:
    """Return at most ``most`` different functional maps, by ascending `Spectra.defect`.

    Their size is `MAP_SIZE`, or the number of eigenfunctions if that is smaller. The search also
    starts from the maps ``others``.
    """
    size = min(MAP_SIZE, len(spectra.values[0]))
    found = list(others)
    for count in _SIGNED_EIGENFUNCTIONS:
        if count < size:
            found += [np.diag([1.0, *signs]) for signs in product([1.0, -1.0], repeat=count)]
    best = _different(spectra, (_refined(spectra, C, size) for C in found))
    # exchanging i and k gives the same map if symmetries commute
    triples = [
        (i, j, k) for i, j, k in permutations(range(min(_COMBINED_MAPS, len(best))), 3) if i < k
    ]
    combined = [best[i] @ best[j].T @ best[k] for i, j, k in triples]
    more = (_refined(spectra, C, size) for C in combined)
    return _different(spectra, [*best, *more])[:most]


def _refined(spectra: Spectra, C: FloatArray, size: int) -> FloatArray:
    """Refine a functional map up to ``size`` eigenfunctions, and three times at that size.

    The size grows in steps of two. With steps of one, the correct maps of three of 22 pairs of
    bodies were not found.
    """
    checkpoint()
    return spectra.refined(C, [*range(len(C) + 2, size, 2), *[size] * 3])


def _different(spectra: Spectra, maps: Iterable[FloatArray]) -> list[FloatArray]:
    """Return functional maps by ascending defect, without near duplicates of better ones."""
    distinct: list[FloatArray] = []
    for C in sorted(maps, key=spectra.defect):
        if all(np.linalg.norm(C - D) > _MAP_DISTANCE_MIN * np.sqrt(len(C)) for D in distinct):
            distinct.append(C)
    return distinct
