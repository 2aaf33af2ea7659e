"""Figures 11 to 13: coordinates of pose A go to B by a point map of few eigenfunctions; targets are
those of the true map, cut off at more. ``docs/figures/figure-13.md`` says how maps are read off.
"""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from abfm import Match, MeshError, PointMap, Problem, TriangleMesh, advect, maps
from abfm.baselines.reduced_basis import ReducedEnergy, ReducedMatch, reduced_match
from abfm.calculus import l2_norm, unit_eigenbasis, vertex_areas
from abfm.experiments import vocabulary as words
from abfm.experiments.vocabulary import Example, Findings, Measure, Script, Sought, Stage
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
CUT_FUNCTIONS = "3 functions, both cut off"
ZOOMED_FUNCTIONS = "ZoomOut, then 3 functions, both cut off"
CUT_SUFFIX = ", cut off alike"
BY_LINES = ", flow lines"
BY_NEIGHBOURS = ", nearest neighbours"
START = "start"
NO_FLOW = "no flow"
ZOOM_OUT = "no flow: ZoomOut of the start"
TARGETS = "no flow: nearest surface points of the target coordinates"

_START_MODES = 10  # eigenfunctions of the start map
_MODES = 100
_MODES_SMALL = 30
_FEWEST_VERTICES = 60
_BEND = np.pi / 3
_CHECKS = 16  # fields of the checkerboard, along the longest axis
# share of the first mismatch that may be left where functions count as matched
_MISMATCH_SHARE_MAX = 0.1
_STEP = 10  # of ZoomOut
# of the reduced basis
_FIELDS = 50
_SIGMA = 0.1
_MAPS = (START, TARGETS, ONE_FUNCTION, FUNCTIONS, BASIS)  # in the pictures
_CUT_MAPS = (CUT_FUNCTIONS, CUT_FUNCTIONS + BY_NEIGHBOURS, ZOOMED_FUNCTIONS + BY_NEIGHBOURS)
_REFERENCES = (START, TARGETS, FUNCTIONS + BY_LINES, BASIS + BY_NEIGHBOURS, ZOOM_OUT)
_PAIRS = (  # a map with a flow, and what the same data give without one, read off alike
    (FUNCTIONS, TARGETS),
    (FUNCTIONS + CUT_SUFFIX, TARGETS + CUT_SUFFIX),
    (CUT_FUNCTIONS, TARGETS + CUT_SUFFIX),
    *(
        (name + BY_NEIGHBOURS, NO_FLOW + BY_NEIGHBOURS)
        for name in (ONE_FUNCTION, FUNCTIONS, CUT_FUNCTIONS, BASIS)
    ),
    (ZOOMED_FUNCTIONS + BY_NEIGHBOURS, ZOOM_OUT),
)
# vertices whose errors are measured
_ALL_VERTICES_MAX = 1500
_MEASURED_VERTICES = 500
_SEED = {CUT_FUNCTIONS: START, ZOOMED_FUNCTIONS: ZOOM_OUT}  # matches that begin at maps
_BOUND = 0.05
_ERRORS = np.linspace(0, 0.15, 301)


def figure_11(stage: Stage) -> Script:
    """Match two coordinates of pose A on pose B at once, and see what is left at every vertex."""
    poses = Poses.of(stage)
    axes = sorted(by_extent(poses.a)[:2].tolist())
    example = poses.example(TABLE_1[11], axes, stage.small)
    yield example

    a, b, problem = poses.a, poses.b, example.problem
    [found] = yield [Sought(problem, "matching two functions")]
    of_maps, notes = words.map_findings(words.maps_of_flow(found, "the flow on B"))
    weights = vertex_areas(b.normalized())
    before, after = (
        np.abs(problem.target - f).sum(axis=1) for f in (problem.source, found.advected)
    )
    left = share_left(float(weights @ after), float(weights @ before))
    of_sum, claim = "share of the pointwise sum of errors that is left", "the matching succeeds"
    measures = (
        Measure("mean pointwise sum of absolute errors before, sqrt(area)", weights @ before),
        Measure("mean pointwise sum of absolute errors after, sqrt(area)", weights @ after),
        Measure(of_sum, left, claim, left <= _MISMATCH_SHARE_MAX),
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
        Panel(b, Values(after, "sum of errors, √area"), "what is left"),
    )
    sheet = Sheet((panels,), seen=(before,), one_view=True, notes=notes)
    return Findings(measures, sheet, poses.setting(problem, axes))


def figure_12(stage: Stage) -> Script:
    """Match the three coordinates of pose A on pose B, and show two as texture coordinates."""
    poses = Poses.of(stage)
    example = poses.example(TABLE_1[12], [0, 1, 2], stage.small)
    yield example

    a, b, problem = poses.a, poses.b, example.problem
    found = yield from compare(poses, problem, stage)
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
    of_maps, notes = words.map_findings({name: found.qualities[name] for name in _MAPS})
    measures = (
        Measure("1 function: mismatch", found.one.mismatch),
        Measure(f"1 function: {of_start}", one, claim, one <= _MISMATCH_SHARE_MAX),
        Measure("3 functions: mismatch", found.three.mismatch),
        Measure(f"3 functions: {of_start}", three, claim, three <= _MISMATCH_SHARE_MAX),
        Measure(f"reduced basis: {of_start}", left(found.reduced_functions, slice(3))),
        Measure("reduced basis: share of the functional map's mismatch left", of_map),
        *of_maps,
    )

    def checker(functions: FloatArray) -> Checker:
        return poses.checker(functions[:, [longest, second]])

    panels = (
        Panel(a, checker(coordinates(a)), "coordinates"),
        Panel(b, checker(source), "start", "source"),
        Panel(b, checker(target), "target", "target"),
        Panel(b, checker(found.one_carries), "1 function", "field"),
        Panel(b, checker(found.three.advected), "3 functions", "result"),
        Panel(b, checker(found.reduced_functions), "reduced basis"),
    )
    wrong = np.abs(source - target).sum(axis=1)
    sheet = Sheet((panels,), seen=(wrong,), one_view=True, notes=notes)
    return Findings(measures, sheet, f"{poses.setting(problem, [0, 1, 2])}. {found.setting}")


def figure_13(stage: Stage) -> Script:
    """Measure the maps of figure 12, and plot the share of vertices under an error."""
    poses = Poses.of(stage)
    example = poses.example(TABLE_1[12], [0, 1, 2], stage.small)
    yield example

    found = yield from compare(poses, example.problem, stage)
    most = _ALL_VERTICES_MAX if len(poses.b.vertices) <= _ALL_VERTICES_MAX else _MEASURED_VERTICES
    accuracies = {}
    for number, (name, points) in enumerate(found.maps.items()):
        stage.report("measuring the maps", 0.85 + 0.15 * number / len(found.maps))
        accuracies[name] = maps.map_accuracy(points, most=most)
    shares = {name: each.share_under(_ERRORS) for name, each in accuracies.items()}

    def less(ours: str, theirs: str) -> float:
        return accuracies[ours].mean - accuracies[theirs].mean

    measures = []
    for reading in ("", BY_NEIGHBOURS):
        theirs = BASIS + reading
        for name in (ONE_FUNCTION, FUNCTIONS):
            ours, better = name + reading, f"{name}: a better reconstruction than [COC15]"
            apart, behind = less(ours, theirs), (shares[theirs] - shares[ours]).max()
            most_behind = 100 * max(float(behind), 0.0)
            of_mean = f"{ours}: mean error less that of the reduced basis{reading}, sqrt(area)"
            of_curve = f"{ours}: most that its curve is below the reduced basis'{reading}, %"
            measures.append(Measure(of_mean, apart, better, apart < 0))
            measures.append(Measure(of_curve, most_behind, better, most_behind == 0))
    for ours in (FUNCTIONS, FUNCTIONS + BY_LINES, FUNCTIONS + BY_NEIGHBOURS):
        text, apart = f"{ours}: mean error less the start's, sqrt(area)", less(ours, START)
        measures.append(Measure(text, apart, "the map is improved", apart < 0))
    adds = "what the flow adds: mean error of"
    measures += [
        Measure(f"{adds} '{ours}' less that of '{without}', sqrt(area)", less(ours, without))
        for ours, without in _PAIRS
    ]
    for name, accuracy in accuracies.items():
        share = 100 * float(accuracy.share_under(_BOUND))
        measures += [
            Measure(f"{name}: mean error, sqrt(area)", accuracy.mean),
            Measure(f"{name}: largest error, sqrt(area)", accuracy.maximum),
            Measure(f"{name}: vertices with an error under {_BOUND:g} sqrt(area), %", share),
        ]
    of_maps, notes = words.map_findings(
        {name: found.qualities[name] for name in (*_MAPS, *_CUT_MAPS)}
    )
    shown = (FUNCTIONS, ONE_FUNCTION, BASIS, CUT_FUNCTIONS + BY_NEIGHBOURS, *_REFERENCES)
    plotted = tuple(Curve(name, _ERRORS, 100 * shares[name], name in _REFERENCES) for name in shown)
    plot = Plot(plotted, "geodesic error, √area", "vertices, %", "errors of the maps", width=3)
    setting = (
        f"{poses.setting(example.problem, [0, 1, 2])}. {found.setting}. Errors at "
        f"{len(accuracies[FUNCTIONS].errors):,} vertices"
    )
    return Findings((*measures, *of_maps), Sheet(((plot,),), notes=notes), setting)


@dataclass(frozen=True, eq=False)
class Poses:
    """Two poses, vertex by vertex; where on A the start takes B's; the true map cut off (k, k)."""

    a: TriangleMesh
    b: TriangleMesh
    name: str
    words: str
    start: PointMap
    wanted: FloatArray

    @classmethod
    def of(cls, stage: Stage) -> "Poses":
        """Return the bundled humans, or a mesh and itself, bent."""
        if stage.mesh is None:
            a, b, name = words.bundled("human_A.off"), words.bundled("human_B.off"), "human_B.off"
            told = "human_B.off against human_A.off, the same vertices in another pose"
        elif len(stage.mesh.vertices) < _FEWEST_VERTICES:
            raise MeshError(
                f"the mesh has {len(stage.mesh.vertices)} vertices; for {_MODES} eigenfunctions, "
                "or "
                f"a third of the number of vertices, give one with at least {_FEWEST_VERTICES}"
            )
        else:
            a, b, name = stage.mesh, bent(stage.mesh), "bent mesh"
            bend = f"{np.degrees(_BEND):.0f}°"
            told = f"the mesh bent by {bend} against itself, as no second pose is known"
        truth = PointMap.of_vertices(b, a)
        start = point_map(a, b, functional_map(truth, _START_MODES))
        many = min(_MODES_SMALL if stage.small else _MODES, len(b.vertices) // 3)
        return cls(a, b, name, told, start, functional_map(truth, many))

    def example(self, row: TableRow, axes: list[int], small: bool) -> Example:
        """Return the match of some of A's coordinates."""
        places = coordinates(self.a)
        source = self.start.pull_back(places)[:, axes]
        target = transfer(self.a, self.b, self.wanted, places)[:, axes]
        iterations = 20 if small else words.affordable_iterations(self.b, 500)
        problem = Problem(self.b, source, target, row.parameters(iterations=iterations))
        specs = tuple((f"file:start_{'xyz'[x]}.npy", f"file:target_{'xyz'[x]}.npy") for x in axes)
        return Example(problem, self.name, specs)

    def setting(self, problem: Problem, axes: list[int]) -> str:
        """Say what is matched."""
        k = len(self.wanted)
        return (
            f"{words.sized(self.words, self.b)}. Functions: coordinates "
            f"{', '.join('xyz'[x] for x in axes)} of A in units of sqrt(area); start: by the "
            f"nearest neighbour in the spectral embedding, {_START_MODES} eigenfunctions; "
            "targets: by the "
            f"true functional map, {k} x {k}. Parameters of Table 1, "
            f"{problem.parameters.solver.iterations} iterations"
        )

    def checker(self, functions: FloatArray) -> Checker:
        """Return two coordinate functions (V, 2) as a checkerboard, on either pose."""
        extent = np.ptp(coordinates(self.a), axis=0).max()
        return Checker(functions * (0.5 * _CHECKS / extent))


@per_mesh
def coordinates(mesh: TriangleMesh) -> FloatArray:
    """Return coordinates from the centroid, in units of sqrt(area), (V, 3)."""
    places = mesh.normalized().vertices
    return np.asarray(places - vertex_areas(mesh.normalized()) @ places)


def share_left(after: float, before: float) -> float:
    """Return what of a mismatch is left; all of it where there was none."""
    return after / before if before > 0 else 1.0


def by_extent(mesh: TriangleMesh) -> IntArray:
    """Return the axes by extent, the longest first, (3,)."""
    return np.argsort(-np.ptp(mesh.vertices, axis=0), kind="stable")


@per_mesh
def bent(mesh: TriangleMesh) -> TriangleMesh:
    """Bend a mesh into an arc along its longest axis: almost an isometry where it is thin."""
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
    """Matches, all three coordinates as two of them transfer them, and the maps read off."""

    one: Match
    three: Match
    one_carries: FloatArray
    reduced: ReducedMatch
    reduced_functions: FloatArray
    maps: dict[str, PointMap]
    qualities: dict[str, MapQuality]
    setting: str


def compare(
    poses: Poses, problem: Problem, stage: Stage
) -> Generator[Sequence[Sought], Sequence[Match], Comparison]:
    """Match by all methods, as a part of a script; kept with the mesh for the other figure."""
    b, key = poses.b, (__name__, problem.parameters, poses.wanted.shape)
    if key in b.cache:
        yield ()
    else:
        without = without_flow(poses, problem.target)
        matches = yield sought_on(poses, problem, without)
        if key not in b.cache:  # by the other figure meanwhile
            b.cache[key] = compared(poses, problem, stage, without, matches)
    kept: Comparison = b.cache[key]
    return kept


def sought_on(poses: Poses, problem: Problem, without: Mapping[str, PointMap]) -> list[Sought]:
    """Return the matches that are compared: one function, all, and all cut off by each of `_SEED`.

    There sources are cut off as the targets are, so that a true start has nothing to correct.
    """
    b, p, target, longest = poses.b, problem.parameters, problem.target, by_extent(poses.a)[:1]
    alone = Problem(b, problem.source[:, longest], target[:, longest], p)
    cut = cut_off(poses.a, len(poses.wanted))
    by_both, again = (
        Problem(b, without[start].pull_back(cut), target, p) for start in _SEED.values()
    )
    return [
        Sought(alone, "matching one function", 0.2),
        Sought(problem, "matching three functions", 0.2),
        Sought(by_both, "matching three functions, cut off", 0.2),
        Sought(again, "refining a good map", 0.2),
    ]


def compared(
    poses: Poses,
    problem: Problem,
    stage: Stage,
    without: Mapping[str, PointMap],
    matches: Sequence[Match],
) -> Comparison:
    """Read the maps off the matches that were `sought_on`, and match in the reduced basis."""
    a, b, p, k, source = poses.a, poses.b, problem.parameters, len(poses.wanted), problem.source
    one, three, *others = matches
    read = dict(without)
    for (name, start), found in zip(_SEED.items(), others, strict=True):
        read[name] = closest_cut_off(poses, found.advected)
        read |= by_flow(without[start], k, name, found)
    stage.report("matching in a reduced basis", 0.8)
    count, begin = min(_FIELDS, k // 2), functional_map(poses.start, k)
    reduced = reduced_match(ReducedEnergy(b, begin, poses.wanted, replace(p, sigma=_SIGMA), count))
    one_carries = one.push(source, p.tau)
    reduced_functions = advect(b, reduced.velocity, source, p.tau)
    read |= {
        FUNCTIONS: closest(poses, three.advected),
        FUNCTIONS + CUT_SUFFIX: closest_cut_off(poses, three.advected),
        ONE_FUNCTION: closest(poses, one_carries),
        BASIS: closest(poses, reduced_functions),
        **by_flow(poses.start, k, FUNCTIONS, three),
        **by_flow(poses.start, k, ONE_FUNCTION, one),
        BASIS + BY_LINES: followed(poses.start, reduced.velocity[None], p.tau),
        BASIS + BY_NEIGHBOURS: point_map(a, b, reduced.functional_map),
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
    zoomed = maps.zoom_out(a, b, functional_map(poses.start, _START_MODES), k, _STEP)
    return {
        START: poses.start,
        TARGETS: closest(poses, target),
        TARGETS + CUT_SUFFIX: closest_cut_off(poses, target),
        NO_FLOW + BY_NEIGHBOURS: point_map(a, b, functional_map(poses.start, k)),
        ZOOM_OUT: point_map(a, b, zoomed),
    }


def by_flow(start: PointMap, k: int, name: str, found: Match) -> dict[str, PointMap]:
    """Read the maps off a match that began at a start, by flow lines and by nearest neighbours."""
    a, b = start.codomain, start.domain
    basis = start.pull_back(unit_eigenbasis(a, k)[1])
    C = spectral_coefficients(b, found.push(basis, found.parameters.tau), k)
    lines = followed(start, found.fine_velocity, found.parameters.tau)
    return {name + BY_LINES: lines, name + BY_NEIGHBOURS: point_map(a, b, C)}


def closest(poses: Poses, functions: FloatArray) -> PointMap:
    """Read three functions (V, 3) on B as coordinates of A: the closest points of A."""
    a = poses.a
    origin = a.vertices[0] - coordinates(a)[0] * a.length_scale
    return PointMap.project(poses.b, a, functions * a.length_scale + origin)


def closest_cut_off(poses: Poses, functions: FloatArray) -> PointMap:
    """Read three functions (V, 3) on B as A's coordinates, cut off as the targets are."""
    a = poses.a
    found = maps.project_onto_surface(
        TriangleMesh(cut_off(a, len(poses.wanted)), a.faces), functions
    )
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
    faces, places = zip(*((line.faces[-1], line.barycentric[-1]) for line in lines), strict=True)
    origins = SurfacePoints(b, np.array(faces), np.array(places))
    return PointMap.project(b, a, origins.pull_back(start.positions))
