"""Comparison of a subject with the other subjects of its population, on their template."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

import abfm
from abfm.types import BoolArray, FloatArray

ComparisonKind = Literal["difference", "mean", "deviation", "areas"]
"""Quantity that the slot between a subject and the mean of the others shows."""
_LENGTH_MAX = 24  # number of characters of a name in a title


@dataclass(frozen=True, eq=False)
class Comparison:
    """One subject of a population, and how it is compared with the mean of the other subjects."""

    population: abfm.Population
    subject: int  # number of the subject in the population
    # numbers of the population's channels, by the specs of source and target in the document: the
    # subject's function, and the mean of the others
    channels: Mapping[tuple[str, str], int]
    kind: ComparisonKind = "difference"  # quantity shown between source and target

    @property
    def name(self) -> str:
        return self.population.names[self.subject]

    def title(self, slot: str) -> str:
        """Return the title of a slot (a picture), with an abbreviated name of the subject."""
        name = self.name if len(self.name) <= _LENGTH_MAX else f"{self.name[: _LENGTH_MAX - 3]}..."
        kind_titles = {
            "difference": f"{name} minus the mean",
            "mean": f"mean of {int(self.population.fits.sum())} without outliers",
            "deviation": "standard deviation",
            "areas": "standard deviation of log2 J",
        }
        titles = {
            "source": f"{name}, transferred",
            "advected": kind_titles[self.kind],
            "target": "mean of the others",
        }
        return titles.get(slot, slot)

    def unknown(self, slot: str, channel: int) -> BoolArray | None:
        """Return a mask of the values in a slot (a picture) that were missing and filled in.

        The mask has shape (V,), or (F,) for areas. It is None without missing values, and for slots
        that do not show the comparison.
        """
        values_of = {
            "source": lambda: self.population.values[self.subject, :, channel],
            "advected": lambda: self.values(channel),
            "target": lambda: self.population.mean_of_others(self.subject, channel),
        }
        if slot not in values_of:
            return None
        is_unknown = ~np.isfinite(values_of[slot]())
        return is_unknown if is_unknown.any() else None

    def values(self, channel: int) -> FloatArray:
        """Return the compared quantity of a channel, (V,), or (F,) for areas; NaN where unknown."""
        population = self.population
        if self.kind == "areas":
            return population.log2_area_deviation
        if self.kind == "mean":
            return population.mean(channel)
        if self.kind == "deviation":
            return population.deviation(channel)
        values = population.values[self.subject, :, channel]
        return np.asarray(values - population.mean_of_others(self.subject, channel))
