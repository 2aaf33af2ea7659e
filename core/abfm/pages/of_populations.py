"""Pages of populations."""

from __future__ import annotations

from abfm.errors import one_line
from abfm.pages.colormaps import ColorRange, typical_range, without_extremes
from abfm.pages.front import best_front
from abfm.pages.page import Layer, Page, Panel
from abfm.pages.registered import MOST_CHANNELS
from abfm.population import Population

_NAME_LENGTH_MAX = 60


def population_page(found: Population, title: str, up: str | None = None) -> Page:
    """Return the page of a population: its means by the initial maps and registered, and the
    deviation, on the template; ``up`` is the axis that points upwards.
    """
    front = best_front(found.template, up=up)
    titles = "mean by the initial maps", "mean", "deviation"
    layers = list(
        zip(
            *(_layers(found, c) for c in range(min(len(found.channels), MOST_CHANNELS))),
            strict=True,
        )
    )
    panels = [
        Panel(name, found.template, of_channels, front)
        for name, of_channels in zip(titles, layers, strict=True)
    ]
    notes = []
    if (count := len(found.channels)) > MOST_CHANNELS:
        notes.append(f"these are the first {MOST_CHANNELS} of {count} channels")
    facts = found.facts
    return Page(title, facts.headline, panels, tone=facts.tone, notes=[*facts.notes, *notes])


def _layers(found: Population, c: int) -> list[Layer]:
    """Return the two means of a channel, in one range of colours, and its deviation."""
    means, deviation = (found.plain_mean(c), found.mean(c)), found.deviation(c)
    name = one_line(found.channels[c].name, _NAME_LENGTH_MAX)
    of_means = typical_range(*means)
    largest = max(without_extremes(deviation), default=0.0)
    of_deviation = ColorRange("abfm sequential", 0.0, float(largest) or 1.0)
    return [
        *(Layer(name, each, of_means) for each in means),
        Layer(name, deviation, of_deviation),
    ]
