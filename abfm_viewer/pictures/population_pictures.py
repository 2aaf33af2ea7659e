"""Pictures of a population on its template, from two opposite sides: means, deviations, areas, and
who does not fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from abfm import Population
from abfm.io.sheets import Panel, Up, Values
from abfm.pages.colormaps import ColorRange, color_range, without_extremes
from abfm.pages.front import best_front
from abfm.types import FloatArray
from abfm_viewer.pictures.registration_pictures import Planned, Row, both_sides, drawn_rows

MOST_CHANNELS = 4
"""The most channels that are drawn."""
MOST_MISFITS = 4
"""The most subjects that are drawn by themselves."""
_SHOWN_FACES = 98  # percent whose areas are between the ends of the colours: tiny faces vary most
_LEAST_RANGE = 0.25  # of logarithms: less hardly shows anywhere else


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
    mesh = found.template
    views, aspect = both_sides(
        {mesh: best_front(mesh, _known(found.mean(found.main_channel)), up=up)}
    )
    size = width, max(round(width / aspect), 1)
    channels = [_channel(found, c) for c in range(min(len(found.channels), MOST_CHANNELS))]
    tried = (_misfit(found, i) for i in found.worst_first() if not found.fits[i])
    misfits = [row for row in tried if row is not None][:MOST_MISFITS]
    rows = drawn_rows([*channels, _areas(found), *misfits], views, size, report)
    count = len(channels)
    return PopulationPictures(tuple(rows[:count]), rows[count], tuple(rows[count + 1 :]))


def _channel(found: Population, c: int) -> Planned:
    """Plan the mean of a channel by the initial maps, registered, and the deviation."""
    name = found.channels[c].name
    spread = f"deviation of {name}"
    plain, mean, deviation = (
        _known(each) for each in (found.plain_mean(c), found.mean(c), found.deviation(c))
    )
    panels = (
        Panel(found.template, Values(plain, name), "mean, at first"),
        Panel(found.template, Values(mean, name), "mean, registered"),
        Panel(found.template, Values(deviation, spread), "deviation"),
    )
    top = float(np.max(without_extremes(deviation)))
    ranges = {
        name: color_range(*map(without_extremes, (plain, mean))),
        spread: ColorRange("abfm sequential", 0.0, top or 1.0),
    }
    return Planned(name, panels, ranges)


def _areas(found: Population) -> Planned:
    mean, deviation = (
        np.nan_to_num(each) for each in (found.log2_area_mean, found.log2_area_deviation)
    )
    titles = "mean of log2 J", "deviation of log2 J"
    panels = tuple(
        Panel(found.template, Values(each, title), title)
        for each, title in zip((mean, deviation), titles, strict=True)
    )
    ends = [
        max(math.ceil(4 * float(np.percentile(np.abs(each), _SHOWN_FACES))) / 4, _LEAST_RANGE)
        for each in (mean, deviation)
    ]
    ranges = {
        titles[0]: ColorRange("abfm diverging", -ends[0], ends[0]),
        titles[1]: ColorRange("abfm sequential", 0.0, ends[1]),
    }
    return Planned("areas", panels, ranges)


def _misfit(found: Population, i: int) -> Planned | None:
    """Plan a subject beside the others' mean, by the first channel that it was registered by; None
    where it has no map.
    """
    c = found.main_channel
    name = found.channels[c].name
    before, after = found.before[i, :, c], found.values[i, :, c]
    if not np.isfinite(after).any():
        return None
    others = found.mean_of_others(i, c)
    shown = [_known(each) for each in (before, after, others)]
    titles = "at first", "registered", "mean of the others"
    panels = tuple(
        Panel(found.template, Values(each, name), title)
        for each, title in zip(shown, titles, strict=True)
    )
    ranges = {name: color_range(*map(without_extremes, shown))}
    return Planned(found.names[i], panels, ranges)


def _known(values: FloatArray) -> FloatArray:
    """Return values (V,) with those that are unknown in the middle of the others."""
    known = np.isfinite(values)
    return np.where(known, values, np.mean(values[known]) if known.any() else 0.0)
