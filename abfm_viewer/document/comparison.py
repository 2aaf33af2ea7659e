"""What a subject of a population is held against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

import abfm
from abfm.types import BoolArray, FloatArray

ComparisonKind = Literal["difference", "mean", "deviation", "areas"]
"""What is between a subject and the mean of the others."""
_LENGTH_MAX = 24  # characters of a name in a title


@dataclass(frozen=True, eq=False)
class Comparison:
    """A subject on the template, between it and the mean of the others what is compared.

    `channels` are numbers of the population's channels by the specs, in the document, of the
    subject's function and the mean of the others.
    """

    population: abfm.Population
    subject: int
    channels: Mapping[tuple[str, str], int]
    kind: ComparisonKind = "difference"

    @property
    def name(self) -> str:
        return self.population.names[self.subject]

    def title(self, slot: str) -> str:
        """What a slot shows; a slot of another kind has no other name. Long names are cut, so that
        the words after them have room.
        """
        name = self.name if len(self.name) <= _LENGTH_MAX else f"{self.name[: _LENGTH_MAX - 3]}..."
        between = {
            "difference": f"{name} less the mean",
            "mean": f"mean of the {int(self.population.fits.sum())} that fit",
            "deviation": "standard deviation",
            "areas": "deviation of log2 J",
        }
        titles = {
            "source": f"{name}, carried",
            "advected": between[self.kind],
            "target": "mean of the others",
        }
        return titles.get(slot, slot)

    def unknown(self, slot: str, channel: int) -> BoolArray | None:
        """Where a slot's function has no values, and is filled in: (V,), or (F,) of areas; None
        where it has them everywhere, or the slot is of another kind.
        """
        of_slots = {
            "source": lambda: self.population.values[self.subject, :, channel],
            "advected": lambda: self.values(channel),
            "target": lambda: self.population.mean_of_others(self.subject, channel),
        }
        if slot not in of_slots:
            return None
        found = ~np.isfinite(of_slots[slot]())
        return found if found.any() else None

    def values(self, channel: int) -> FloatArray:
        """What is compared of a channel: (V,), or (F,) of areas; NaN where it is not known."""
        found = self.population
        if self.kind == "areas":
            return found.log2_area_deviation
        if self.kind == "mean":
            return found.mean(channel)
        if self.kind == "deviation":
            return found.deviation(channel)
        own = found.values[self.subject, :, channel]
        return np.asarray(own - found.mean_of_others(self.subject, channel))
