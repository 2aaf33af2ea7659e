"""What a field says of places whose values it has not seen: whether it finds or only fits.

Patches of the surface are dealt out to folds. For each fold the same way is walked without its
patches, whose residual then tells what the field there is worth: cross-validation [Hastie,
Tibshirani, Friedman 2009, section 7.10], by patches as neighbours know each other's values.
"""

import numpy as np

from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.course import Stage
from abfm.matching.solving.descent import minimum
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_PATCHES, _FOLDS = 150, 3
_ROUNDED = 1e-9  # of the surface's size: what differs by less is as far
PRICE = 0.2
"""Of a mean ``|log2 J|`` of 1, in residual: what is held out has to gain as much."""


def folds(mesh: TriangleMesh) -> IntArray:
    """Return each vertex's fold, (V,): patches about points far from each other take turns.

    Of points that are as far, but for rounding, the first one is taken: so the folds of a surface
    that has symmetries are the same wherever it lies and whatever its unit.
    """
    vertices = mesh.vertices
    from_middle = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)
    rounded = _ROUNDED * from_middle.max()
    centre = int(np.argmax(from_middle <= from_middle.min() + rounded))
    away, nearest = np.full(len(vertices), np.inf), np.zeros(len(vertices), dtype=np.int64)
    for patch in range(_PATCHES):
        distance = np.linalg.norm(vertices - vertices[centre], axis=1)
        nearest[distance < away - rounded] = patch
        away = np.minimum(away, distance)
        centre = int(np.argmax(away >= away.max() - rounded))
    return nearest % _FOLDS


def without(energy: MatchingEnergy) -> list[tuple[MatchingEnergy, FloatArray]]:
    """Return, for each fold, the energy without its patches, and a mask (V,) of them alone."""
    given = energy.functions.mask
    mask = np.ones(len(energy.mesh.vertices)) if given is None else given
    fold, found = folds(energy.mesh), []
    for number in range(_FOLDS):
        seen, hidden = (np.where(where, mask, 0.0) for where in (fold != number, fold == number))
        if seen.any() and hidden.any():
            found.append((energy.masked(seen), hidden))
    return found


class HeldOut:
    """Walks a way once for each fold, without its patches, beside the match itself."""

    def __init__(self, energy: MatchingEnergy, start: FloatArray) -> None:
        self._energy, self._folds = energy, without(energy)
        self._fields = [start] * len(self._folds)
        source = energy.functions.source
        self.unmoved = self._residual([source] * len(self._folds))
        """The residual of held-out patches without motion; NaN if nothing is held out."""

    def follow(self, stages: list[Stage]) -> float:
        """Take the same stages; return the residual of what each fold has not seen."""
        count, carried = len(self._energy.functions.source), []
        for number, (energy, _) in enumerate(self._folds):
            for stage in stages:
                self._fields[number] = x = minimum(energy, stage, self._fields[number])
            carried.append(energy.advected(x)[:count])
        return self._residual(carried)

    def _residual(self, carried: list[FloatArray]) -> float:
        """Return the residual of what each fold carried, (C, V), where it is hidden from it."""
        functions = self._energy.functions
        left = [
            functions.weighed(hidden).residual(values)
            for values, (_, hidden) in zip(carried, self._folds, strict=True)
        ]
        return float(np.sqrt(np.mean(np.square(left)))) if left else np.nan
