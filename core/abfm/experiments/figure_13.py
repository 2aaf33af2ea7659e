"""Figure 13: how accurate the maps of figure 12 are, and what the flow adds to them."""

from collections.abc import Mapping

import numpy as np

from abfm.experiments import figure_12 as maps
from abfm.experiments.figure_11 import Poses
from abfm.experiments.figure_12 import BOTH, NEIGHBOURS, ONE, REDUCED, START, TARGETS, THREE
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage, map_findings
from abfm.io.sheets import Curve, Plot, Sheet
from abfm.maps import MapAccuracy, map_accuracy
from abfm.parameters import TABLE_1

CLAIM = (
    "Matching only three functions reconstructs the map better than the method [COC15] in a "
    "reduced basis."
)

_ALL_UP_TO, _MEASURED = 1500, 500
_BOUND = 0.05
_ERRORS = np.linspace(0, 0.15, 301)
_OURS = (BOTH, BOTH + NEIGHBOURS, maps.AGAIN + NEIGHBOURS)
_MAPS = (THREE, ONE, REDUCED, BOTH + NEIGHBOURS)
_REFERENCES = (START, TARGETS, THREE + maps.LINES, REDUCED + NEIGHBOURS, maps.ZOOM_OUT)
_PAIRS = (
    (THREE, TARGETS),
    (THREE + maps.CUT_OFF, TARGETS + maps.CUT_OFF),
    (BOTH, TARGETS + maps.CUT_OFF),
    *((name + NEIGHBOURS, maps.NO_FLOW + NEIGHBOURS) for name in (ONE, THREE, BOTH, REDUCED)),
    (maps.AGAIN + NEIGHBOURS, maps.ZOOM_OUT),
)
"""A map with a flow, and what the same data give without one, read off alike."""


def figure(stage: Stage) -> Script:
    """Measure the maps of figure 12, and plot the share of vertices under an error."""
    poses = Poses.of(stage)
    example = poses.example(TABLE_1[12], [0, 1, 2], stage.small)
    yield example

    found = maps.compare(poses, example.problem, stage)
    most = _ALL_UP_TO if len(poses.b.vertices) <= _ALL_UP_TO else _MEASURED
    accuracies = {}
    for number, (name, points) in enumerate(found.maps.items()):
        stage.report("measuring the maps", 0.85 + 0.15 * number / len(found.maps))
        accuracies[name] = map_accuracy(points, most=most)

    measures = compared(accuracies)
    for name, accuracy in accuracies.items():
        share = 100 * float(accuracy.share_under(_BOUND))
        measures += [
            Measure(f"{name}: mean error, sqrt(area)", accuracy.mean),
            Measure(f"{name}: largest error, sqrt(area)", accuracy.maximum),
            Measure(f"{name}: vertices with an error under {_BOUND:g} sqrt(area), %", share),
        ]
    of_maps, notes = map_findings({name: found.qualities[name] for name in (*maps.SHOWN, *_OURS)})
    curves = tuple(
        Curve(name, _ERRORS, 100 * accuracies[name].share_under(_ERRORS), name in _REFERENCES)
        for name in (*_MAPS, *_REFERENCES)
    )
    plot = Plot(curves, "geodesic error, √area", "vertices, %", "errors of the maps", width=3)
    setting = (
        f"{poses.setting(example.problem, [0, 1, 2])}. {found.setting}. Errors at "
        f"{len(accuracies[THREE].errors):,} vertices"
    )
    return Findings((*measures, *of_maps), Sheet(((plot,),), notes=notes), setting)


def compared(accuracies: Mapping[str, MapAccuracy]) -> list[Measure]:
    """Compare with the reduced basis, the start, and what the same data give without a flow."""

    def less(ours: str, theirs: str) -> float:
        return accuracies[ours].mean - accuracies[theirs].mean

    measures = []
    for reading in ("", NEIGHBOURS):
        theirs = REDUCED + reading
        for name in (ONE, THREE):
            ours, better = name + reading, f"{name}: a better reconstruction than [COC15]"
            behind = accuracies[theirs].share_under(_ERRORS) - accuracies[ours].share_under(_ERRORS)
            most, apart = 100 * max(float(behind.max()), 0.0), less(ours, theirs)
            of_mean = f"{ours}: mean error less that of the reduced basis{reading}, sqrt(area)"
            of_curve = f"{ours}: most that its curve is below the reduced basis'{reading}, %"
            measures += [
                Measure(of_mean, apart, better, apart < 0),
                Measure(of_curve, most, better, most == 0),
            ]
    for ours in (THREE, THREE + maps.LINES, THREE + NEIGHBOURS):
        text, apart = f"{ours}: mean error less the start's, sqrt(area)", less(ours, START)
        measures.append(Measure(text, apart, "the map is improved", apart < 0))
    adds = "what the flow adds: mean error of"
    return measures + [
        Measure(f"{adds} '{ours}' less that of '{without}', sqrt(area)", less(ours, without))
        for ours, without in _PAIRS
    ]
