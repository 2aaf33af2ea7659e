"""Selection of sigma for measured functions: cross-validation by patches of the surface.

The surface is divided into patches, and the patches into folds. For each fold, the same steps are
minimised without its patches. The residual on these patches measures how well the field predicts
values that it was not fitted to [Hastie, Tibshirani, Friedman 2009, section 7.10]. Single vertices
are unsuitable, because values at neighbouring vertices are correlated.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ParameterError
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.descent import minimise_fold
from abfm.matching.solving.measures import advect_along_flow_lines
from abfm.matching.solving.record import Score
from abfm.matching.solving.schedule import Stage
from abfm.matching.solving.settings import SETTINGS
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_DISTANCE_ROUNDING = 1e-9  # tolerance of equal distances, relative to the size of the surface


def best_between(sigmas: ArrayLike, scores: ArrayLike) -> tuple[float, FloatArray] | None:
    """Find the sigma with the smallest score by a parabola through three steps.

    The steps have decreasing ``sigmas`` (3,), and the second one has the smallest of the ``scores``
    (3,). Return the minimum in ``log sigma``, and the weights (3,) that interpolate values of the
    three steps there. The result is None if a score is not finite, or if the parabola has no
    minimum.

    An error e of the scores changes sigma by a factor of about ``exp(e / (2 a h))``. Here ``2 a``
    is the curvature, and ``h`` the step size in ``log sigma``. Without interpolation, sigma
    would change by a complete step. Scale and offset of the scores have no effect.
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
    """Return the number of the cross-validation fold of each vertex, (V,).

    Each vertex belongs to the patch with the nearest centre. Each new centre is the vertex farthest
    from the previous centres; among equally distant ones (up to rounding errors), the first. The
    patches are assigned to the folds in turn. The folds of a symmetric surface therefore do not
    depend on its position and unit.
    """
    vertices = mesh.vertices
    from_middle = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)
    rounded = _DISTANCE_ROUNDING * from_middle.max()
    centre = int(np.argmax(from_middle <= from_middle.min() + rounded))
    distances, nearest = np.full(len(vertices), np.inf), np.zeros(len(vertices), dtype=np.int64)
    for patch in range(SETTINGS.patches):
        distance = np.linalg.norm(vertices - vertices[centre], axis=1)
        nearest[distance < distances - rounded] = patch
        distances = np.minimum(distances, distance)
        centre = int(np.argmax(distances >= distances.max() - rounded))
    return nearest % SETTINGS.folds


def fold_energies(energy: MatchingEnergy) -> list[tuple[MatchingEnergy, FloatArray]]:
    """Return, for each fold, the energy without its patches and the mask (V,) of these patches."""
    given = energy.functions.mask
    mask = np.ones(len(energy.mesh.vertices)) if given is None else given
    fold, found = folds(energy.mesh), []
    for number in range(SETTINGS.folds):
        seen, hidden = (np.where(where, mask, 0.0) for where in (fold != number, fold == number))
        if seen.any() and hidden.any():
            found.append((energy.with_mask(seen), hidden))
    return found


class Fold(NamedTuple):
    """A cross-validation fold: the energy without its patches, and the state of its descents."""

    energy: MatchingEnergy
    hidden: FloatArray  # mask (V,) of the patches of the fold
    fields: FloatArray  # (N, F, 2), after the latest stage
    last_iterate: Any = None
    before: Stage | None = None

    def minimise(self, stages: Sequence[Stage]) -> "Fold":
        _, _, fields, last_iterate, before = self
        for stage in stages:
            last_iterate = minimise_fold(self.energy, stage, fields, last_iterate, before)
            fields, before = last_iterate.point.x, stage
        return self._replace(fields=fields, last_iterate=last_iterate, before=before)

    def advected(self) -> FloatArray:
        return self.energy.advected(self.fields)[: len(self.energy.functions.source)]

    def along_flow_lines(self) -> FloatArray:
        """Return the source (C, V), advected along flow lines on the held-out patches only.

        It is NaN if flow lines cross too many faces.
        """
        try:
            return advect_along_flow_lines(self.energy, self.fields, self.hidden > 0)
        except ParameterError:  # flow lines cross too many faces
            return np.full_like(self.energy.functions.source, np.nan)


class HeldOut(NamedTuple):
    """The cross-validation of a match: for each fold, its steps without the patches of the fold."""

    energy: MatchingEnergy
    folds: tuple[Fold, ...]

    @classmethod
    def at(cls, energy: MatchingEnergy, start: FloatArray) -> "HeldOut":
        """Return the cross-validation at the initial fields (N, F, 2)."""
        return cls(energy, tuple(Fold(*fold, start) for fold in fold_energies(energy)))

    @property
    def unmoved(self) -> float:
        """The residual of held-out patches without motion; NaN if nothing is held out."""
        return self._residual([self.energy.functions.source] * len(self.folds))

    def follow(self, stages: Sequence[Stage]) -> "HeldOut":
        return self._replace(folds=tuple(fold.minimise(stages) for fold in self.folds))

    def score(self, log2_area: float) -> Score:
        """Return the score of the latest step; smaller is better.

        ``log2_area`` is the mean ``|log2 J|`` of the map of the step. The score uses flow lines,
        because the discrete flow lags behind the exact one. Fields of a small sigma compensate for
        this lag, even where they are not fitted, so the discrete flow would select too small a
        sigma. However, flow lines interpolate, which lowers the residual of noise. Whether a field
        improves anything is therefore decided by the discrete flow.
        """
        discrete = self._residual([fold.advected() for fold in self.folds])
        flow_lines = self._residual([fold.along_flow_lines() for fold in self.folds])
        return Score(flow_lines + SETTINGS.area_weight * log2_area, discrete, self.unmoved)

    def _residual(self, advected: Sequence[FloatArray]) -> float:
        """Return the root mean square, over all folds, of the residuals on held-out patches.

        ``advected`` has the advected source (C, V) of each fold.
        """
        functions = self.energy.functions
        pairs = zip(advected, self.folds, strict=True)
        residuals = [functions.with_mask(fold.hidden).residual(values) for values, fold in pairs]
        return float(np.sqrt(np.mean(np.square(residuals)))) if residuals else np.nan
