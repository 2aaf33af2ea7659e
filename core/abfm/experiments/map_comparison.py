"""The maps of figures 12 and 13: by matching one function, three, and by a reduced basis, and how far off each is."""

from __future__ import annotations

from dataclasses import dataclass

from abfm.advection import advect
from abfm.baselines.reduced_basis import ReducedMatch, reduced_match
from abfm.experiments.experiment import Report
from abfm.experiments.pair import PairSetup, closest, followed, matched
from abfm.functional_maps import functional_map, point_map
from abfm.map_accuracy import MapAccuracy, map_accuracy
from abfm.match_result import Match
from abfm.mesh import FloatArray

_FIELDS, _SIGMA = 50, 0.1
_MEASURED = 1500


@dataclass(frozen=True, eq=False)
class Comparison:
    """Matches, and the accuracy of their maps.

    Attributes
    ----------
    one, three : Match
        Of the coordinate with the largest extent, and of all three.
    one_carries : (V, 3) array
        All three coordinates, carried by the flow of the first.
    reduced : ReducedMatch
    reduced_functions : (V, 3) array
        The three coordinates, carried by the flow of the reduced basis' field.
    accuracies : dict of name to MapAccuracy
        Of the maps and of what they are compared with.
    setting : str
    """

    one: Match
    three: Match
    one_carries: FloatArray
    reduced: ReducedMatch
    reduced_functions: FloatArray
    accuracies: dict[str, MapAccuracy]
    setting: str


def compare(setup: PairSetup, report: Report) -> Comparison:
    """Match by all three ways and measure; kept with the mesh, so that the second figure need not wait."""
    key = (__name__, setup.parameters, setup.wanted.shape)
    if key not in setup.mesh.cache:
        setup.mesh.cache[key] = _compare(setup, report)
    found: Comparison = setup.mesh.cache[key]
    return found


def _compare(setup: PairSetup, report: Report) -> Comparison:
    a, b = setup.other, setup.mesh
    one = matched(setup, [setup.longest[0]], lambda share: report("matching one function", 0.3 * share))
    three = matched(setup, [0, 1, 2], lambda share: report("matching three functions", 0.3 + 0.4 * share))
    report("matching in a reduced basis", 0.7)
    k = len(setup.wanted)
    fields = min(_FIELDS, k // 2)
    begin = functional_map(a, b, setup.start, k)
    reduced = reduced_match(b, begin, setup.wanted, fields, setup.parameters.tau, setup.parameters.alpha, _SIGMA)
    report("measuring the maps", 0.8)
    one_carries = one.push(setup.source, setup.parameters.tau)
    reduced_functions = advect(b, reduced.velocity, setup.source, setup.parameters.tau)
    maps = {
        "3 functions": closest(setup, three.advected),
        "1 function": closest(setup, one_carries),
        "reduced basis": closest(setup, reduced_functions),
        "start": setup.start,
        "targets": closest(setup, setup.target),
        "3 functions, flow lines": followed(setup, three.velocity),
        "1 function, flow lines": followed(setup, one.velocity),
        "reduced basis, flow lines": followed(setup, reduced.velocity[None]),
        "reduced basis, nearest neighbours": point_map(a, b, reduced.functional_map),
    }
    accuracies = {}
    for index, (name, points) in enumerate(maps.items()):
        report("measuring the maps", 0.8 + 0.2 * index / len(maps))
        accuracies[name] = map_accuracy(a, points, most=_MEASURED)
    return Comparison(
        one=one,
        three=three,
        one_carries=one_carries,
        reduced=reduced,
        reduced_functions=reduced_functions,
        accuracies=accuracies,
        setting=(
            f"Reduced basis: {k} eigenfunctions, {2 * fields} fields, sigma {_SIGMA:g}. Maps: the closest points of A "
            "to the carried coordinates; or the start map composed with exact flow lines, where that is said"
        ),
    )
