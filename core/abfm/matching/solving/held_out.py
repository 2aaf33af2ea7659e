"""Choose sigma for measured functions: cross-validation by patches of the surface.

The surface is divided into patches and the patches into folds. For each fold the same steps are
minimised without its patches; the residual there measures how well the field predicts values that
it was not fitted to [Hastie, Tibshirani, Friedman 2009, section 7.10]. Patches are used because
values at neighbouring vertices are correlated.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ParameterError
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.course import Stage
from abfm.matching.solving.descent import Progress, minimum
from abfm.matching.solving.measures import carried_along
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_PATCHES, _FOLDS = 150, 3
_ROUNDED = 1e-9  # of the surface's size: what differs by less is as far
PRICE = 0.25
"""Weight of the mean ``|log2 J|`` in the score of a step, relative to the held-out residual."""


class Held(NamedTuple):
    """Residuals of held-out patches, all folds together: how well fields predict unseen values.

    The discrete flow lags behind, and fields of a small sigma make up for that also where they are
    not fitted, so by the discrete flow too small a sigma would be chosen. Flow lines have no lag.
    But they interpolate, which lowers the residual of noise: whether a field gains anything is
    decided by the discrete flow.
    """

    discrete: float
    flow_lines: float

    def score(self, log2_area: float) -> float:
        """Return the score of a step, smaller is better."""
        return self.flow_lines + PRICE * log2_area


def best_between(sigmas: ArrayLike, scores: ArrayLike) -> tuple[float, FloatArray] | None:
    """Find the sigma with the least score by a parabola through three steps.

    Parameters
    ----------
    sigmas, scores : (3,) arrays
        Steps with falling sigma, the second of which has the least score.

    Returns
    -------
    (float, (3,) array) or None
        The minimum in ``log sigma``, and the weights with which values of the three steps are
        interpolated there. None if a score is not finite or the parabola has no minimum.

    Notes
    -----
    If the scores have an error of e, sigma changes by a factor of about ``exp(e / (2 a h))`` with
    the curvature ``2 a`` and the distance ``h`` of steps in ``log sigma``; the step with the least
    score may change by a complete step. Scale and offset of the scores change nothing.
    """
    x, y = np.log(np.asarray(sigmas, dtype=np.float64)), np.asarray(scores, dtype=np.float64)
    if not np.isfinite(y).all():
        return None
    x0, x1, x2 = x
    first, second = (y[1] - y[0]) / (x1 - x0), (y[2] - y[1]) / (x2 - x1)
    bend = (second - first) / (x2 - x0)
    if not bend > 0:
        return None
    at = 0.5 * (x0 + x1 - first / bend)
    weights = [
        (at - x1) * (at - x2) / ((x0 - x1) * (x0 - x2)),
        (at - x0) * (at - x2) / ((x1 - x0) * (x1 - x2)),
        (at - x0) * (at - x1) / ((x2 - x0) * (x2 - x1)),
    ]
    return float(np.exp(at)), np.array(weights)


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
    """Minimises the steps of a match once for each fold, without the fold's patches."""

    def __init__(self, energy: MatchingEnergy, start: FloatArray) -> None:
        self._energy, self._folds = energy, without(energy)
        self._fields = [start] * len(self._folds)
        self._last = [Progress()] * len(self._folds)
        source = energy.functions.source
        self.unmoved = self._residual([source] * len(self._folds))
        """The residual of held-out patches without motion; NaN if nothing is held out."""

    def follow(self, stages: list[Stage]) -> Held:
        """Minimise the same stages; return the residuals of what each fold has not seen."""
        carried, along, count = [], [], len(self._energy.functions.source)
        for number, (energy, _) in enumerate(self._folds):
            for stage in stages:
                fields, last = self._fields[number], self._last[number]
                last = minimum(energy, stage, fields, last)
                self._fields[number], self._last[number] = last.fields, last
            carried.append(energy.advected(self._fields[number])[:count])
            along.append(self._along(number))
        return Held(self._residual(carried), self._residual(along))

    def _along(self, number: int) -> FloatArray:
        """Return the source (C, V) as flow lines of a fold's fields carry it to its patches."""
        (energy, hidden), x = self._folds[number], self._fields[number]
        try:
            return carried_along(energy, x, hidden > 0)
        except ParameterError:  # flow lines that cross too many faces
            return np.full_like(energy.functions.source, np.nan)

    def _residual(self, carried: list[FloatArray]) -> float:
        """Return the residual of what each fold carried, (C, V), where it is hidden from it."""
        functions = self._energy.functions
        left = [
            functions.weighed(hidden).residual(values)
            for values, (_, hidden) in zip(carried, self._folds, strict=True)
        ]
        return float(np.sqrt(np.mean(np.square(left)))) if left else np.nan
