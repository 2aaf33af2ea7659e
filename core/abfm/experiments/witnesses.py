"""What witnesses say of a match, who know nothing of how it was found, and what all figures say of their maps."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from abfm.errors import ParameterError
from abfm.experiments.experiment import Measure
from abfm.maps.quality import MapQuality, map_quality
from abfm.matching.result import Match


@dataclass(frozen=True, eq=False)
class Witnessed:
    """A match as its witnesses see it.

    Attributes
    ----------
    measures : tuple of Measure
        The mismatch by flow lines, that on the subdivided mesh, and the folded faces, as far as they are known.
    label : str
        For the panel of the match: both mismatches.
    note : str
        What is not known and why, a sentence after a space; empty if all is known.
    """

    measures: tuple[Measure, ...]
    label: str
    note: str


def witnessed(match: Match) -> Witnessed:
    """Ask the witnesses of `abfm.verify`."""
    try:
        found = match.verify()
    except ParameterError as error:
        return Witnessed((), "matched", f" Not verified: {error}.")
    numbers = {
        "mismatch by flow lines, relative L2": found.flow_lines,
        "mismatch on the subdivided mesh, relative L2": found.subdivided,
        "folded faces, as a share of all": found.folded,
    }
    return Witnessed(
        tuple(Measure(name, value) for name, value in numbers.items() if math.isfinite(value)),
        f"matched: {match.mismatch:.2g}, {found.flow_lines:.2g} by flow lines",
        " On the subdivided mesh the flow overflows." if math.isinf(found.subdivided) else "",
    )


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
