"""Reports of registrations, as numbers for programs and as lines of text."""

from __future__ import annotations

from typing import Any

from abfm.maps.distortion import Distortion
from abfm.maps.quality import MapAccuracy, quality_table
from abfm.matching import report
from abfm.matching.judging.facts import finite
from abfm.registration.correspondence import Correspondence
from abfm.registration.registration import Registration


def details(found: Registration) -> dict[str, Any]:
    """Return the report of a registration as plain numbers and texts; None for unknown values."""
    return {
        **report.details(found.match, found.facts, found.verdict),
        "map": map_details(found),
        **initial_details(found.initial),
        "notes": list(found.notes),
    }


def lines(found: Registration) -> list[str]:
    return [*report.lines(found.match, found.facts), *map_lines(found), *landmark_lines(found)]


def map_details(found: Correspondence, distortion: Distortion | None = None) -> dict[str, Any]:
    """Return distortion, coverage and round-trip errors of a map from B to A, as plain numbers."""
    distortion, back = distortion or found.distortion(), found.round_trip()
    return {
        **distortion_details(distortion),
        "collapsed": distortion.collapsed,
        "coverage": found.coverage(),
        "round_trip": back._asdict(),
    }


def distortion_details(distortion: Distortion) -> dict[str, Any]:
    return {
        "log2_area": distortion.log2_area._asdict(),
        "log2_shape": distortion.log2_shape._asdict(),
        "folded": distortion.folded,
        "faces": len(distortion.flipped),
    }


def initial_details(initial: Correspondence) -> dict[str, Any]:
    tried = initial.candidates
    return {
        "initial": tried[0].name if tried else "given",
        "initial_candidates": [{"name": each.name, "cost": finite(each.cost)} for each in tried],
    }


def map_lines(found: Correspondence, accuracy: MapAccuracy | None = None) -> list[str]:
    return [
        *quality_table(found.distortion(), found.round_trip(), accuracy, "complete map:"),
        f"{100 * found.coverage():.1f}% of A is covered",
    ]


def landmark_lines(found: Registration) -> list[str]:
    errors = found.landmark_errors
    if errors is None:
        return []
    if len(errors) == 1:
        return [f"the landmark has an error of {errors[0]:.2g} sqrt(area)"]
    numbers = f"mean {errors.mean():.2g}, largest {errors.max():.2g} sqrt(area)"
    return [f"errors of {len(errors)} landmarks: {numbers}"]
