"""Figure 12: carried coordinates are corrected by matching one function, and three; how maps are
read off the flows, and what needs none, is in ``docs/figures/figure-13.md``.
"""

from dataclasses import dataclass, replace

import numpy as np

from abfm import Match, PointMap, Problem, TriangleMesh, advect, maps
from abfm.baselines.reduced_basis import ReducedEnergy, ReducedMatch, reduced_match
from abfm.calculus import l2_norm, unit_eigenbasis
from abfm.experiments.figure_11 import FEW, MATCHED, Poses, by_extent, coordinates, share_left
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage, map_findings
from abfm.flow import flow_lines
from abfm.io.sheets import Frame, Panel, Sheet
from abfm.maps import MapQuality, SurfacePoints, functional_map, point_map, project_onto_surface
from abfm.maps.functional_maps import spectral_coefficients
from abfm.parameters import TABLE_1
from abfm.types import FloatArray

CLAIM = "Matching one coordinate function or all three brings the target functions about."
ONE, THREE, REDUCED = "1 function", "3 functions", "reduced basis"
BOTH, AGAIN = "3 functions, both cut off", "ZoomOut, then 3 functions, both cut off"
CUT_OFF, LINES, NEIGHBOURS = ", cut off alike", ", flow lines", ", nearest neighbours"
START, NO_FLOW, ZOOM_OUT = "start", "no flow", "no flow: ZoomOut of the start"
TARGETS = "no flow: nearest surface points of the target coordinates"
SHOWN = (START, TARGETS, ONE, THREE, REDUCED)
"""The maps that the pictures show, and that are judged as maps."""

_STEP = 10  # of ZoomOut
_FIELDS, _SIGMA = 50, 0.1  # of the reduced basis


def figure(stage: Stage) -> Script:
    """Match the three coordinates of pose A on pose B, and show two as texture coordinates."""
    poses = Poses.of(stage)
    example = poses.example(TABLE_1[12], [0, 1, 2], stage.small)
    yield example

    a, b, problem = poses.a, poses.b, example.problem
    found = compare(poses, problem, stage)
    source, target = problem.source, problem.target
    longest, second, _ = by_extent(a).tolist()

    def left(after: FloatArray, channels: slice) -> float:
        wanted = target[:, channels]
        before = l2_norm(b, source[:, channels] - wanted)
        return share_left(l2_norm(b, after - wanted), before)

    one = left(found.one.advected, slice(longest, longest + 1))
    three = left(found.three.advected, slice(3))
    of_map = share_left(found.reduced.mismatch, found.reduced.start_mismatch)
    claim = "the target functions are matched"
    of_start = "share of the start's mismatch that is left"
    of_maps, notes = map_findings({name: found.qualities[name] for name in SHOWN})
    measures = (
        Measure("1 function: mismatch", found.one.mismatch),
        Measure(f"1 function: {of_start}", one, claim, one <= MATCHED),
        Measure("3 functions: mismatch", found.three.mismatch),
        Measure(f"3 functions: {of_start}", three, claim, three <= MATCHED),
        Measure(f"reduced basis: {of_start}", left(found.reduced_functions, slice(3))),
        Measure("reduced basis: share of the functional map's mismatch left", of_map),
        *of_maps,
    )

    shown: tuple[tuple[TriangleMesh, FloatArray, str, Frame], ...] = (
        (a, coordinates(a), "coordinates", "other"),
        (b, source, "start", "source"),
        (b, target, "target", "target"),
        (b, found.one_carries, "1 function", "field"),
        (b, found.three.advected, "3 functions", "result"),
        (b, found.reduced_functions, "reduced basis", "other"),
    )
    panels = tuple(
        Panel(mesh, poses.checker(functions[:, [longest, second]]), label, frame)
        for mesh, functions, label, frame in shown
    )
    wrong = np.abs(source - target).sum(axis=1)
    sheet = Sheet((panels,), seen=(wrong,), one_view=True, notes=notes)
    return Findings(measures, sheet, f"{poses.setting(problem, [0, 1, 2])}. {found.setting}")


@dataclass(frozen=True, eq=False)
class Comparison:
    """Matches, all three coordinates as two of them carry them, and the maps read off."""

    one: Match
    three: Match
    one_carries: FloatArray
    reduced: ReducedMatch
    reduced_functions: FloatArray
    maps: dict[str, PointMap]
    qualities: dict[str, MapQuality]
    setting: str


def compare(poses: Poses, problem: Problem, stage: Stage) -> Comparison:
    """Match by all methods; kept with the mesh, so that the second figure need not wait."""
    cache, key = poses.b.cache, (__name__, problem.parameters, poses.wanted.shape)
    if key not in cache:
        cache[key] = _compare(poses, problem, stage)
    found: Comparison = cache[key]
    return found


def _compare(poses: Poses, problem: Problem, stage: Stage) -> Comparison:
    a, b, p, k = poses.a, poses.b, problem.parameters, len(poses.wanted)
    source, target, longest = problem.source, problem.target, by_extent(a)[:1]
    alone = Problem(b, source[:, longest], target[:, longest], p)
    one = stage.match(alone, "matching one function", (0.0, 0.2))
    three = stage.match(problem, "matching three functions", (0.2, 0.4))
    read = without_flow(poses, target)
    cut = cut_off(a, k)
    for name, start, text, shares in (
        (BOTH, poses.start, "matching three functions, cut off", (0.4, 0.6)),
        (AGAIN, read[ZOOM_OUT], "refining a good map", (0.6, 0.8)),
    ):
        # sources are cut off as the targets are, so that a true start has nothing to correct
        found = stage.match(Problem(b, start.pull_back(cut), target, p), text, shares)
        read[name] = closest_cut_off(poses, found.advected)
        read |= by_flow(start, k, name, found)
    stage.report("matching in a reduced basis", 0.8)
    count = min(_FIELDS, k // 2)
    begin = functional_map(poses.start, k)
    energy = ReducedEnergy(b, begin, poses.wanted, replace(p, sigma=_SIGMA), count)
    reduced = reduced_match(energy)
    one_carries = one.push(source, p.tau)
    reduced_functions = advect(b, reduced.velocity, source, p.tau)
    read |= {
        THREE: closest(poses, three.advected),
        THREE + CUT_OFF: closest_cut_off(poses, three.advected),
        ONE: closest(poses, one_carries),
        REDUCED: closest(poses, reduced_functions),
        **by_flow(poses.start, k, THREE, three),
        **by_flow(poses.start, k, ONE, one),
        REDUCED + LINES: followed(poses.start, reduced.velocity[None], p.tau),
        REDUCED + NEIGHBOURS: point_map(a, b, reduced.functional_map),
    }
    qualities = {name: maps.map_quality(points) for name, points in read.items()}
    setting = (
        f"Reduced basis: {k} eigenfunctions, {2 * count} fields, sigma {_SIGMA:g}. Maps: the "
        "closest points of A to the carried coordinates; among A's coordinates cut off as the "
        "targets are; the start map composed with exact flow lines; or nearest neighbours by "
        "the flow's functional map"
    )
    return Comparison(one, three, one_carries, reduced, reduced_functions, read, qualities, setting)


def without_flow(poses: Poses, target: FloatArray) -> dict[str, PointMap]:
    """Return the start, and what else the start and the targets (V, 3) say as they are, by name."""
    a, b, k = poses.a, poses.b, len(poses.wanted)
    zoomed = maps.zoom_out(a, b, functional_map(poses.start, FEW), k, _STEP)
    return {
        START: poses.start,
        TARGETS: closest(poses, target),
        TARGETS + CUT_OFF: closest_cut_off(poses, target),
        NO_FLOW + NEIGHBOURS: point_map(a, b, functional_map(poses.start, k)),
        ZOOM_OUT: point_map(a, b, zoomed),
    }


def by_flow(start: PointMap, k: int, name: str, found: Match) -> dict[str, PointMap]:
    """Read the maps off a match that began at a start, by flow lines and by nearest neighbours."""
    a, b = start.codomain, start.domain
    basis = start.pull_back(unit_eigenbasis(a, k)[1])
    C = spectral_coefficients(b, found.push(basis, found.parameters.tau), k)
    lines = followed(start, found.velocity, found.parameters.tau)
    return {name + LINES: lines, name + NEIGHBOURS: point_map(a, b, C)}


def closest(poses: Poses, functions: FloatArray) -> PointMap:
    """Read three functions (V, 3) on B as coordinates of A: the closest points of A."""
    a = poses.a
    origin = a.vertices[0] - coordinates(a)[0] * a.length_scale
    return PointMap.project(poses.b, a, functions * a.length_scale + origin)


def closest_cut_off(poses: Poses, functions: FloatArray) -> PointMap:
    """Read three functions (V, 3) on B as A's coordinates, cut off as the targets are."""
    a = poses.a
    found = project_onto_surface(TriangleMesh(cut_off(a, len(poses.wanted)), a.faces), functions)
    distances = found.distances_from(functions) * a.length_scale
    return PointMap(poses.b, a, found.faces, found.barycentric, distances)


def cut_off(mesh: TriangleMesh, k: int) -> FloatArray:
    """Return the `coordinates` in the first k eigenfunctions, (V, 3)."""
    basis = unit_eigenbasis(mesh, k)[1]
    return np.asarray(basis @ spectral_coefficients(mesh, coordinates(mesh), k))


def followed(start: PointMap, velocity: FloatArray, tau: float) -> PointMap:
    """Compose a map with flow lines of fields (N, F, 3), followed back exactly."""
    a, b = start.codomain, start.domain
    lines = flow_lines(b, -velocity[::-1], maps.vertex_points(b), tau, tau)
    faces, places = (
        [getattr(line, name)[-1] for line in lines] for name in ("faces", "barycentric")
    )
    origins = SurfacePoints(b, np.array(faces), np.array(places))
    return PointMap.project(b, a, origins.pull_back(start.positions))
