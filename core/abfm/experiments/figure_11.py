"""Figure 11: two functions with jumps become smooth ones, shown as texture coordinates."""

import numpy as np

from abfm.calculus.operators import vertex_areas
from abfm.experiments.experiment import Experiment, Findings, Measure, Report
from abfm.experiments.pair import MATCHED, PairSetup, coordinates, matched, pair, share_left
from abfm.experiments.sheet import Panel, Sheet, Values
from abfm.experiments.witnesses import all_measures, notes, of_flow
from abfm.mesh import TriangleMesh


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> PairSetup:
    """Two coordinates of pose A on pose B, by a wrong map and by the true functional map."""
    return pair(11, mesh, small, 2)


def run(setup: PairSetup, report: Report) -> Findings:
    """Match both at once, and see what is left at every vertex."""
    found = matched(setup, [0, 1], report, "matching two functions")
    flow = of_flow(found, "the flow on B")
    weights = vertex_areas(setup.mesh.normalized())
    before, after = (np.abs(setup.target - f).sum(axis=1) for f in (setup.source, found.advected))
    left = share_left(float(weights @ after), float(weights @ before))
    claim = "the matching succeeds"
    measures = (
        Measure("mean pointwise sum of absolute errors before, sqrt(area)", weights @ before),
        Measure("mean pointwise sum of absolute errors after, sqrt(area)", weights @ after),
        Measure("share of the pointwise sum of errors that is left", left, claim, left <= MATCHED),
        Measure("largest pointwise sum of errors before, sqrt(area)", before.max()),
        Measure("largest pointwise sum of errors after, sqrt(area)", after.max()),
        Measure("mismatch", found.mismatch),
        *all_measures(flow),
    )
    panels = (
        Panel(setup.other, setup.checker(coordinates(setup.other)[:, setup.axes]), "coordinates"),
        Panel(setup.mesh, setup.checker(setup.source), "by a point map", "source"),
        Panel(setup.mesh, setup.checker(setup.target), "by a functional map", "target"),
        Panel(setup.mesh, setup.checker(found.advected), "matched", "result"),
        Panel(setup.mesh, Values(after, "sum of errors, √area"), "what is left"),
    )
    return Findings(measures, Sheet((panels,), seen=(before,), one_view=True, notes=notes(flow)), setup.setting)


EXPERIMENT = Experiment(
    11,
    "Two non-smooth functions are matched to smooth versions of them at once, and the required functions are achieved.",
    set_up,
    run,
)
