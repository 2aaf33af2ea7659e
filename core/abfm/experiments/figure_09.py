"""Figure 9: one field whose flow is a symmetry, the rotation of a shape by 180 degrees."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from abfm import Match, MeshError, Parameters, Problem, TriangleMesh
from abfm.assets import asset_path
from abfm.calculus import averaging, face_normals
from abfm.calculus.geodesics import exact_distances
from abfm.experiments.vocabulary import (
    Example,
    Findings,
    Measure,
    Script,
    Stage,
    affordable_iterations,
    bundled,
    evaluated,
    sized,
)
from abfm.experiments.witnesses import map_measures, map_notes, maps_of_flow
from abfm.flow import flow_lines
from abfm.functions import read_vertex_map
from abfm.maps import (
    KINDS,
    MapQuality,
    SurfacePoints,
    Symmetry,
    SymmetryError,
    detect_symmetry,
    project_onto_surface,
)
from abfm.maps.symmetry import Kind
from abfm.mesh.shapes import two_armed
from abfm.paper import TABLE_1
from abfm.sheets import Coordinates, Panel, Sheet, Streaks, Values
from abfm.types import FloatArray, IntArray

CLAIM = (
    "One field's flow is the continuous symmetry map; at 2 τ some drift is noticeable, yet it is "
    "relatively small."
)
MEASURED = (1.0, 2.0)
"""Times, of tau, at which the map is measured."""

_SHOWN = (0.0, 0.5, 1.0, 2.0)  # of tau
_WIDTH = 0.2  # of the Gaussian
_SAMPLE = 150
_CORRECT, _SMALL_DRIFT = 0.02, 0.05  # of sqrt(area), for what the paper says in words


def figure(stage: Stage) -> Script:
    """Match all functions to themselves after a rotation, one of them alone, and all without
    cooling; then a human to its mirror image. A mesh that is given has its own symmetry.
    """
    mesh, name = stage.surface("two arms", two_armed, 3 if stage.small else 4)
    # cooled to the printed sigma: a turn to the left and one to the right fit equally well at
    # first, and without cooling some parts of the shape turn one way and some the other, for good
    iterations = 100 if stage.small else affordable_iterations(mesh, 250)
    p = TABLE_1[9].parameters(cooling_stages=3, iterations=iterations)
    symmetry = detected(mesh)
    example = symmetric_example(mesh, name, symmetry, p)
    yield example

    found = stage.match(example.problem, shares=(0.0, 0.3))
    marks = marked(mesh, symmetry)
    rows = [function_row(found), map_row(found, marks)]
    measures = measured(found, symmetry)
    maps = maps_of_flow(found, "the map", MEASURED)
    if symmetry.kind == "rotation":
        alone = symmetric_problem(mesh, [bump(mesh, marks[0])], symmetry, p)
        one = stage.match(alone, "one function", (0.35, 0.5))
        uncooled = replace(p, cooling_stages=1, iterations=min(p.iterations, 150))
        problem = symmetric_problem(mesh, places(mesh), symmetry, uncooled)
        hot = stage.match(problem, "without cooling", (0.5, 0.75))
        energies = [match.energy_history[-1, 0] for match in (hot, found)]
        measures += [
            Measure("mismatch with one Gaussian as the only function", one.mismatch),
            Measure("map error with one Gaussian only, mean", mean_error(one, symmetry)),
            Measure("energy without cooling over the energy here", energies[0] / energies[1]),
            Measure("map error without cooling, mean", mean_error(hot, symmetry)),
        ]
    if stage.mesh is None:
        row, more, its_maps = mirrored(stage, replace(p, iterations=15) if stage.small else p)
        rows.append(row)
        measures += more
        maps |= its_maps
    setting = (
        f"{setting_of(example, symmetry)} Printed parameters, but sigma is cooled to {p.sigma:g} "
        "in three stages."
    )
    sheet = Sheet(tuple(rows), seen=seen(mesh, marks), notes=map_notes(maps))
    return Findings((*measures, *map_measures(maps)), sheet, setting)


def mirrored(
    stage: Stage, p: Parameters
) -> tuple[tuple[Panel, ...], list[Measure], dict[str, MapQuality]]:
    """Match a function of the human and its mirror image; as a map the mirror is out of reach,
    whatever the functions.
    """
    mesh = bundled("human_A.off")
    symmetry = detect_symmetry(mesh, "mirror")
    problem = symmetric_example(mesh, "human_A.off", symmetry, p).problem
    found = stage.match(problem, "mirror", (0.75, 0.85))
    problem = symmetric_problem(mesh, places(mesh), symmetry, p)
    as_map = stage.match(problem, "mirror, as a map", (0.85, 1.0))
    other = read_vertex_map(mesh, str(asset_path("human.symperm.txt"))) != symmetry.vertex_map
    true = Coordinates(mesh.vertices[symmetry.vertex_map])
    row = (
        *function_row(found, "mirrored function")[:4],
        Panel(mesh, true, "the mirror as a map", "target"),
        Panel(mesh, Coordinates(as_map.advected), "matched: not reached", "result"),
    )
    of_coordinates = "mirror: map error with the three coordinates, mean"
    measures = [
        Measure("mirror: vertices where the detected map is not the file's", other.sum()),
        Measure("mirror: mismatch of the function", found.mismatch),
        Measure("mirror: map error, mean", mean_error(found, symmetry)),
        Measure("mirror: mismatch of the three coordinates", as_map.mismatch),
        Measure(of_coordinates, mean_error(as_map, symmetry)),
    ]
    return row, measures, maps_of_flow(as_map, "mirror, three coordinates, the map")


def detected(mesh: TriangleMesh) -> Symmetry:
    """Find the rotation by 180 degrees that a mesh has, or else its mirror plane.

    A rotation that turns the surface over, as one about an axis in a flat one, acts on it as a
    mirror: no flow reaches it, and mirrors go before it.

    Raises
    ------
    MeshError
        If it has neither.
    """
    errors: dict[Kind, float] = {}
    found = None
    for kind in reversed(KINDS):
        try:
            found = detect_symmetry(mesh, kind)
        except SymmetryError as error:
            errors[kind] = error.error
            continue
        normals = averaging(mesh) @ face_normals(mesh)
        aligned = (normals @ found.linear.T * normals[found.vertex_map]).sum()
        if kind == "mirror" or float(aligned) >= 0:
            return found
    if found is not None:
        return found
    raise MeshError(
        "the mesh has no symmetry: the best rotation by 180 degrees and the best mirror plane "
        f"carry a vertex {errors['rotation']:.3g} and {errors['mirror']:.3g} sqrt(area) away from "
        "the surface, and 0.02 is allowed"
    )


def symmetric_example(mesh: TriangleMesh, name: str, symmetry: Symmetry, p: Parameters) -> Example:
    """Return the places in space and these after a rotation; for a mirror, which no flow reaches
    as a map, a Gaussian where it moves a vertex farthest.
    """
    moved = np.linalg.norm(mesh.vertices[symmetry.vertex_map] - mesh.vertices, axis=1)
    rotated = symmetry.kind == "rotation"
    sources = places(mesh) if rotated else (bump(mesh, int(moved.argmax())),)
    specs = tuple((spec, f"permuted:{symmetry.kind}({spec})") for spec in sources)
    return Example(symmetric_problem(mesh, sources, symmetry, p), name, specs)


def symmetric_problem(
    mesh: TriangleMesh, specs: Sequence[str], symmetry: Symmetry, p: Parameters
) -> Problem:
    """Return functions and these after a symmetry."""
    source = evaluated(mesh, specs)
    return Problem(mesh, source, source[symmetry.vertex_map], p)


def marked(mesh: TriangleMesh, symmetry: Symmetry) -> IntArray:
    """Choose vertices to show, (3,): the one that is moved farthest among those that look along the
    axis of a rotation, where it goes, and the one of them that is as far as can be from both.
    """
    x, vertex_map = mesh.vertices, symmetry.vertex_map
    moved = np.linalg.norm(x[vertex_map] - x, axis=1)
    front = np.ones(len(x), dtype=bool)
    if symmetry.kind == "rotation":
        looks = averaging(mesh) @ (face_normals(mesh) @ symmetry.axis)
        front = looks > 0.9 * looks.max()
    mark = int(np.where(front, moved, -1).argmax())
    marks = [mark, int(vertex_map[mark])]
    apart = np.linalg.norm(x[:, None] - x[marks], axis=2).min(axis=1)
    return np.array([*marks, int(np.where(front, apart, -1).argmax())])


def bump(mesh: TriangleMesh, vertex: int) -> str:
    """Return the spec of a bump around a vertex."""
    return f"gaussian:vertex={mesh.vertex_ids[vertex]},width={_WIDTH:g}"


def places(mesh: TriangleMesh) -> tuple[str, ...]:
    """Return the three coordinates from the mesh's middle in sqrt(area), so that sigma weighs them
    alike on all meshes.
    """
    middles = mesh.vertices.mean(axis=0) / mesh.length_scale
    return tuple(
        f"expression:{axis}/{mesh.length_scale:.6g}-({round(middle, 6) + 0.0:g})"
        for axis, middle in zip("xyz", middles, strict=True)
    )


def seen(mesh: TriangleMesh, marks: IntArray) -> tuple[FloatArray, ...]:
    """Return functions that are large where the marks are, for the camera to show them."""
    return tuple(evaluated(mesh, [bump(mesh, mark) for mark in marks]).T)


def sample(mesh: TriangleMesh) -> IntArray:
    """Choose vertices on which maps are measured, evenly taken: exact geodesics cost much more than
    the map.
    """
    return np.linspace(0, len(mesh.vertices) - 1, min(_SAMPLE, len(mesh.vertices))).astype(np.int64)


def mean_error(match: Match, symmetry: Symmetry) -> float:
    """Return the mean distance of the point map at tau from the symmetry, along the surface, in
    sqrt(area).
    """
    rows = sample(match.mesh)
    points = match.point_map().points[rows]
    return float(geodesics(match.mesh, symmetry.vertex_map[rows], points).mean())


def measured(match: Match, symmetry: Symmetry) -> list[Measure]:
    """Measure mismatch, map error and drift, with the exact flow lines as a witness.

    Flow lines are walked against the flow: a vertex's value came from where its line ends.
    """
    mesh, tau, rows = match.mesh, match.parameters.tau, sample(match.mesh)
    [drift] = geodesics(mesh, rows, match.point_map(2 * tau).points[rows])
    starts = project_onto_surface(mesh, mesh.vertices[rows])
    lines = flow_lines(mesh, match.velocity, starts, -tau, tau)
    ends = project_onto_surface(mesh, np.array([line.positions[-1] for line in lines]))
    points = match.point_map().points[rows]
    error, by_lines = geodesics(mesh, symmetry.vertex_map[rows], points, ends)
    apart = np.linalg.norm(ends.positions - points.positions, axis=1) / mesh.length_scale
    reached, kept = error.mean(), drift.mean()
    correct = "the points and the coordinate functions are smoothly mapped to the correct values"
    small = "some drift is noticeable, yet it is relatively small"
    return [
        Measure("mismatch of the functions", match.mismatch),
        Measure("map error at τ, mean, geodesic / √area", reached, correct, reached < _CORRECT),
        Measure("map error at τ, 95th percentile", np.quantile(error, 0.95)),
        Measure("drift at 2 τ, mean, geodesic / √area", kept, small, kept < _SMALL_DRIFT),
        Measure("drift at 2 τ, 95th percentile", np.quantile(drift, 0.95)),
        Measure("map error at τ by exact flow lines, mean", by_lines.mean()),
        Measure("advected points from the ends of exact flow lines, mean", apart.mean()),
    ]


def geodesics(mesh: TriangleMesh, vertices: IntArray, *ends: SurfacePoints) -> FloatArray:
    """Measure the distance in sqrt(area) along the surface from each of P vertices to its own
    point, for K sets of points, (K, P).

    Exact on faces around the vertex and at vertices, elsewhere linear between the exact distances
    of a face's corners, which is never less than the distance.
    """
    distances = np.array([points.distances_from(mesh.vertices[vertices]) for points in ends])
    far = np.array([(mesh.faces[points.faces] != vertices[:, None]).all(axis=1) for points in ends])
    for i in np.flatnonzero(far.any(axis=0)):
        corners = np.concatenate([mesh.faces[points.faces[i]] for points in ends])
        exact = exact_distances(mesh, vertices[i], corners)
        weights = np.array([points.barycentric[i] for points in ends])
        between = (exact.reshape(-1, 3) * weights).sum(axis=1)
        distances[:, i] = np.where(far[:, i], between, distances[:, i])
    fractions: FloatArray = distances / mesh.length_scale
    return fractions


def function_row(match: Match, bar: str = "function") -> tuple[Panel, ...]:
    """Show source, target, result, and the field with its norm; of several functions the one that
    changes most.
    """
    mesh, velocity = match.mesh, match.velocity[0]
    channel = int(np.abs(match.target - match.source).max(axis=0).argmax())
    source, target, result = (f[:, channel] for f in (match.source, match.target, match.advected))
    speed = np.linalg.norm(velocity, axis=1) / mesh.length_scale
    return (
        Panel(mesh, Values(source, bar), "source", "source"),
        Panel(mesh, Values(target, bar), "its symmetric image", "target"),
        Panel(mesh, Values(result, bar), "matched", "result"),
        Panel(mesh, Streaks(velocity), "field", "result"),
        Panel(mesh, Values(averaging(mesh) @ speed, "|v|, √area"), "its norm", "result"),
    )


def map_row(match: Match, marks: IntArray) -> tuple[Panel, ...]:
    """Show places as colours, carried by the flow, and marked points that move with it."""
    mesh, tau = match.mesh, match.parameters.tau
    panels = []
    for share in _SHOWN:
        carried = match.push(mesh.vertices, share * tau)
        at = match.point_map(-share * tau).positions[marks]
        label = "t = 0" if not share else f"t = {'' if share == 1 else f'{share:g} '}τ"
        panels.append(Panel(mesh, Coordinates(carried), label, points=at))
    return tuple(panels)


def setting_of(example: Example, symmetry: Symmetry) -> str:
    """Say what is matched, in a sentence or two."""
    axis = ", ".join(f"{value:.2g}" for value in np.round(symmetry.axis, 3) + 0.0)
    if symmetry.kind == "rotation":
        words = f"rotation by 180 degrees about ({axis}); the three coordinates are matched at once"
    else:
        words = (
            f"mirror plane with normal ({axis}), no map that a flow can reach; one Gaussian is "
            "matched"
        )
    return f"{sized(example.problem.mesh, example.name)}, {words}."
