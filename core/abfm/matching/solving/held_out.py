"""Choose sigma for measured functions: cross-validation by patches of the surface.

The surface is divided into patches and the patches into folds. For each fold the same steps are
minimised without its patches; the residual there measures how well the field predicts values that
it was not fitted to [Hastie, Tibshirani, Friedman 2009, section 7.10]. Patches are used because
values at neighbouring vertices are correlated.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ParameterError
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.descent import minimum
from abfm.matching.solving.measures import advect_along_flow_lines
from abfm.matching.solving.record import Score
from abfm.matching.solving.schedule import Stage
from abfm.matching.solving.settings import SETTINGS
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_DISTANCE_ROUNDING = 1e-9  # of the surface's size


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
    """Return each vertex's fold, (V,): patches about distant points are dealt to the folds in turn.

    Of points at the same distance, except for rounding, the first one is the next centre. So the
    folds of a symmetric surface do not depend on its position and unit.
    """
    vertices = mesh.vertices
    from_middle = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)
    rounded = _DISTANCE_ROUNDING * from_middle.max()
    centre = int(np.argmax(from_middle <= from_middle.min() + rounded))
    away, nearest = np.full(len(vertices), np.inf), np.zeros(len(vertices), dtype=np.int64)
    for patch in range(SETTINGS.patches):
        distance = np.linalg.norm(vertices - vertices[centre], axis=1)
        nearest[distance < away - rounded] = patch
        away = np.minimum(away, distance)
        centre = int(np.argmax(away >= away.max() - rounded))
    return nearest % SETTINGS.folds


def fold_energies(energy: MatchingEnergy) -> list[tuple[MatchingEnergy, FloatArray]]:
    """Return, for each fold, the energy without its patches, and a mask (V,) of them alone."""
    given = energy.functions.mask
    mask = np.ones(len(energy.mesh.vertices)) if given is None else given
    fold, found = folds(energy.mesh), []
    for number in range(SETTINGS.folds):
        seen, hidden = (np.where(where, mask, 0.0) for where in (fold != number, fold == number))
        if seen.any() and hidden.any():
            found.append((energy.with_mask(seen), hidden))
    return found


class Fold(NamedTuple):
    """The energy without some patches, and how far its descents have come."""

    energy: MatchingEnergy
    hidden: FloatArray  # mask (V,) of the patches
    fields: FloatArray  # (N, F, 2)
    learned: Any = None  # the latest iterate
    before: Stage | None = None

    def minimise(self, stages: Sequence[Stage]) -> "Fold":
        """Return the fold after some stages."""
        _, _, fields, learned, before = self
        for stage in stages:
            learned, before = minimum(self.energy, stage, fields, learned, before), stage
            fields = learned.point.x
        return self._replace(fields=fields, learned=learned, before=before)

    def carried(self) -> FloatArray:
        """Return the source (C, V), advected by the discrete flow."""
        return self.energy.advected(self.fields)[: len(self.energy.functions.source)]

    def along_flow_lines(self) -> FloatArray:
        """Return the source (C, V), carried along flow lines to the patches."""
        try:
            return advect_along_flow_lines(self.energy, self.fields, self.hidden > 0)
        except ParameterError:  # flow lines that cross too many faces
            return np.full_like(self.energy.functions.source, np.nan)


class HeldOut(NamedTuple):
    """The steps of a match, minimised once for each fold without the fold's patches."""

    energy: MatchingEnergy
    folds: tuple[Fold, ...]

    @classmethod
    def at(cls, energy: MatchingEnergy, start: FloatArray) -> "HeldOut":
        """Return it before the first step, at fields (N, F, 2)."""
        return cls(energy, tuple(Fold(*fold, start) for fold in fold_energies(energy)))

    @property
    def unmoved(self) -> float:
        """The residual of held-out patches without motion; NaN if nothing is held out."""
        return self._residual([self.energy.functions.source] * len(self.folds))

    def follow(self, stages: Sequence[Stage]) -> "HeldOut":
        """Minimise the same stages."""
        return self._replace(folds=tuple(fold.minimise(stages) for fold in self.folds))

    def score(self, log2_area: float) -> Score:
        """Return the score of a step whose map has this mean ``|log2 J|``; smaller is better.

        The discrete flow lags behind, and fields of a small sigma make up for that also where they
        are not fitted, so by the discrete flow too small a sigma would be chosen. Flow lines have
        no lag. But they interpolate, which lowers the residual of noise: the discrete flow decides
        whether a field gains anything.
        """
        discrete = self._residual([fold.carried() for fold in self.folds])
        flow_lines = self._residual([fold.along_flow_lines() for fold in self.folds])
        return Score(flow_lines + SETTINGS.area_price * log2_area, discrete, self.unmoved)

    def _residual(self, carried: Sequence[FloatArray]) -> float:
        """Return the residual of the functions (C, V) of each fold, where they are hidden."""
        functions = self.energy.functions
        left = [
            functions.with_mask(fold.hidden).residual(values)
            for values, fold in zip(carried, self.folds, strict=True)
        ]
        return float(np.sqrt(np.mean(np.square(left)))) if left else np.nan
