"""Pictures of a population on its template, from two opposite sides: means, deviations, areas, and
who does not fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from abfm import Population
from abfm.io.sheets import Up
from abfm.pages.colormaps import ColorRange, typical_range, without_extremes
from abfm.pages.front import best_front
from abfm.pages.registered import MOST_CHANNELS
from abfm.types import FloatArray
from abfm_viewer.pictures.rows import Row, drawn, panels_of

_OUTLIERS_DRAWN_MAX = 4
"""Outliers with a row of pictures of their own."""
_SHOWN_FACES = 98  # percent whose areas are between the ends of the colours: tiny faces vary most
_RANGE_MIN = 0.25  # a smaller one shows hardly any colour elsewhere


@dataclass(frozen=True, eq=False)
class PopulationPictures:
    """All that a page draws."""

    channels: tuple[Row, ...]
    areas: Row
    misfits: tuple[Row, ...]  # titled by their names


def population_pictures(
    found: Population,
    width: int,
    up: Up | None = None,
    report: Callable[[str, float], None] = lambda text, share: None,
) -> PopulationPictures:
    """Draw a population, in pictures of a width in pixels.

    ``report`` is called with what is drawn and the share that is behind. A `DrawingError` says why
    the machine cannot draw.
    """
    mesh, shown = found.template, _known(found.mean(found.main_channel))
    channels = [_channel(found, c) for c in range(min(len(found.channels), MOST_CHANNELS))]
    tried = (_misfit(found, i) for i in found.worst_first() if not found.fits[i])
    misfits = [row for row in tried if row is not None][:_OUTLIERS_DRAWN_MAX]
    planned = [*channels, _areas(found), *misfits]
    rows = drawn(planned, {mesh: best_front(mesh, shown, up=up)}, width, report)
    count = len(channels)
    return PopulationPictures(tuple(rows[:count]), rows[count], tuple(rows[count + 1 :]))


def _channel(found: Population, c: int) -> Row:
    """Plan the mean of a channel by the initial maps, registered, and the deviation."""
    name = found.channels[c].name
    spread = f"deviation of {name}"
    means = {
        "mean, at first": _known(found.plain_mean(c)),
        "mean, registered": _known(found.mean(c)),
    }
    deviation = _known(found.deviation(c))
    panels = (
        *panels_of(found.template, name, means),
        *panels_of(found.template, spread, {"deviation": deviation}),
    )
    top = float(np.max(without_extremes(deviation)))
    ranges = {
        name: typical_range(*means.values()),
        spread: ColorRange("abfm sequential", 0.0, top or 1.0),
    }
    return Row(name, panels, ranges)


def _areas(found: Population) -> Row:
    mean, deviation = "mean of log2 J", "deviation of log2 J"
    values = {
        mean: np.nan_to_num(found.log2_area_mean),
        deviation: np.nan_to_num(found.log2_area_deviation),
    }
    ends = {
        name: max(math.ceil(4 * float(np.percentile(np.abs(each), _SHOWN_FACES))) / 4, _RANGE_MIN)
        for name, each in values.items()
    }
    panels = (panels_of(found.template, name, {name: each}) for name, each in values.items())
    ranges = {
        mean: ColorRange("abfm diverging", -ends[mean], ends[mean]),
        deviation: ColorRange("abfm sequential", 0.0, ends[deviation]),
    }
    return Row("areas", tuple(chain.from_iterable(panels)), ranges)


def _misfit(found: Population, i: int) -> Row | None:
    """Plan a subject next to the mean of the others, by the first channel that it was registered
    by; None if it has no map.
    """
    c = found.main_channel
    if not np.isfinite(found.values[i, :, c]).any():
        return None
    functions = {
        "at first": _known(found.before[i, :, c]),
        "registered": _known(found.values[i, :, c]),
        "mean of the others": _known(found.mean_of_others(i, c)),
    }
    name = found.channels[c].name
    panels = panels_of(found.template, name, functions)
    return Row(found.names[i], panels, {name: typical_range(*functions.values())})


def _known(values: FloatArray) -> FloatArray:
    """Return values (V,) with those that are unknown in the middle of the others."""
    known = np.isfinite(values)
    return np.where(known, values, np.mean(values[known]) if known.any() else 0.0)
