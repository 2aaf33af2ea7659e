"""Figure 12: coordinates carried from one pose to another are corrected by matching one function, and three."""

import numpy as np

from abfm.calculus.operators import l2_norm
from abfm.experiments.experiment import Experiment, Findings, Measure, Report
from abfm.experiments.map_comparison import ONE, REDUCED, THREE, compare
from abfm.experiments.pair import MATCHED, PairSetup, coordinates, pair, share_left
from abfm.experiments.read_outs import START, TARGETS
from abfm.experiments.sheet import Panel, Sheet
from abfm.experiments.witnesses import all_measures, notes
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

QUALITIES = (START, TARGETS, ONE, THREE, REDUCED)
"""The maps that the pictures show, of which it is said how much they leave the surface and fold it."""


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> PairSetup:
    """The three coordinates of pose A on pose B, by a wrong map and by the true functional map."""
    return pair(12, mesh, small, 3)


def run(setup: PairSetup, report: Report) -> Findings:
    """Match, and show two of the functions as texture coordinates."""
    found = compare(setup, report)
    source, target, longest = setup.source, setup.target, setup.longest[0]

    def left(after: FloatArray, channels: slice) -> float:
        wanted = target[:, channels]
        before = l2_norm(setup.mesh, source[:, channels] - wanted)
        return share_left(l2_norm(setup.mesh, after - wanted), before)

    one = left(found.one.advected, slice(longest, longest + 1))
    three = left(found.three.advected, slice(3))
    reduced = left(found.reduced_functions, slice(3))
    of_map = share_left(found.reduced.mismatch, found.reduced.start_mismatch)
    claim = "the target functions are matched"
    qualities = {name: found.qualities[name] for name in QUALITIES}
    measures = (
        Measure("1 function: mismatch", found.one.mismatch),
        Measure("1 function: share of the start's mismatch that is left", one, claim, one <= MATCHED),
        Measure("3 functions: mismatch", found.three.mismatch),
        Measure("3 functions: share of the start's mismatch that is left", three, claim, three <= MATCHED),
        Measure("reduced basis: share of the start's mismatch that is left", reduced),
        Measure("reduced basis: share of the functional map's mismatch left", of_map),
        *all_measures(qualities),
    )
    shown = list(setup.longest[:2])
    panels = (
        Panel(setup.other, setup.checker(coordinates(setup.other)[:, shown]), "coordinates"),
        Panel(setup.mesh, setup.checker(source[:, shown]), "start", "source"),
        Panel(setup.mesh, setup.checker(target[:, shown]), "target", "target"),
        Panel(setup.mesh, setup.checker(found.one_carries[:, shown]), "1 function", "field"),
        Panel(setup.mesh, setup.checker(found.three.advected[:, shown]), "3 functions", "result"),
        Panel(setup.mesh, setup.checker(found.reduced_functions[:, shown]), "reduced basis"),
    )
    wrong = np.abs(source - target).sum(axis=1)
    sheet = Sheet((panels,), seen=(wrong,), one_view=True, notes=notes(qualities))
    return Findings(measures, sheet, f"{setup.setting}. {found.setting}")


EXPERIMENT = Experiment(
    12, "Matching one coordinate function or all three brings the target functions about.", set_up, run
)
