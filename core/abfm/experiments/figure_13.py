"""Figure 13: how accurate the maps of figure 12 are, and what the flow adds to them."""

from collections.abc import Mapping

import numpy as np

from abfm.experiments.figure_11 import Poses
from abfm.experiments.figure_12 import (
    AGAIN,
    BOTH,
    CUT_OFF,
    LINES,
    NEIGHBOURS,
    NO_FLOW,
    ONE,
    REDUCED,
    SHOWN,
    START,
    TARGETS,
    THREE,
    ZOOM_OUT,
    compare,
)
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage
from abfm.experiments.witnesses import map_measures, map_notes
from abfm.maps import MapAccuracy, map_accuracy
from abfm.paper import TABLE_1
from abfm.sheets import Curve, Plot, Sheet

CLAIM = (
    "Matching only three functions reconstructs the map better than the method [COC15] in a "
    "reduced basis."
)

_ALL_UP_TO, _MEASURED = 1500, 500
_BOUND = 0.05
_ERRORS = np.linspace(0, 0.15, 301)
_OURS = (BOTH, BOTH + NEIGHBOURS, AGAIN + NEIGHBOURS)
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


def figure(stage: Stage) -> Script:
    """Measure the maps of figure 12, and plot the share of vertices under an error."""
    poses = Poses.of(stage)
    example = poses.example(TABLE_1[12], [0, 1, 2], stage.small)
    yield example

    found = compare(poses, example.problem, stage)
    most = _ALL_UP_TO if len(poses.b.vertices) <= _ALL_UP_TO else _MEASURED
    accuracies = {}
    for number, (name, points) in enumerate(found.maps.items()):
        stage.report("measuring the maps", 0.85 + 0.15 * number / len(found.maps))
        accuracies[name] = map_accuracy(points, most=most)

    measures = [*against_others(accuracies), *against_no_flow(accuracies)]
    for name, accuracy in accuracies.items():
        share = 100 * float(accuracy.share_under(_BOUND))
        measures += [
            Measure(f"{name}: mean error, sqrt(area)", accuracy.mean),
            Measure(f"{name}: largest error, sqrt(area)", accuracy.maximum),
            Measure(f"{name}: vertices with an error under {_BOUND:g} sqrt(area), %", share),
        ]
    qualities = {name: found.qualities[name] for name in (*SHOWN, *_OURS)}
    curves = tuple(
        Curve(name, _ERRORS, 100 * accuracies[name].share_under(_ERRORS), faint)
        for names, faint in ((_MAPS, False), (_REFERENCES, True))
        for name in names
    )
    x_title, y_title = "geodesic error, √area", "vertices, %"
    plot = Plot(curves, x_title, y_title, "errors of the maps", width=3)
    setting = (
        f"{poses.setting(example.problem, [0, 1, 2])}. {found.setting}. Errors at "
        f"{len(accuracies[THREE].errors):,} vertices"
    )
    sheet = Sheet(((plot,),), notes=map_notes(qualities))
    return Findings((*measures, *map_measures(qualities)), sheet, setting)


def against_others(accuracies: Mapping[str, MapAccuracy]) -> list[Measure]:
    """Compare with the reduced basis and the start."""
    measures = []
    for reading in ("", NEIGHBOURS):
        theirs = REDUCED + reading
        for name in (ONE, THREE):
            ours, better = name + reading, f"{name}: a better reconstruction than [COC15]"
            behind = accuracies[theirs].share_under(_ERRORS) - accuracies[ours].share_under(_ERRORS)
            most = 100 * max(float(behind.max()), 0.0)
            less = accuracies[ours].mean - accuracies[theirs].mean
            of_mean = f"{ours}: mean error less that of the reduced basis{reading}, sqrt(area)"
            of_curve = f"{ours}: most that its curve is below the reduced basis'{reading}, %"
            measures += [
                Measure(of_mean, less, better, less < 0),
                Measure(of_curve, most, better, most == 0),
            ]
    for ours in (THREE, THREE + LINES, THREE + NEIGHBOURS):
        less = accuracies[ours].mean - accuracies[START].mean
        text = f"{ours}: mean error less the start's, sqrt(area)"
        measures.append(Measure(text, less, "the map is improved", less < 0))
    return measures


def against_no_flow(accuracies: Mapping[str, MapAccuracy]) -> list[Measure]:
    """Compare with what the same data give without a flow: below 0 where the flow brings a map
    nearer the truth than its data already are.
    """
    return [
        Measure(
            f"what the flow adds: mean error of '{ours}' less that of '{without}', sqrt(area)",
            accuracies[ours].mean - accuracies[without].mean,
        )
        for ours, without in _PAIRS
    ]
