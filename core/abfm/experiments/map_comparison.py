"""The maps of figures 12 and 13: by matching one function, three, and by a reduced basis, and how far off each is."""

from dataclasses import dataclass, replace

from abfm.baselines.reduced_basis import ReducedEnergy, ReducedMatch, reduced_match
from abfm.experiments import read_outs
from abfm.experiments.experiment import Report
from abfm.experiments.pair import PairSetup, closest, followed, matched
from abfm.flow.advection import advect
from abfm.maps.accuracy import MapAccuracy, map_accuracy
from abfm.maps.functional_maps import functional_map, point_map
from abfm.maps.quality import MapQuality, map_quality
from abfm.maps.surface_points import SurfacePoints, pull_back
from abfm.matching.result import Match
from abfm.types import FloatArray

ONE, THREE, REDUCED = "1 function", "3 functions", "reduced basis"
BOTH = "3 functions, both cut off"
AGAIN = "ZoomOut, then 3 functions, both cut off"
_FIELDS, _SIGMA = 50, 0.1
_ALL_UP_TO, _MEASURED = 1500, 500


@dataclass(frozen=True, eq=False)
class Comparison:
    """Matches, and the accuracy of their maps.

    `one` and `three` are of the coordinate with the largest extent, and of all three; `one_carries` and
    `reduced_functions` (V, 3) are all three coordinates, carried by the first flow and by that of the reduced basis.
    Accuracies and qualities are of the maps by name, and of those that need no flow (see `abfm.experiments.read_outs`).
    """

    one: Match
    three: Match
    one_carries: FloatArray
    reduced: ReducedMatch
    reduced_functions: FloatArray
    accuracies: dict[str, MapAccuracy]
    qualities: dict[str, MapQuality]
    setting: str


def compare(setup: PairSetup, report: Report) -> Comparison:
    """Match by all ways and measure; kept with the mesh, so that the second figure need not wait."""
    key = (__name__, setup.parameters, setup.wanted.shape)
    if key not in setup.mesh.cache:
        setup.mesh.cache[key] = _compare(setup, report)
    found: Comparison = setup.mesh.cache[key]
    return found


def _compare(setup: PairSetup, report: Report) -> Comparison:
    b, p = setup.mesh, setup.parameters
    one = matched(setup, [setup.longest[0]], report, "matching one function", (0.0, 0.2))
    three = matched(setup, [0, 1, 2], report, "matching three functions", (0.2, 0.4))
    maps = read_outs.without_flow(setup)
    maps |= _both_cut_off(setup, BOTH, report, "matching three functions, cut off", (0.4, 0.6))
    better = replace(setup, start=maps[read_outs.ZOOM_OUT])
    maps |= _both_cut_off(better, AGAIN, report, "refining a good map", (0.6, 0.8))
    report("matching in a reduced basis", 0.8)
    k = len(setup.wanted)
    fields = min(_FIELDS, k // 2)
    begin = functional_map(setup.other, b, setup.start, k)
    reduced = reduced_match(ReducedEnergy(b, begin, setup.wanted, fields, p.tau, p.alpha, _SIGMA))
    one_carries = one.push(setup.source, p.tau)
    reduced_functions = advect(b, reduced.velocity, setup.source, p.tau)
    maps |= {
        THREE: closest(setup, three.advected),
        THREE + read_outs.CUT_OFF: read_outs.closest_cut_off(setup, three.advected),
        ONE: closest(setup, one_carries),
        REDUCED: closest(setup, reduced_functions),
        **read_outs.by_flow(setup, THREE, three),
        **read_outs.by_flow(setup, ONE, one),
        REDUCED + read_outs.LINES: followed(setup, reduced.velocity[None]),
        REDUCED + read_outs.NEIGHBOURS: point_map(setup.other, b, reduced.functional_map),
    }
    return Comparison(
        one=one,
        three=three,
        one_carries=one_carries,
        reduced=reduced,
        reduced_functions=reduced_functions,
        accuracies=_accuracies(setup, maps, report),
        qualities={name: map_quality(b, points, setup.other) for name, points in maps.items()},
        setting=(
            f"Reduced basis: {k} eigenfunctions, {2 * fields} fields, sigma {_SIGMA:g}. Maps: the closest points of A "
            "to the carried coordinates; among A's coordinates cut off as the targets are; the start map composed with "
            "exact flow lines; or nearest neighbours by the flow's functional map"
        ),
    )


def _both_cut_off(
    setup: PairSetup, name: str, report: Report, text: str, shares: tuple[float, float]
) -> dict[str, SurfacePoints]:
    """Maps of a match whose sources are cut off as its targets are, so that a true start has nothing to correct."""
    source = pull_back(setup.other, setup.start, read_outs.cut_off(setup.other, len(setup.wanted)))
    found = matched(setup, [0, 1, 2], report, text, shares, source)
    return {name: read_outs.closest_cut_off(setup, found.advected), **read_outs.by_flow(setup, name, found)}


def _accuracies(setup: PairSetup, maps: dict[str, SurfacePoints], report: Report) -> dict[str, MapAccuracy]:
    most = _ALL_UP_TO if len(setup.mesh.vertices) <= _ALL_UP_TO else _MEASURED
    found = {}
    for index, (name, points) in enumerate(maps.items()):
        report("measuring the maps", 0.85 + 0.15 * index / len(maps))
        found[name] = map_accuracy(setup.other, points, most=most)
    return found
