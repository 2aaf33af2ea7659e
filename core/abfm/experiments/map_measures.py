"""What every figure with a map says of it: how far it leaves the surface, and how much it folds."""

from collections.abc import Mapping, Sequence

from abfm.experiments.experiment import Measure
from abfm.maps.quality import MapQuality, map_quality
from abfm.matching.result import Match


def of_flow(match: Match, name: str, shares: Sequence[float] = (1.0,)) -> dict[str, MapQuality]:
    """Qualities of the maps that a flow makes of its surface, at some shares of tau, by names to show."""
    named = {f"{name} at {'' if share == 1 else f'{share:g} '}τ": share * match.parameters.tau for share in shares}
    return {label: map_quality(match.mesh, match.point_map(time)) for label, time in named.items()}


def all_measures(qualities: Mapping[str, MapQuality]) -> tuple[Measure, ...]:
    """The `off_surface`, largest and RMS, and `folded` of several maps."""
    return tuple(
        Measure(f"{name}: {what}", value)
        for name, quality in qualities.items()
        for what, value in (
            ("off_surface, largest, sqrt(area)", quality.largest_distance),
            ("off_surface, RMS, sqrt(area)", quality.rms_distance),
            ("folded, % of the faces", 100 * quality.folded),
        )
    )


def notes(qualities: Mapping[str, MapQuality]) -> tuple[str, ...]:
    """A line for a sheet that says which of its maps, by name, are not to be trusted; none if all are."""
    faults = [f"{name} ({quality.faults})" for name, quality in qualities.items() if quality.faults]
    return (f"Not to be trusted as maps: {'; '.join(faults)}.",) if faults else ()
