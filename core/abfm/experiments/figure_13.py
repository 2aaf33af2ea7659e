"""Figure 13: how accurate the maps of figure 12 are, against the true one, and what the flow adds to them."""

import numpy as np

from abfm.experiments.experiment import Experiment, Findings, Measure, Report
from abfm.experiments.figure_12 import QUALITIES, set_up
from abfm.experiments.map_comparison import AGAIN, BOTH, ONE, REDUCED, THREE, compare
from abfm.experiments.pair import PairSetup
from abfm.experiments.read_outs import CUT_OFF, LINES, NEIGHBOURS, NO_FLOW, START, TARGETS, ZOOM_OUT
from abfm.experiments.sheet import Curve, Plot, Sheet
from abfm.experiments.witnesses import all_measures, notes
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
    measures = (*_against_others(accuracies), *_of_each(accuracies), *all_measures(shown))
    curves = [Curve(name, _ERRORS, 100 * accuracies[name].share_under(_ERRORS)) for name in _MAPS]
    curves += [Curve(name, _ERRORS, 100 * accuracies[name].share_under(_ERRORS), faint=True) for name in _REFERENCES]
    plot = Plot(tuple(curves), "geodesic error, √area", "vertices, %", "errors of the maps", width=3)
    setting = f"{setup.setting}. {found.setting}. Errors at {len(accuracies[THREE].errors):,} vertices"
    return Findings(measures, Sheet(((plot,),), notes=notes(shown)), setting)


def _against_others(accuracies: dict[str, MapAccuracy]) -> list[Measure]:
    """Against the reduced basis, the start, and what the same data give without a flow."""

    def gain(ours: str, other: str) -> float:
        return accuracies[ours].mean - accuracies[other].mean

    measures = []
    for reading in ("", NEIGHBOURS):
        theirs = REDUCED + reading
        for name in (ONE, THREE):
            ours, better = name + reading, f"{name}: a better reconstruction than [COC15]"
            behind = accuracies[theirs].share_under(_ERRORS) - accuracies[ours].share_under(_ERRORS)
            most, less = 100 * max(float(behind.max()), 0.0), gain(ours, theirs)
            of_mean = f"{ours}: mean error less that of the reduced basis{reading}, sqrt(area)"
            of_curve = f"{ours}: most that its curve is below the reduced basis'{reading}, %"
            measures += [Measure(of_mean, less, better, less < 0), Measure(of_curve, most, better, most == 0)]
    for ours in (THREE, THREE + LINES, THREE + NEIGHBOURS):
        less = gain(ours, START)
        text = f"{ours}: mean error less the start's, sqrt(area)"
        measures.append(Measure(text, less, "the map is improved", less < 0))
    for ours, without in _PAIRS:  # below 0 where the flow brings a map nearer the truth than its data already are
        text = f"what the flow adds: mean error of '{ours}' less that of '{without}', sqrt(area)"
        measures.append(Measure(text, gain(ours, without)))
    return measures


def _of_each(accuracies: dict[str, MapAccuracy]) -> list[Measure]:
    measures = []
    for name, accuracy in accuracies.items():
        share = 100 * float(accuracy.share_under(_BOUND))
        measures += [
            Measure(f"{name}: mean error, sqrt(area)", accuracy.mean),
            Measure(f"{name}: largest error, sqrt(area)", accuracy.maximum),
            Measure(f"{name}: vertices with an error under {_BOUND:g} sqrt(area), %", share),
        ]
    return measures


EXPERIMENT = Experiment(
    13,
    "Matching only three functions reconstructs the map better than the method [COC15] in a reduced basis.",
    set_up,
    run,
)
