"""Figures 11 to 13: matches of coordinates that improve a map between two poses of a body.

The initial map is a point map from pose B to pose A, recovered from few eigenfunctions. The sources
are the coordinates of A, transferred to B by the initial map. The targets are the same coordinates,
transferred by the true functional map in more eigenfunctions.
``docs/figures/figure-13.md`` describes how maps are recovered from functions.
"""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from abfm import Match, MeshError, PointMap, Problem, TriangleMesh, advect, maps
from abfm.baselines.reduced_basis import ReducedEnergy, ReducedMatch, reduced_match
from abfm.calculus import l2_norm, unit_eigenbasis, vertex_areas
from abfm.experiments import scripts
from abfm.experiments.scripts import Example, FigureSetup, Findings, Measure, RequestedMatch, Script
from abfm.flow import flow_lines
from abfm.io.sheets import Checker, Curve, Panel, Plot, Sheet, Values
from abfm.maps import MapQuality, SurfacePoints, functional_map, point_map
from abfm.maps.functional_maps import spectral_coefficients, transfer
from abfm.mesh import per_mesh
from abfm.parameters import TABLE_1, TableRow
from abfm.types import FloatArray, IntArray

ONE_FUNCTION = "1 function"
FUNCTIONS = "3 functions"
BASIS = "reduced basis"
TRUNCATED_FUNCTIONS = "3 functions, both truncated"
ZOOMED_FUNCTIONS = "ZoomOut, then 3 functions, both truncated"
TRUNCATED_SUFFIX = ", truncated alike"
BY_LINES = ", flow lines"
BY_NEIGHBOURS = ", nearest neighbours"
START = "initial map"
NO_FLOW = "no flow"
ZOOM_OUT = "no flow: ZoomOut of the initial map"
TARGETS = "no flow: nearest surface points of the target coordinates"

_START_MODES = 10  # number of eigenfunctions of the initial map
_MODES = 100
_MODES_SMALL = 30
_VERTICES_MIN = 60
_BEND = np.pi / 3  # angle in radians
_CHECKER_FIELDS = 16  # squares of the checkerboard along the longest axis
_MISMATCH_RATIO_MAX = 0.1  # largest ratio of final to initial mismatch of a success
_ZOOM_OUT_STEP = 10  # eigenfunctions that ZoomOut adds in each step
# parameters of the reduced basis
_FIELDS = 50
_SIGMA = 0.1
_MAPS = (START, TARGETS, ONE_FUNCTION, FUNCTIONS, BASIS)  # maps shown in the pictures
_TRUNCATED_MAPS = (
    TRUNCATED_FUNCTIONS,
    TRUNCATED_FUNCTIONS + BY_NEIGHBOURS,
    ZOOMED_FUNCTIONS + BY_NEIGHBOURS,
)
_REFERENCES = (START, TARGETS, FUNCTIONS + BY_LINES, BASIS + BY_NEIGHBOURS, ZOOM_OUT)
_PAIRS = (  # pairs of maps that are recovered from the same data with and without a flow
    (FUNCTIONS, TARGETS),
    (FUNCTIONS + TRUNCATED_SUFFIX, TARGETS + TRUNCATED_SUFFIX),
    (TRUNCATED_FUNCTIONS, TARGETS + TRUNCATED_SUFFIX),
    *(
        (name + BY_NEIGHBOURS, NO_FLOW + BY_NEIGHBOURS)
        for name in (ONE_FUNCTION, FUNCTIONS, TRUNCATED_FUNCTIONS, BASIS)
    ),
    (ZOOMED_FUNCTIONS + BY_NEIGHBOURS, ZOOM_OUT),
)
# Map errors are measured at all vertices or, on meshes with more vertices than the first number, at
# the second number of them.
_ALL_VERTICES_MAX = 1500
_MEASURED_VERTICES = 500
# initial maps of the matches with truncated functions, by the name of the match
_INITIAL_MAPS = {TRUNCATED_FUNCTIONS: START, ZOOMED_FUNCTIONS: ZOOM_OUT}
_ERROR_BOUND = 0.05
_ERROR_LEVELS = np.linspace(0, 0.15, 301)


def figure_11(setup: FigureSetup) -> Script:
    """Match two coordinates of pose A on pose B, and measure the sum of errors at each vertex."""
    poses = Poses.of(setup)
    axes = sorted(by_extent(poses.a)[:2].tolist())
    example = poses.example(TABLE_1[11], axes, setup.small)
    yield example

    a, b, problem = poses.a, poses.b, example.problem
    [found] = yield [RequestedMatch(problem, "matching two functions")]
    of_maps, notes = scripts.quality_measures(scripts.flow_map_measures(found, "the flow on B"))
    weights = vertex_areas(b.normalized())
    before, after = (
        np.abs(problem.target - f).sum(axis=1) for f in (problem.source, found.advected)
    )
    remaining = remaining_ratio(float(weights @ after), float(weights @ before))
    of_sum = "ratio of the pointwise sums of errors after and before"
    claim = "the matching succeeds"
    measures = (
        Measure("mean pointwise sum of absolute errors before, sqrt(area)", weights @ before),
        Measure("mean pointwise sum of absolute errors after, sqrt(area)", weights @ after),
        Measure(of_sum, remaining, claim, remaining <= _MISMATCH_RATIO_MAX),
        Measure("largest pointwise sum of errors before, sqrt(area)", before.max()),
        Measure("largest pointwise sum of errors after, sqrt(area)", after.max()),
        Measure("mismatch", found.mismatch),
        *of_maps,
    )
    panels = (
        Panel(a, poses.checker(coordinates(a)[:, axes]), "coordinates"),
        Panel(b, poses.checker(problem.source), "by a point map", "source"),
        Panel(b, poses.checker(problem.target), "by a functional map", "target"),
        Panel(b, poses.checker(found.advected), "matched", "result"),
        Panel(b, Values(after, "sum of errors, √area"), "errors after matching"),
    )
    sheet = Sheet((panels,), view_functions=(before,), one_view=True, notes=notes)
    return Findings(measures, sheet, poses.setting(problem, axes))


def figure_12(setup: FigureSetup) -> Script:
    """Match the three coordinates of pose A on pose B, and show two of them as a checkerboard."""
    poses = Poses.of(setup)
    example = poses.example(TABLE_1[12], [0, 1, 2], setup.small)
    yield example

    a, b, problem = poses.a, poses.b, example.problem
    found = yield from compare(poses, problem, setup)
    source, target = problem.source, problem.target
    longest, second, _ = by_extent(a).tolist()

    def remaining(after: FloatArray, channels: slice) -> float:
        true_map = target[:, channels]
        before = l2_norm(b, source[:, channels] - true_map)
        return remaining_ratio(l2_norm(b, after - true_map), before)

    one = remaining(found.one.advected, slice(longest, longest + 1))
    three = remaining(found.three.advected, slice(3))
    of_map = remaining_ratio(found.reduced.mismatch, found.reduced.start_mismatch)
    claim = "the target functions are matched"
    of_start = "mismatch relative to that of the initial map"
    of_maps, notes = scripts.quality_measures({name: found.qualities[name] for name in _MAPS})
    measures = (
        Measure("1 function: mismatch", found.one.mismatch),
        Measure(f"1 function: {of_start}", one, claim, one <= _MISMATCH_RATIO_MAX),
        Measure("3 functions: mismatch", found.three.mismatch),
        Measure(f"3 functions: {of_start}", three, claim, three <= _MISMATCH_RATIO_MAX),
        Measure(f"reduced basis: {of_start}", remaining(found.reduced_functions, slice(3))),
        Measure(
            "reduced basis: mismatch of the functional map relative to that of the initial map",
            of_map,
        ),
        *of_maps,
    )

    def checker(functions: FloatArray) -> Checker:
        return poses.checker(functions[:, [longest, second]])

    panels = (
        Panel(a, checker(coordinates(a)), "coordinates"),
        Panel(b, checker(source), "start", "source"),
        Panel(b, checker(target), "target", "target"),
        Panel(b, checker(found.by_one_flow), "1 function", "field"),
        Panel(b, checker(found.three.advected), "3 functions", "result"),
        Panel(b, checker(found.reduced_functions), "reduced basis"),
    )
    wrong = np.abs(source - target).sum(axis=1)
    sheet = Sheet((panels,), view_functions=(wrong,), one_view=True, notes=notes)
    return Findings(measures, sheet, f"{poses.setting(problem, [0, 1, 2])}. {found.setting}")


def figure_13(setup: FigureSetup) -> Script:
    """Measure the maps of figure 12; plot the share of vertices with errors below each level."""
    poses = Poses.of(setup)
    example = poses.example(TABLE_1[12], [0, 1, 2], setup.small)
    yield example

    found = yield from compare(poses, example.problem, setup)
    vertices_max = (
        _ALL_VERTICES_MAX if len(poses.b.vertices) <= _ALL_VERTICES_MAX else _MEASURED_VERTICES
    )
    accuracies = {}
    for number, (name, points) in enumerate(found.maps.items()):
        setup.report("measuring the maps", 0.85 + 0.15 * number / len(found.maps))
        accuracies[name] = maps.map_accuracy(points, count_max=vertices_max)
    shares = {name: each.share_under(_ERROR_LEVELS) for name, each in accuracies.items()}

    def mean_difference(ours: str, theirs: str) -> float:
        return accuracies[ours].mean - accuracies[theirs].mean

    measures = []
    for reading in ("", BY_NEIGHBOURS):
        theirs = BASIS + reading
        for name in (ONE_FUNCTION, FUNCTIONS):
            ours, better = name + reading, f"{name}: a better reconstruction than [COC15]"
            difference = mean_difference(ours, theirs)
            deficit_max = 100 * max(float((shares[theirs] - shares[ours]).max()), 0.0)
            of_mean = f"{ours}: mean error minus that of the reduced basis{reading}, sqrt(area)"
            of_curve = f"{ours}: largest gap below the curve of the reduced basis{reading}, %"
            measures.append(Measure(of_mean, difference, better, difference < 0))
            measures.append(Measure(of_curve, deficit_max, better, deficit_max == 0))
    for ours in (FUNCTIONS, FUNCTIONS + BY_LINES, FUNCTIONS + BY_NEIGHBOURS):
        text = f"{ours}: mean error minus that of the initial map, sqrt(area)"
        difference = mean_difference(ours, START)
        measures.append(Measure(text, difference, "the map is improved", difference < 0))
    flow_effect = "effect of the flow: mean error of"
    measures += [
        Measure(
            f"{flow_effect} '{ours}' minus that of '{maps_without}', sqrt(area)",
            mean_difference(ours, maps_without),
        )
        for ours, maps_without in _PAIRS
    ]
    for name, accuracy in accuracies.items():
        share = 100 * float(accuracy.share_under(_ERROR_BOUND))
        measures += [
            Measure(f"{name}: mean error, sqrt(area)", accuracy.mean),
            Measure(f"{name}: largest error, sqrt(area)", accuracy.maximum),
            Measure(f"{name}: vertices with an error under {_ERROR_BOUND:g} sqrt(area), %", share),
        ]
    of_maps, notes = scripts.quality_measures(
        {name: found.qualities[name] for name in (*_MAPS, *_TRUNCATED_MAPS)}
    )
    shown = (FUNCTIONS, ONE_FUNCTION, BASIS, TRUNCATED_FUNCTIONS + BY_NEIGHBOURS, *_REFERENCES)
    plotted = tuple(
        Curve(name, _ERROR_LEVELS, 100 * shares[name], name in _REFERENCES) for name in shown
    )
    plot = Plot(plotted, "geodesic error, √area", "vertices, %", "errors of the maps", width=3)
    setting = (
        f"{poses.setting(example.problem, [0, 1, 2])}. {found.setting}. Errors at "
        f"{len(accuracies[FUNCTIONS].errors):,} vertices"
    )
    return Findings((*measures, *of_maps), Sheet(((plot,),), notes=notes), setting)


@dataclass(frozen=True, eq=False)
class Poses:
    """Two poses A and B of a body with the same vertices, and maps between them.

    ``start`` is the initial map from the vertices of B to A. ``true_map`` (k, k) is the true
    functional map from A to B in k eigenfunctions.
    """

    a: TriangleMesh
    b: TriangleMesh
    name: str
    description: str
    start: PointMap
    true_map: FloatArray

    @classmethod
    def of(cls, setup: FigureSetup) -> "Poses":
        """Return the two bundled humans, or the mesh of the options and a bent copy of it."""
        if setup.mesh is None:
            a, b = (scripts.bundled(f"human_{pose}.off") for pose in "AB")
            name = "human_B.off"
            description = "human_B.off and human_A.off, the same vertices in two poses"
        elif len(setup.mesh.vertices) < _VERTICES_MIN:
            raise MeshError(
                f"the mesh has {len(setup.mesh.vertices)} vertices, which is too coarse for "
                f"eigenfunctions; use a mesh of at least {_VERTICES_MIN} vertices"
            )
        else:
            a, b, name = setup.mesh, bend_mesh(setup.mesh), "bent mesh"
            bend = f"{np.degrees(_BEND):.0f}°"
            description = f"the mesh bent by {bend} and the mesh itself, as no second pose is known"
        truth = PointMap.of_vertices(b, a)
        start = point_map(a, b, functional_map(truth, _START_MODES))
        modes = min(_MODES_SMALL if setup.small else _MODES, len(b.vertices) // 3)
        return cls(a, b, name, description, start, functional_map(truth, modes))

    def example(self, row: TableRow, axes: list[int], small: bool) -> Example:
        """Return the match, on B, of the coordinates of A with the indices ``axes``."""
        places = coordinates(self.a)
        source = self.start.pull_back(places)[:, axes]
        target = transfer(self.a, self.b, self.true_map, places)[:, axes]
        iterations = 20 if small else scripts.affordable_iterations(self.b, 500)
        problem = Problem(self.b, source, target, row.parameters(iterations=iterations))
        specs = tuple((f"file:start_{'xyz'[x]}.npy", f"file:target_{'xyz'[x]}.npy") for x in axes)
        return Example(problem, self.name, specs)

    def setting(self, problem: Problem, axes: list[int]) -> str:
        k = len(self.true_map)
        return (
            f"{scripts.size_text(self.description, self.b)}. Functions: coordinates "
            f"{', '.join('xyz'[x] for x in axes)} of A in units of sqrt(area). Initial map: "
            f"nearest neighbours in the spectral embedding, {_START_MODES} eigenfunctions. "
            f"Targets: true functional map, {k} x {k}. Parameters of Table 1, "
            f"{problem.parameters.solver.iterations} iterations"
        )

    def checker(self, functions: FloatArray) -> Checker:
        """Return a checkerboard of two coordinates (V, 2), with equal squares on both poses."""
        extent = np.ptp(coordinates(self.a), axis=0).max()
        return Checker(functions * (0.5 * _CHECKER_FIELDS / extent))


@per_mesh
def coordinates(mesh: TriangleMesh) -> FloatArray:
    """Return the coordinates of the vertices, centred and in units of sqrt(area), shape (V, 3)."""
    places = mesh.normalized().vertices
    return np.asarray(places - vertex_areas(mesh.normalized()) @ places)


def remaining_ratio(after: float, before: float) -> float:
    """Return the ratio of the mismatch after a match to that before it; 1 if ``before`` is 0."""
    return after / before if before > 0 else 1.0


def by_extent(mesh: TriangleMesh) -> IntArray:
    """Return the indices (3,) of the axes, sorted by the extent of the mesh, longest first."""
    return np.argsort(-np.ptp(mesh.vertices, axis=0), kind="stable")


@per_mesh
def bend_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """Bend a mesh into an arc along its longest axis; this is almost isometric for thin parts."""
    corner = mesh.vertices.min(axis=0)
    extent = mesh.vertices.max(axis=0) - corner
    along, _, deep = by_extent(mesh)
    middle = corner + extent / 2
    radius = extent[along] / _BEND
    angle = (mesh.vertices[:, along] - middle[along]) / radius
    height = radius - (mesh.vertices[:, deep] - middle[deep])
    moved = mesh.vertices.copy()
    moved[:, along] = middle[along] + height * np.sin(angle)
    moved[:, deep] = middle[deep] + radius - height * np.cos(angle)
    return TriangleMesh(moved, mesh.faces)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Matches by all methods, the coordinates advected by their flows, and the recovered maps."""

    one: Match
    three: Match
    by_one_flow: FloatArray
    reduced: ReducedMatch
    reduced_functions: FloatArray
    maps: dict[str, PointMap]
    qualities: dict[str, MapQuality]
    setting: str


def compare(
    poses: Poses, problem: Problem, setup: FigureSetup
) -> Generator[Sequence[RequestedMatch], Sequence[Match], Comparison]:
    """Match by all methods; a common part of the scripts of figures 12 and 13.

    The mesh of pose B caches the comparison, so that the other figure requests no matches.
    """
    b, key = poses.b, (__name__, problem.parameters, poses.true_map.shape)
    if key in b.cache:
        yield ()
    else:
        maps_without = maps_without_flow(poses, problem.target)
        matches = yield requests_on(poses, problem, maps_without)
        if key not in b.cache:  # the other figure may have stored it meanwhile
            b.cache[key] = comparison_of(poses, problem, setup, maps_without, matches)
    cached: Comparison = b.cache[key]
    return cached


def requests_on(
    poses: Poses, problem: Problem, maps_without: Mapping[str, PointMap]
) -> list[RequestedMatch]:
    """Return the matches to compare: one function, three functions, and truncated functions.

    In the last two, sources and targets are truncated to the same eigenfunctions. A correct initial
    map then needs no correction.
    """
    b, p, target, longest = poses.b, problem.parameters, problem.target, by_extent(poses.a)[:1]
    one_function = Problem(b, problem.source[:, longest], target[:, longest], p)
    truncated = truncated_coordinates(poses.a, len(poses.true_map))
    by_both, again = (
        Problem(b, maps_without[start].pull_back(truncated), target, p)
        for start in _INITIAL_MAPS.values()
    )
    return [
        RequestedMatch(one_function, "matching one function", 0.2),
        RequestedMatch(problem, "matching three functions", 0.2),
        RequestedMatch(by_both, "matching three truncated functions", 0.2),
        RequestedMatch(again, "refining a good map", 0.2),
    ]


def comparison_of(
    poses: Poses,
    problem: Problem,
    setup: FigureSetup,
    maps_without: Mapping[str, PointMap],
    matches: Sequence[Match],
) -> Comparison:
    """Match in the reduced basis; recover maps from this match and from those of `requests_on`.

    ``maps_without`` are the maps of `maps_without_flow`.
    """
    a, b, p, k, source = poses.a, poses.b, problem.parameters, len(poses.true_map), problem.source
    one, three, *others = matches
    read = dict(maps_without)
    for (name, start), found in zip(_INITIAL_MAPS.items(), others, strict=True):
        read[name] = closest_truncated(poses, found.advected)
        read |= by_flow(maps_without[start], k, name, found)
    setup.report("matching in a reduced basis", 0.8)
    count, begin = min(_FIELDS, k // 2), functional_map(poses.start, k)
    reduced = reduced_match(
        ReducedEnergy(b, begin, poses.true_map, replace(p, sigma=_SIGMA), count)
    )
    by_one_flow = one.push(source, p.tau)
    reduced_functions = advect(b, reduced.velocity, source, p.tau)
    read |= {
        FUNCTIONS: closest_points(poses, three.advected),
        FUNCTIONS + TRUNCATED_SUFFIX: closest_truncated(poses, three.advected),
        ONE_FUNCTION: closest_points(poses, by_one_flow),
        BASIS: closest_points(poses, reduced_functions),
        **by_flow(poses.start, k, FUNCTIONS, three),
        **by_flow(poses.start, k, ONE_FUNCTION, one),
        BASIS + BY_LINES: with_flow_lines(poses.start, reduced.velocity[None], p.tau),
        BASIS + BY_NEIGHBOURS: point_map(a, b, reduced.functional_map),
    }
    qualities = {name: maps.map_quality(points) for name, points in read.items()}
    setting = (
        f"Reduced basis: {k} eigenfunctions, {2 * count} fields, sigma {_SIGMA:g}. Maps are "
        "closest points of A to the advected coordinates, also with truncated coordinates of A. "
        "Other maps are the initial map composed with exact flow lines, and nearest neighbours by "
        "the flow's functional map"
    )
    return Comparison(one, three, by_one_flow, reduced, reduced_functions, read, qualities, setting)


def maps_without_flow(poses: Poses, target: FloatArray) -> dict[str, PointMap]:
    """Return, by name, the maps from B to A that are recovered without a flow.

    They use the initial map or the targets (V, 3), the coordinates of A on B.
    """
    a, b, k = poses.a, poses.b, len(poses.true_map)
    zoomed = maps.zoom_out(a, b, functional_map(poses.start, _START_MODES), k, _ZOOM_OUT_STEP)
    return {
        START: poses.start,
        TARGETS: closest_points(poses, target),
        TARGETS + TRUNCATED_SUFFIX: closest_truncated(poses, target),
        NO_FLOW + BY_NEIGHBOURS: point_map(a, b, functional_map(poses.start, k)),
        ZOOM_OUT: point_map(a, b, zoomed),
    }


def by_flow(start: PointMap, k: int, name: str, found: Match) -> dict[str, PointMap]:
    """Compose a map from B to A with the flow of a match on B, by two methods.

    The methods are flow lines, and nearest neighbours by the functional map of the flow in ``k``
    eigenfunctions. Return the maps by ``name`` and method.
    """
    a, b = start.codomain, start.domain
    basis = start.pull_back(unit_eigenbasis(a, k)[1])
    C = spectral_coefficients(b, found.push(basis, found.parameters.tau), k)
    lines = with_flow_lines(start, found.fine_velocity, found.parameters.tau)
    return {name + BY_LINES: lines, name + BY_NEIGHBOURS: point_map(a, b, C)}


def closest_points(poses: Poses, functions: FloatArray) -> PointMap:
    """Return the map from each vertex of B to the closest point of A.

    ``functions`` (V, 3) are the `coordinates` of A that the vertices should have.
    """
    a = poses.a
    origin = a.vertices[0] - coordinates(a)[0] * a.length_scale
    return PointMap.project(poses.b, a, functions * a.length_scale + origin)


def closest_truncated(poses: Poses, functions: FloatArray) -> PointMap:
    """Return the map of `closest_points` for `truncated_coordinates` (V, 3)."""
    a = poses.a
    found = maps.project_onto_surface(
        TriangleMesh(truncated_coordinates(a, len(poses.true_map)), a.faces), functions
    )
    distances = found.distances_from(functions) * a.length_scale
    return PointMap(poses.b, a, found.faces, found.barycentric, distances)


def truncated_coordinates(mesh: TriangleMesh, k: int) -> FloatArray:
    """Return the `coordinates`, shape (V, 3), projected to the first k eigenfunctions."""
    basis = unit_eigenbasis(mesh, k)[1]
    return np.asarray(basis @ spectral_coefficients(mesh, coordinates(mesh), k))


def with_flow_lines(start: PointMap, velocity: FloatArray, tau: float) -> PointMap:
    """Compose a map from B to A with exact flow lines on B, traced back from ``tau`` to 0."""
    a, b = start.codomain, start.domain
    lines = flow_lines(b, -velocity[::-1], maps.vertex_points(b), tau, tau)
    faces, places = zip(*((line.faces[-1], line.barycentric[-1]) for line in lines), strict=True)
    origins = SurfacePoints(b, np.array(faces), np.array(places))
    return PointMap.project(b, a, origins.pull_back(start.positions))
