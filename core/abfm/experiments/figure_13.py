"""Figure 13: how accurate the maps of figure 12 are, against the true one, and what the flow adds to them."""

from __future__ import annotations

import numpy as np

from abfm.experiments.experiment import Experiment, Findings, Measure, Report
from abfm.experiments.figure_12 import QUALITIES, set_up
from abfm.experiments.map_comparison import AGAIN, BOTH, ONE, REDUCED, THREE, compare
from abfm.experiments.map_measures import all_measures, notes
from abfm.experiments.pair import PairSetup
from abfm.experiments.read_outs import CUT_OFF, LINES, NEIGHBOURS, NO_FLOW, START, TARGETS, ZOOM_OUT
from abfm.experiments.sheet import Curve, Plot, Sheet
from abfm.maps.accuracy import MapAccuracy

_SHOWN = 0.15
_BOUND = 0.05
_OURS = (BOTH, BOTH + NEIGHBOURS, AGAIN + NEIGHBOURS)
_ERRORS = np.linspace(0, _SHOWN, 301)
_MAPS = (THREE, ONE, REDUCED, BOTH + NEIGHBOURS)
_REFERENCES = (START, TARGETS, THREE + LINES, REDUCED + NEIGHBOURS, ZOOM_OUT)
_PAIRS = (
    (THREE, TARGETS),
    (THREE + CUT_OFF, TARGETS + CUT_OFF),
    (BOTH, TARGETS + CUT_OFF),
    (ONE + NEIGHBOURS, NO_FLOW + NEIGHBOURS),
    (THREE + NEIGHBOURS, NO_FLOW + NEIGHBOURS),
    (BOTH + NEIGHBOURS, NO_FLOW + NEIGHBOURS),
    (REDUCED + NEIGHBOURS, NO_FLOW + NEIGHBOURS),
    (AGAIN + NEIGHBOURS, ZOOM_OUT),
)
"""A map with a flow, and what the same data give without one, read off alike."""


def run(setup: PairSetup, report: Report) -> Findings:
    """Measure, and plot the share of vertices under an error."""
    found = compare(setup, report)
    accuracies = found.accuracies
    shown = {name: found.qualities[name] for name in (*QUALITIES, *_OURS)}
    measures = (
        *_against_reduced_basis(accuracies),
        *_against_start(accuracies),
        *_added_by_flow(accuracies),
        *_of_each(accuracies),
        *all_measures(shown),
    )
    curves = [_curve(name, accuracies[name]) for name in _MAPS]
    curves += [_curve(name, accuracies[name], faint=True) for name in _REFERENCES]
    plot = Plot(tuple(curves), "geodesic error, √area", "vertices, %", "errors of the maps", width=3)
    measured = len(accuracies[THREE].errors)
    return Findings(
        measures,
        Sheet(((plot,),), notes=notes(shown)),
        f"{setup.setting}. {found.setting}. Errors at {measured:,} vertices",
    )


def _curve(name: str, accuracy: MapAccuracy, faint: bool = False) -> Curve:
    return Curve(name, _ERRORS, 100 * accuracy.share_under(_ERRORS), faint)


def _against_reduced_basis(accuracies: dict[str, MapAccuracy]) -> list[Measure]:
    measures = []
    for reading in ("", NEIGHBOURS):
        reduced = accuracies[REDUCED + reading]
        for name in (ONE, THREE):
            ours = accuracies[name + reading]
            behind = reduced.share_under(_ERRORS) - ours.share_under(_ERRORS)
            most = 100 * max(float(behind.max()), 0.0)
            difference = ours.mean - reduced.mean
            better = f"{name}: a better reconstruction than [COC15]"
            measures += [
                Measure(
                    f"{name}{reading}: mean error less that of the reduced basis{reading}, sqrt(area)",
                    difference,
                    None,
                    better,
                    difference < 0,
                ),
                Measure(
                    f"{name}{reading}: most that its curve is below the reduced basis'{reading}, %",
                    most,
                    None,
                    better,
                    most == 0,
                ),
            ]
    return measures


def _against_start(accuracies: dict[str, MapAccuracy]) -> list[Measure]:
    measures = []
    for name in (THREE, THREE + LINES, THREE + NEIGHBOURS):
        gain = accuracies[name].mean - accuracies[START].mean
        text = f"{name}: mean error less the start's, sqrt(area)"
        measures.append(Measure(text, gain, None, "the map is improved", gain < 0))
    return measures


def _added_by_flow(accuracies: dict[str, MapAccuracy]) -> list[Measure]:
    """Below 0 where the flow brings a map nearer the truth than what it was matched to, or began with, already is."""
    return [
        Measure(
            f"what the flow adds: mean error of '{ours}' less that of '{without}', sqrt(area)",
            accuracies[ours].mean - accuracies[without].mean,
        )
        for ours, without in _PAIRS
    ]


def _of_each(accuracies: dict[str, MapAccuracy]) -> list[Measure]:
    measures = []
    for name, accuracy in accuracies.items():
        measures += [
            Measure(f"{name}: mean error, sqrt(area)", accuracy.mean),
            Measure(f"{name}: largest error, sqrt(area)", accuracy.maximum),
            Measure(
                f"{name}: vertices with an error under {_BOUND:g} sqrt(area), %",
                100 * float(accuracy.share_under(_BOUND)),
            ),
        ]
    return measures


EXPERIMENT = Experiment(
    13,
    "Matching only three functions reconstructs the map better than the method [COC15] in a reduced basis.",
    set_up,
    run,
)
