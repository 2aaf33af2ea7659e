"""The paper's figures, small; on their own meshes each runs once in a process."""

import math
from functools import cache

from abfm.experiments import FigureSetup, example_of, findings_of, script
from abfm.maps.quality import DISTANCE_MAX, FOLDED_SHARE_MAX, RMS_DISTANCE_MAX


def quiet(text, share):
    """A report that nobody reads, but for its promises."""
    assert text
    assert 0 <= share <= 1


def stated(figure, mesh=None):
    return example_of(script(figure, FigureSetup(mesh, small=True)))


def run(figure, mesh=None):
    """What a figure is about and what it finds, all of it finite."""
    setup = FigureSetup(mesh, small=True, report=quiet)
    whole = script(figure, setup)
    example = example_of(whole)
    matches = setup.match(next(whole)) if example.flow is None else ()
    findings = findings_of(whole, matches)
    assert all(math.isfinite(measure.to_dict()["value"]) for measure in findings.measures)
    return example, findings


ran = cache(run)


def values(findings):
    """Measured numbers by their names."""
    return {measure.name: measure.value for measure in findings.measures}


def value(findings, *words):
    """The one number with all these words in its name."""
    [found] = [x for name, x in values(findings).items() if all(word in name for word in words)]
    return found


def assert_maps_are_measured(findings):
    """Each map of a figure has its distances and folds, and a note if these are too large."""
    measured, which = values(findings), ": off_surface, largest"
    names = [name.split(which)[0] for name in measured if which in name]
    assert names
    for name in names:
        largest, rms = (
            measured[f"{name}: off_surface, {w}, sqrt(area)"] for w in ("largest", "RMS")
        )
        folded = measured[f"{name}: folded, % of the faces"]
        assert 0 <= rms <= largest
        assert 0 <= folded <= 100
        faulty = largest > DISTANCE_MAX or rms > RMS_DISTANCE_MAX or folded > 100 * FOLDED_SHARE_MAX
        told = any(f"{mark} {name} (" in note for note in findings.sheet.notes for mark in ":;")
        assert told == faulty
