"""Figure 13: how accurate the maps of figure 12 are, against the true one."""

from __future__ import annotations

import numpy as np

from abfm.experiments.experiment import Experiment, Findings, Measure, Report
from abfm.experiments.figure_12 import set_up
from abfm.experiments.map_comparison import compare
from abfm.experiments.pair import PairSetup
from abfm.experiments.sheet import Curve, Plot, Sheet

_SHOWN = 0.15
_BOUND = 0.05
_MAPS = ("3 functions", "1 function", "reduced basis")
_REFERENCES = ("start", "3 functions, flow lines", "reduced basis, nearest neighbours")


def run(setup: PairSetup, report: Report) -> Findings:
    """Measure, and plot the share of vertices under an error."""
    found = compare(setup, report)
    accuracies = found.accuracies
    three, one, reduced = (accuracies[name] for name in _MAPS)
    errors = np.linspace(0, _SHOWN, 301)
    measures = []
    for name, ours in (("1 function", one), ("3 functions", three)):
        behind = reduced.share_under(errors) - ours.share_under(errors)
        most = 100 * max(float(behind.max()), 0.0)
        difference = ours.mean - reduced.mean
        better = f"{name}: a better reconstruction than [COC15]"
        measures += [
            Measure(
                f"{name}: mean error less that of the reduced basis, sqrt(area)",
                difference,
                None,
                better,
                difference < 0,
            ),
            Measure(f"{name}: most that its curve is below the reduced basis', %", most, None, better, most == 0),
        ]
    for name, accuracy in accuracies.items():
        measures += [
            Measure(f"{name}: mean error, sqrt(area)", accuracy.mean),
            Measure(f"{name}: largest error, sqrt(area)", accuracy.maximum),
            Measure(
                f"{name}: vertices with an error under {_BOUND:g} sqrt(area), %",
                100 * float(accuracy.share_under(_BOUND)),
            ),
        ]
    start = accuracies["start"]
    for name in ("3 functions", "3 functions, flow lines"):
        gain = accuracies[name].mean - start.mean
        measures.append(
            Measure(f"{name}: mean error less the start's, sqrt(area)", gain, None, "the map is improved", gain < 0)
        )
    curves = [Curve(name, errors, 100 * accuracies[name].share_under(errors)) for name in _MAPS]
    curves += [Curve(name, errors, 100 * accuracies[name].share_under(errors), faint=True) for name in _REFERENCES]
    plot = Plot(tuple(curves), "geodesic error, √area", "vertices, %", "errors of the maps", width=2)
    measured = len(three.errors)
    return Findings(
        tuple(measures), Sheet(((plot,),)), f"{setup.setting}. {found.setting}. Errors at {measured:,} vertices"
    )


EXPERIMENT = Experiment(
    13,
    "Matching only three functions reconstructs the map better than the method [COC15] in a reduced basis.",
    set_up,
    run,
)
