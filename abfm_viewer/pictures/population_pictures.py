"""Pictures of a population: means, standard deviations, area changes and outliers."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from abfm import Population
from abfm.calculus.operators import face_areas, vertex_areas
from abfm.display import BEST_VIEW, ViewSpec
from abfm.pages.color_ranges import Quantity, color_range
from abfm.pages.front import front_of
from abfm.pages.registration_views import CHANNELS_MAX
from abfm.types import FloatArray
from abfm_viewer.pictures.rows import Row, draw_rows, panels_of

_OUTLIERS_DRAWN_MAX = 4
_QUANTITIES: dict[str, Quantity] = {
    "mean of log2 J": "signed",
    "standard deviation of log2 J": "magnitude",
}
_RANGE_MIN = 0.25  # smallest end of their colour ranges


@dataclass(frozen=True, eq=False)
class PopulationPictures:
    channels: tuple[Row, ...]
    areas: Row
    outliers: tuple[Row, ...]  # titled by the names of the subjects


def population_pictures(
    found: Population,
    width: int,
    view: ViewSpec = BEST_VIEW,
    report: Callable[[str, float], None] = lambda text, share: None,
) -> PopulationPictures:
    """Return the pictures of a population; ``width`` is in pixels.

    ``report`` is called with the name of the next picture and the completed share, 0 to 1. Raises
    `DrawingError` if the machine cannot draw.
    """
    mesh, shown = found.template, _filled_in(found.mean(found.main_channel))
    channels = [_channel(found, c) for c in range(min(len(found.channels), CHANNELS_MAX))]
    possible = (_outlier(found, i) for i in found.worst_first() if not found.fits[i])
    outliers = [row for row in possible if row is not None][:_OUTLIERS_DRAWN_MAX]
    planned = [*channels, _areas(found), *outliers]
    rows = draw_rows(planned, {mesh: front_of(mesh, shown, view=view)}, width, report)
    count = len(channels)
    return PopulationPictures(tuple(rows[:count]), rows[count], tuple(rows[count + 1 :]))


def _channel(found: Population, c: int) -> Row:
    """Return pictures of channel ``c``: means before and after registration, standard deviation."""
    name = found.channels[c].name
    spread = f"standard deviation of {name}"
    means = {
        "mean, unregistered": _filled_in(found.plain_mean(c)),
        "mean, registered": _filled_in(found.mean(c)),
    }
    deviation = _filled_in(found.deviation(c))
    panels = (
        *panels_of(found.template, name, means),
        *panels_of(found.template, spread, {"standard deviation": deviation}),
    )
    areas = vertex_areas(found.template)
    ranges = {
        name: color_range(*means.values(), areas=areas),
        spread: color_range(deviation, areas=areas, quantity="magnitude"),
    }
    return Row(name, panels, ranges)


def _areas(found: Population) -> Row:
    found_values = found.log2_area_mean, found.log2_area_deviation
    values = dict(zip(_QUANTITIES, map(np.nan_to_num, found_values), strict=True))
    panels = (panels_of(found.template, name, {name: each}) for name, each in values.items())
    areas = face_areas(found.template)
    ranges = {
        name: color_range(values[name], areas=areas, quantity=quantity, end_min=_RANGE_MIN)
        for name, quantity in _QUANTITIES.items()
    }
    return Row("areas", tuple(chain.from_iterable(panels)), ranges)


def _outlier(found: Population, i: int) -> Row | None:
    """Return pictures of subject ``i`` before and after registration, and of the others' mean.

    They show the main channel. The result is None if the subject has no values there.
    """
    c = found.main_channel
    if not np.isfinite(found.values[i, :, c]).any():
        return None
    functions = {
        "unregistered": _filled_in(found.before[i, :, c]),
        "registered": _filled_in(found.values[i, :, c]),
        "mean of the others": _filled_in(found.mean_of_others(i, c)),
    }
    name = found.channels[c].name
    panels = panels_of(found.template, name, functions)
    ranges = {name: color_range(*functions.values(), areas=vertex_areas(found.template))}
    return Row(found.names[i], panels, ranges)


def _filled_in(values: FloatArray) -> FloatArray:
    """Return values (V,) with NaN and infinite values replaced by the mean of the others."""
    known = np.isfinite(values)
    return np.where(known, values, np.mean(values[known]) if known.any() else 0.0)
