"""What every figure with a map says of it: how far it leaves the surface, and how much it folds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from abfm.experiments.experiment import Measure
from abfm.maps.quality import MapQuality, map_quality
from abfm.matching.result import Match


def of_flow(match: Match, name: str, shares: Sequence[float] = (1.0,)) -> dict[str, MapQuality]:
    """Qualities of the maps that a flow makes of its surface, at some shares of tau, by names to show."""
    named = {f"{name} at {'' if share == 1 else f'{share:g} '}τ": share * match.parameters.tau for share in shares}
    return {label: map_quality(match.mesh, match.point_map(time)) for label, time in named.items()}


def all_measures(qualities: Mapping[str, MapQuality]) -> tuple[Measure, ...]:
    """The `quality_measures` of several maps."""
    return tuple(measure for name, quality in qualities.items() for measure in quality_measures(name, quality))


def quality_measures(name: str, quality: MapQuality) -> tuple[Measure, ...]:
    """A map's `off_surface`, largest and RMS, and `folded`."""
    return (
        Measure(f"{name}: off_surface, largest, sqrt(area)", quality.largest_distance),
        Measure(f"{name}: off_surface, RMS, sqrt(area)", quality.rms_distance),
        Measure(f"{name}: folded, % of the faces", 100 * quality.folded),
    )


def notes(qualities: Mapping[str, MapQuality]) -> tuple[str, ...]:
    """A line for a sheet that says which of its maps, by name, are not to be trusted; none if all are."""
    faults = [f"{name} ({quality.faults})" for name, quality in qualities.items() if quality.faults]
    return (f"Not to be trusted as maps: {'; '.join(faults)}.",) if faults else ()
