"""What is reported of a registration, once for every view."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from abfm.errors import AbfmError
from abfm.maps.spherical import is_sphere
from abfm.matching.judging.facts import known_numbers
from abfm.outcome import Facts, worse_residual

if TYPE_CHECKING:
    from abfm.registration.registration import Registration


def facts_of(found: Registration) -> Facts:
    """Return the facts of a registration: those of its match, with its own verdict, and residual,
    distortion and folds of the complete map from A to B.
    """
    match = found.match
    try:
        distortion = found.distortion()
    except AbfmError as error:  # of a field that leads over too many faces
        return replace(match.facts, warnings=(*match.facts.warnings, *found.warnings, str(error)))
    report, faces = match.report, len(distortion.flipped)
    folded, flipped = distortion.folded, found.flipped_by_vertices()
    is_known = not math.isnan(found.residual)
    areas = distortion.log2_area
    evidence = replace(
        report.evidence,
        verified=worse_residual(match.verified_residual, found.residual),
        folded=folded / faces,
        log2_area=areas.mean,
    )
    facts = replace(
        report,
        verdict=found.verdict,
        evidence=evidence,
        initial_residual=found.initial_residual if is_known else match.initial_residual,
        log2_area_95=areas.p95,
    ).facts()
    of_map = {
        "verified_residual": match.verified_residual,
        "map_residual": found.residual,
        "folded_faces": folded,
        "flipped_by_vertices": flipped,
    }
    warnings = [*facts.warnings, *found.warnings]
    if folded:
        warnings.append(f"{folded:,} of {faces:,} faces of B are folded by the map to A")
    if flipped and is_sphere(found.b):
        count = f"{flipped:,} of {len(found.a.faces):,} faces of A"
        warnings.append(f"{count} are flipped if its vertices alone are moved, as in a sphere.reg")
    return replace(
        facts, numbers={**facts.numbers, **known_numbers(of_map)}, warnings=tuple(warnings)
    )
