"""What witnesses say of a match, who know nothing of how it was found, and what is said of maps."""

import math
from collections.abc import Mapping, Sequence

from abfm import Match, ParameterError
from abfm.experiments.vocabulary import Measure
from abfm.maps import MapQuality, map_quality


def witnessed(found: Match) -> tuple[tuple[Measure, ...], str, str]:
    """Ask the witnesses of `abfm.verify`, who know nothing of how a match was found.

    Returns
    -------
    measures : tuple of Measure
        The mismatch by flow lines, that on the subdivided mesh, and the folded faces, as far as
        they are known.
    label : str
        For the panel of the match: both mismatches.
    note : str
        What is not known and why, a sentence after a space; empty if all is known.
    """
    try:
        said = found.verify()
    except ParameterError as error:
        return (), "matched", f" Not verified: {error}."
    numbers = {
        "mismatch by flow lines, relative L2": said.flow_lines,
        "mismatch on the subdivided mesh, relative L2": said.subdivided,
        "folded faces, as a share of all": said.folded,
    }
    measures = tuple(Measure(name, x) for name, x in numbers.items() if math.isfinite(x))
    label = f"matched: {found.mismatch:.2g}, {said.flow_lines:.2g} by flow lines"
    overflows = " On the subdivided mesh the flow overflows." if math.isinf(said.subdivided) else ""
    return measures, label, overflows


def maps_of_flow(
    found: Match, name: str, shares: Sequence[float] = (1.0,)
) -> dict[str, MapQuality]:
    """Judge the maps that a flow makes of its surface, at some shares of tau, by names to show."""
    tau = found.parameters.tau
    return {
        f"{name} at {'' if share == 1 else f'{share:g} '}τ": map_quality(
            found.point_map(share * tau)
        )
        for share in shares
    }


def map_measures(qualities: Mapping[str, MapQuality]) -> list[Measure]:
    """Return the `off_surface`, largest and RMS, and `folded` of several maps."""
    return [
        Measure(f"{name}: {what}", value)
        for name, quality in qualities.items()
        for what, value in (
            ("off_surface, largest, sqrt(area)", quality.largest_distance),
            ("off_surface, RMS, sqrt(area)", quality.rms_distance),
            ("folded, % of the faces", 100 * quality.folded),
        )
    ]


def map_notes(qualities: Mapping[str, MapQuality]) -> tuple[str, ...]:
    """Say which maps, by name, are not to be trusted, in one line; none if all are."""
    faults = [f"{name} ({quality.faults})" for name, quality in qualities.items() if quality.faults]
    return (f"Not to be trusted as maps: {'; '.join(faults)}.",) if faults else ()
