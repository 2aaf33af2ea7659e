"""What a round came to: who fits, the mean of those who do, and all that is told of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abfm.population import statistics
from abfm.population.misfits import Judged
from abfm.population.on_template import MapFacts
from abfm.population.population import Population
from abfm.population.target import Target
from abfm.types import FloatArray, IntArray

if TYPE_CHECKING:
    from abfm.population.work import Work


class Round(NamedTuple):
    """What a round came to."""

    judged: Judged
    before: tuple[FloatArray, FloatArray]  # values (N, V, C) and masks (N, V)
    after: tuple[FloatArray, FloatArray]
    log2_areas: FloatArray  # (N, F)
    drift: FloatArray
    drift_file: str
    verdicts: tuple[str, ...]
    digests: tuple[str, ...]
    facts: tuple[MapFacts, ...]

    def target(self, work: Work) -> Target:
        """Return the mean of those who fit."""
        values, masks = self.after
        shares = (work.weights * self.judged.fits)[:, None] * masks
        means = np.stack(
            [statistics.mean(values[:, :, c], shares) for c in work.cohort.registered_by]
        )
        return Target.filled(work.template, means, work.mask * (shares > 0).any(axis=0))

    def middles(self, work: Work) -> FloatArray:
        """Return the mean over surface and subjects of each channel, before, (C,)."""
        values, masks = self.before
        shares = (work.weights * self.judged.fits)[:, None] * masks
        found = []
        for own in np.moveaxis(values, 2, 0):
            mean = statistics.mean(own, np.where(np.isfinite(own), shares, 0))
            known = np.where(np.isfinite(mean), work.areas, 0)
            found.append(known @ np.nan_to_num(mean) / known.sum() if known.any() else 0.0)
        return np.array(found)

    def population(
        self, work: Work, changes: Sequence[float], phases: FloatArray, order: IntArray
    ) -> Population:
        """Return it with the subjects in another order."""
        cohort, judged = work.cohort, self.judged
        channel_weights = np.zeros(len(cohort.channels))
        channel_weights[cohort.registered_by] = work.channel_weights
        counts = (work.weights * judged.fits)[:, None] * np.ones(self.log2_areas.shape[1])
        numbers = np.array(
            [
                [like.correlation, like.distance, like.log2_area, *facts]
                for like, facts in zip(judged.likeness, self.facts, strict=True)
            ]
        )

        def ordered(texts: Sequence[str]) -> tuple[str, ...]:
            return tuple(texts[i] for i in order)

        return Population(
            work.template,
            cohort.channels,
            ordered([subject.name for subject in cohort.subjects]),
            work.weights[order],
            channel_weights,
            judged.fits[order],
            ordered(judged.reasons),
            ordered(self.verdicts),
            ordered(self.digests),
            self.before[0][order],
            self.after[0][order],
            self.before[1][order],
            self.after[1][order],
            work.mask,
            numbers[order],
            phases,
            statistics.mean(self.log2_areas, counts),
            statistics.deviation(self.log2_areas, counts),
            self.drift,
            np.array(changes),
            work.settings.bound,
        )
