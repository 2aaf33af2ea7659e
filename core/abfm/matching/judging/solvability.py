"""What no flow can do, and signs of a flow that went astray, told from the functions alone.

A flow carries values from place to place: it makes no new ones, and neither splits nor joins peaks. Functions that need
this have no match, whatever the parameters. The discrete flow can do both, between vertices, and its own mismatch does
not tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import l2_norm, vertex_areas
from abfm.matching.judging.peaks import Extrema, different_peaks
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

VANISHED = 0.2
"""A function has vanished whose deviation from its mean is below this share of the source's and of the target's.

Of 18 matches of Gaussians near and far on spheres and a body, those that ended at a mismatch of 1 had a share below
0.01, all others (two of them with a mismatch of 0.8 and more) one above 0.4.
"""
STILL = 0.1
"""A source stood still that changed by less than this share of what it differed from the target.

Of the same matches all that moved had changed by 0.4 or more after five iterations.
"""

_EQUAL = 1e-9  # of the largest value: a smaller range is a constant


@dataclass(frozen=True, eq=False)
class Problem:
    """A source f and a target g, and where and how much their mismatch counts.

    Attributes
    ----------
    mesh : TriangleMesh
    source, target : (C, V) arrays
    mask : (V,) array or None
        Weight of the mismatch at each vertex, not negative. Values of the source may come from where it is 0.
    weights : (C,) array or None
        Weight of each channel's mismatch, not negative.
    """

    mesh: TriangleMesh
    source: FloatArray
    target: FloatArray
    mask: FloatArray | None = None
    weights: FloatArray | None = None

    def norm(self, functions: FloatArray) -> float:
        """L2 norm over channels (C, V), with mask and weights."""
        root = np.ones(len(functions)) if self.weights is None else np.sqrt(self.weights)
        return l2_norm(self.mesh, (root[:, None] * functions).T, self.mask)

    def mismatch(self, functions: FloatArray) -> float:
        """``||functions - g|| / ||g||``, as the solver has it: ``||f||``, or 1, in place of 0."""
        scale = self.norm(self.target) or self.norm(self.source) or 1.0
        return self.norm(functions - self.target) / scale

    def deviation(self, functions: FloatArray) -> float:
        """Norm of channels (C, V) less the mean of each, by the mask."""
        areas = self._areas()
        return self.norm(functions - (functions @ areas / areas.sum())[:, None])

    def vanished(self, advected: FloatArray) -> bool:
        """Whether the flow squeezed the source to nothing, though the target is not flat."""
        least = min(self.deviation(self.source), self.deviation(self.target))
        return self.deviation(advected) < VANISHED * least

    def stood_still(self, advected: FloatArray) -> bool:
        """Whether the flow left the source where it was, though the target is elsewhere."""
        return self.norm(advected - self.source) < STILL * self.norm(self.source - self.target)

    def distance(self) -> float:
        """How far the source has to go, in sqrt(area): between the centres of what it has too much and too little of.

        Straight through space, of the channel where it is most; 0 where nothing is too much, or nothing too little.
        """
        excess = (self.source - self.target)[self._counting()] * self._areas()
        more, less = np.maximum(excess, 0), np.maximum(-excess, 0)
        known = (more.sum(axis=1) > 0) & (less.sum(axis=1) > 0)
        if not known.any():
            return 0.0
        here, there = (part @ self.mesh.vertices / part.sum(axis=1)[:, None] for part in (more[known], less[known]))
        return float(np.linalg.norm(here - there, axis=1).max()) / self.mesh.length_scale

    def source_is_constant(self) -> bool:
        """Whether every channel that counts has one value all over the surface."""
        return _constant(self.source[self._counting()])

    def target_is_constant(self) -> bool:
        """Whether every channel that counts has one value wherever the mask is above 0."""
        return _constant(self.target[self._counting()][:, self._areas() > 0])

    def worst_channel(self) -> int:
        """The channel whose target has most that the source has no values for."""
        missing = (within_range(self) - self.target) ** 2 @ self._areas()
        return int(np.argmax(missing if self.weights is None else missing * self.weights))

    def target_range(self, channel: int) -> tuple[float, float]:
        """Least and largest value of a channel of the target where the mask is above 0."""
        values = self.target[channel, self._areas() > 0]
        return float(values.min()), float(values.max())

    def different_peaks(self) -> tuple[int, Extrema, Extrema] | None:
        """The first channel that counts whose source and target differ in their peaks or pits, and how many each has.

        None where they do not, or where a mask leaves vertices out, which may hide peaks of the target.
        """
        if not (self._areas() > 0).all():
            return None
        for channel in self._counting():
            found = different_peaks(self.mesh, self.source[channel], self.target[channel])
            if found is not None:
                return int(channel), *found
        return None

    def _areas(self) -> FloatArray:
        areas = vertex_areas(self.mesh)
        return areas if self.mask is None else areas * self.mask

    def _counting(self) -> IntArray:
        return np.arange(len(self.source)) if self.weights is None else np.flatnonzero(self.weights)


def within_range(problem: Problem) -> FloatArray:
    """The target (C, V) with its values clipped to those that the source has: the best that values alone allow."""
    low, high = problem.source.min(axis=1, keepdims=True), problem.source.max(axis=1, keepdims=True)
    clipped: FloatArray = np.clip(problem.target, low, high)
    return clipped


def range_bound(problem: Problem) -> float:
    """The least relative mismatch that any flow can leave, by the values alone; 0 where the source has all values.

    What a flow carries has only values of the source, so ``|f_tau - g| >= |clip(g, min f, max f) - g|`` everywhere.
    """
    return problem.mismatch(within_range(problem))


def _constant(functions: FloatArray) -> bool:
    return bool((np.ptp(functions, axis=1) <= _EQUAL * np.abs(functions).max(axis=1)).all())
