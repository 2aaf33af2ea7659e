"""Small versions of the paper's figures; each default figure runs once in a process."""

import math
from functools import cache

from abfm.experiments import FigureSetup, example_of, findings_of, script
from abfm.maps.quality import DISTANCE_MAX, FOLDED_SHARE_MAX, RMS_DISTANCE_MAX


def quiet(text, share):
    """Check the arguments of a progress report without printing it."""
    assert text
    assert 0 <= share <= 1


def stated(figure, mesh=None):
    return example_of(script(figure, FigureSetup(mesh, small=True)))


def run(figure, mesh=None):
    """Run the small version of a figure; return its example and findings, which must be finite."""
    setup = FigureSetup(mesh, small=True, report=quiet)
    figure_script = script(figure, setup)
    example = example_of(figure_script)
    matches = setup.match(next(figure_script)) if example.flow is None else ()
    findings = findings_of(figure_script, matches)
    assert all(math.isfinite(measure.to_dict()["value"]) for measure in findings.measures)
    return example, findings


ran = cache(run)


def values(findings):
    return {measure.name: measure.value for measure in findings.measures}


def value(findings, *words):
    """Return the only measured number whose name contains all of these words."""
    [found] = [x for name, x in values(findings).items() if all(word in name for word in words)]
    return found


def assert_maps_are_measured(findings):
    """Check that each map has distances, folds, and a note if these exceed their bounds."""
    measured, suffix = values(findings), ": off_surface, largest"
    names = [name.split(suffix)[0] for name in measured if suffix in name]
    assert names
    for name in names:
        largest, rms = (
            measured[f"{name}: off_surface, {w}, sqrt(area)"] for w in ("largest", "RMS")
        )
        folded = measured[f"{name}: folded, % of the faces"]
        assert 0 <= rms <= largest
        assert 0 <= folded <= 100
        faulty = largest > DISTANCE_MAX or rms > RMS_DISTANCE_MAX or folded > 100 * FOLDED_SHARE_MAX
        is_noted = any(
            f"{separator} {name} (" in note for note in findings.sheet.notes for separator in ":;"
        )
        assert is_noted == faulty
