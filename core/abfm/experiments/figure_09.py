"""Figures 9 and 10: one field whose flow is a symmetry, the rotation of a shape by 180 degrees."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from abfm import Match, MeshError, Parameters, Problem, TriangleMesh, function, maps
from abfm.assets import asset_path
from abfm.calculus import averaging, face_normals
from abfm.calculus.geodesics import exact_distances
from abfm.display import ViewSpec
from abfm.experiments import scripts
from abfm.experiments.scripts import Example, FigureSetup, Findings, Measure, RequestedMatch, Script
from abfm.flow import flow_lines
from abfm.functions import read_vertex_map
from abfm.io.sheets import Coordinates, Panel, Sheet, Streaks, Values
from abfm.maps import Symmetry
from abfm.mesh.shapes import stepped_slab, two_armed
from abfm.parameters import TABLE_1
from abfm.types import FloatArray, IntArray

_MEASURED_TIMES = (1.0, 2.0)  # times of the maps whose folds are measured, relative to tau
_SHOWN_TIMES = {
    0.0: "t = 0",
    0.5: "t = 0.5 τ",
    1.0: "t = τ",
    2.0: "t = 2 τ",
}  # labels by time relative to tau
_GAUSSIAN_WIDTH = 0.2
_SAMPLE_VERTICES = 150
# limits of map error and drift, in sqrt(area), up to which the statements of the paper hold
_ERROR_MAX = 0.02
_DRIFT_MAX = 0.05


def figure_9(setup: FigureSetup) -> Script:
    """Match the coordinates to their images under a rotation by 180 degrees, and two variants.

    One variant matches one function instead of three coordinates, and the other does not cool
    sigma. On the default mesh, a function is also matched to its mirror image.

    A mesh without such a rotation has a mirror plane instead, and only one match.
    """
    mesh, name = setup.surface("two arms", two_armed, 3 if setup.small else 4)
    # Rotations to the left and to the right fit equally well at first. Without cooling to the
    # printed sigma, parts of the shape rotate in opposite directions and stay there.
    iterations = 100 if setup.small else scripts.affordable_iterations(mesh, 250)
    p = TABLE_1[9].parameters(cooling_stages=3, iterations=iterations)
    scene = SymmetryScene(mesh, name, detect_rotation_or_mirror(mesh))
    example = scene.example(p)
    yield example

    requested = [RequestedMatch(example.problem, share=0.3)]
    if scene.is_rotation:
        alone = scene.problem([scene.bump(scene.marked_vertices[0])], p)
        uncooled = p.with_values(cooling_stages=1, iterations=min(p.solver.iterations, 150))
        without_cooling = scene.problem(scene.coordinate_specs(), uncooled)
        requested.append(RequestedMatch(alone, "one function", 0.2))
        requested.append(RequestedMatch(without_cooling, "without cooling", 0.25))
    if setup.mesh is None:
        # matches of a function, and of coordinates, to their mirror images, which no flow can
        # produce
        short = p.with_values(iterations=15) if setup.small else p
        human = scripts.bundled("human_A.off")
        mirror = SymmetryScene(human, "human_A.off", maps.detect_symmetry(human, "mirror"))
        mirrored = mirror.problem(mirror.coordinate_specs(), short)
        requested.append(RequestedMatch(mirror.example(short).problem, "mirror", 0.1))
        requested.append(RequestedMatch(mirrored, "mirror, as a map", 0.1))
    found, *others = yield requested

    setup.report("following the map", 0.95)
    rows, measures = [function_row(found), scene.map_row(found)], scene.measures_of(found)
    qualities = scripts.flow_map_measures(found, "the map", _MEASURED_TIMES)
    if scene.is_rotation:
        one, uncooled_match = others[:2]
        of_one, of_uncooled = scene.mean_errors(one, uncooled_match)
        energies = [match.energy_history[-1, 0] for match in (uncooled_match, found)]
        of_energies = "energy without cooling over the energy with cooling"
        measures += [
            Measure("mismatch with one Gaussian as the only function", one.mismatch),
            Measure("map error with one Gaussian only, mean", of_one),
            Measure(of_energies, energies[0] / energies[1]),
            Measure("map error without cooling, mean", of_uncooled),
        ]
    if setup.mesh is None:
        bumps, as_map = others[-2:]
        image = mirror.symmetry.vertex_map
        of_bumps, of_map = mirror.mean_errors(bumps, as_map)
        other = read_vertex_map(human, str(asset_path("human.symperm.txt"))) != image
        goal = Panel(human, Coordinates(human.vertices[image]), "the mirror as a map", "target")
        end = Panel(human, Coordinates(as_map.advected), "advected coordinates", "result")
        rows.append((*function_row(bumps, "mirrored function")[:4], goal, end))
        of_others = "mirror: vertices where the detected map differs from the map of the file"
        measures += [
            Measure(of_others, other.sum()),
            Measure("mirror: mismatch of the function", bumps.mismatch),
            Measure("mirror: map error, mean", of_bumps),
            Measure("mirror: mismatch of the three coordinates", as_map.mismatch),
            Measure("mirror: map error with the three coordinates, mean", of_map),
        ]
        qualities |= scripts.flow_map_measures(as_map, "mirror, three coordinates, the map")
    of_maps, notes = scripts.quality_measures(qualities)
    setting = (
        f"{scene.description()} Printed parameters, except that sigma is cooled to {p.sigma:g} in "
        "three stages."
    )
    sheet = Sheet(tuple(rows), view_functions=scene.view_functions(), notes=notes)
    return Findings([*measures, *of_maps], sheet, setting)


def figure_10(setup: FigureSetup) -> Script:
    """Match the coordinates to their images under a rotation, on a stepped slab or a given mesh."""
    mesh, name = setup.surface("stepped slab", stepped_slab, 2 if setup.small else 6)
    iterations = 60 if setup.small else scripts.affordable_iterations(mesh, 300)
    scene = SymmetryScene(mesh, name, detect_rotation_or_mirror(mesh))
    example = scene.example(TABLE_1[10].parameters(iterations=iterations))
    yield example

    [found] = yield [RequestedMatch(example.problem, share=0.9)]
    setup.report("following the map", 0.9)
    of_maps, notes = scripts.quality_measures(
        scripts.flow_map_measures(found, "the map", _MEASURED_TIMES)
    )
    sides, normals = mesh.edge_faces[~mesh.is_boundary_edge], face_normals(mesh)
    steep = (normals[sides[:, 0]] * normals[sides[:, 1]]).sum(axis=1) < np.cos(np.pi / 4)
    creases = "edges with an angle of more than 45 degrees, share"
    share = float(steep.sum() / max(len(steep), 1))
    measures = (*scene.measures_of(found), Measure(creases, share), *of_maps)
    rows = (function_row(found), scene.map_row(found))
    sheet = Sheet(rows, ViewSpec(up="z"), scene.view_functions(), notes=notes)
    return Findings(measures, sheet, scene.description())


def detect_rotation_or_mirror(mesh: TriangleMesh) -> Symmetry:
    """Return the rotation of a mesh by 180 degrees or, if there is none, its mirror plane.

    Raise a MeshError if the mesh has neither.
    """
    errors, found = {}, None
    for kind in reversed(maps.KINDS):
        try:
            found = maps.detect_symmetry(mesh, kind)
        except maps.SymmetryError as error:
            errors[kind] = error.error
            continue
        # a rotation that reverses the orientation is a mirror map, which no flow can produce
        normals = averaging(mesh) @ face_normals(mesh)
        aligned = (normals @ found.linear.T * normals[found.vertex_map]).sum()
        if kind == "mirror" or float(aligned) >= 0:
            return found
    if found is not None:
        return found
    raise MeshError(
        "the mesh has no symmetry. The best rotation by 180 degrees moves a vertex "
        f"{errors['rotation']:.3g} sqrt(area) off the surface. The best mirror plane moves one "
        f"{errors['mirror']:.3g}; at most 0.02 is allowed"
    )


@dataclass(frozen=True)
class SymmetryScene:
    """A mesh with a symmetry, and the problems and measures of the figure."""

    mesh: TriangleMesh
    name: str
    symmetry: Symmetry

    @property
    def is_rotation(self) -> bool:
        """Whether the symmetry is a rotation, which a flow can produce, not a mirror plane."""
        return self.symmetry.kind == "rotation"

    def example(self, p: Parameters) -> Example:
        """Return the match of functions to their symmetric images as an example.

        The functions are the coordinates for a rotation, and a Gaussian for a mirror.
        """
        sources = self.coordinate_specs()
        if not self.is_rotation:
            sources = (self.bump(int(self.displacements.argmax())),)
        specs = tuple((spec, f"permuted:{self.symmetry.kind}({spec})") for spec in sources)
        return Example(self.problem(sources, p), self.name, specs)

    def problem(self, specs: Iterable[str], p: Parameters) -> Problem:
        """Return the match of functions to their images under the symmetry."""
        source = np.stack([function(self.mesh, spec) for spec in specs], axis=1)
        return Problem(self.mesh, source, source[self.symmetry.vertex_map], p)

    @property
    def displacements(self) -> FloatArray:
        x = self.mesh.vertices
        return np.asarray(np.linalg.norm(x[self.symmetry.vertex_map] - x, axis=1))

    @cached_property
    def marked_vertices(self) -> list[int]:
        """Three vertices to show.

        They are the vertex in front with the largest displacement, its image, and a distant one.
        """
        mesh, x = self.mesh, self.mesh.vertices
        front = np.ones(len(x), dtype=bool)
        if self.is_rotation:
            facing = averaging(mesh) @ (face_normals(mesh) @ self.symmetry.axis)
            front = facing > 0.9 * facing.max()
        vertex = int(np.where(front, self.displacements, -1).argmax())
        marked_vertices = [vertex, int(self.symmetry.vertex_map[vertex])]
        distances = np.linalg.norm(x[:, None] - x[marked_vertices], axis=2).min(axis=1)
        return [*marked_vertices, int(np.where(front, distances, -1).argmax())]

    def bump(self, vertex: int) -> str:
        return scripts.gaussian(self.mesh, vertex, _GAUSSIAN_WIDTH)

    def coordinate_specs(self) -> tuple[str, ...]:
        """Return specifications of centred coordinates in units of sqrt(area)."""
        scale = self.mesh.length_scale
        middles = self.mesh.vertices.mean(axis=0) / scale
        return tuple(
            f"expression:{axis}/{scale:.6g}-({round(middle, 6) + 0.0:g})"
            for axis, middle in zip("xyz", middles, strict=True)
        )

    def view_functions(self) -> tuple[FloatArray, ...]:
        """Return functions that are large at the marked vertices, for the choice of the camera."""
        return tuple(function(self.mesh, self.bump(vertex)) for vertex in self.marked_vertices)

    @property
    def sample(self) -> IntArray:
        """Indices of evenly selected vertices; measurements at all would be too slow."""
        count = len(self.mesh.vertices)
        return np.linspace(0, count - 1, min(_SAMPLE_VERTICES, count)).astype(np.int64)

    def mean_errors(self, *matches: Match) -> list[float]:
        """Return the mean geodesic distance of each map at tau from the symmetry, in sqrt(area)."""
        rows = self.sample
        ends = [match.flow.coordinate_map().points[rows] for match in matches]
        found = geodesics(self.mesh, self.symmetry.vertex_map[rows], *ends)
        return [float(distances.mean()) for distances in found]

    def measures_of(self, match: Match) -> list[Measure]:
        """Measure the mismatch, map error and drift of a match; compare its map with flow lines.

        The map error is the distance of the map at tau from the symmetry. The drift is the distance
        of points at 2 tau from their starts, to which they should return.
        """
        mesh, tau, rows = self.mesh, match.parameters.tau, self.sample
        [drift] = geodesics(mesh, rows, match.flow.coordinate_map(2 * tau).points[rows])
        starts = maps.project_onto_surface(mesh, mesh.vertices[rows])
        lines = flow_lines(mesh, match.fine_velocity, starts, -tau, tau)
        ends = maps.project_onto_surface(mesh, np.array([line.positions[-1] for line in lines]))
        points = match.flow.coordinate_map().points[rows]
        error, by_lines = geodesics(mesh, self.symmetry.vertex_map[rows], points, ends)
        distances = np.linalg.norm(ends.positions - points.positions, axis=1) / mesh.length_scale
        error_mean, drift_mean = error.mean(), drift.mean()
        of_error = "map error at τ, mean, geodesic / √area"
        of_drift = "drift at 2 τ, mean, geodesic / √area"
        of_ends = "distance of advected points from the ends of exact flow lines, mean"
        correct = (
            "the points and the coordinate functions are smoothly mapped to the correct values"
        )
        drifts = "some drift is noticeable, yet it is relatively small"
        return [
            Measure("mismatch of the functions", match.mismatch),
            Measure(of_error, error_mean, correct, error_mean < _ERROR_MAX),
            Measure("map error at τ, 95th percentile", np.quantile(error, 0.95)),
            Measure(of_drift, drift_mean, drifts, drift_mean < _DRIFT_MAX),
            Measure("drift at 2 τ, 95th percentile", np.quantile(drift, 0.95)),
            Measure("map error at τ by exact flow lines, mean", by_lines.mean()),
            Measure(of_ends, distances.mean()),
        ]

    def map_row(self, match: Match) -> tuple[Panel, ...]:
        """Return panels in which a flow moves coordinates, shown as colours, and marked points."""
        panels = []
        for share, label in _SHOWN_TIMES.items():
            time = share * match.parameters.tau
            coordinate_specs = Coordinates(match.push(self.mesh.vertices, time))
            points = match.flow.coordinate_map(-time).positions[self.marked_vertices]
            panels.append(Panel(self.mesh, coordinate_specs, label, points=points))
        return tuple(panels)

    def description(self) -> str:
        axis = ", ".join(f"{value:.2g}" for value in np.round(self.symmetry.axis, 3) + 0.0)
        matched = (
            f"rotation by 180 degrees about ({axis}); the three coordinates are matched together"
            if self.is_rotation
            else f"mirror plane with normal ({axis}), which no flow can produce; one Gaussian is "
            "matched"
        )
        return f"{scripts.size_text(self.name, self.mesh)}, {matched}."


def geodesics(mesh: TriangleMesh, vertices: IntArray, *ends: maps.SurfacePoints) -> FloatArray:
    """Return geodesic distances (K, P), in sqrt(area), of P vertices from K sets of P points."""
    distances = np.array([points.distances_from(mesh.vertices[vertices]) for points in ends])
    is_distant = np.array(
        [(mesh.faces[points.faces] != vertices[:, None]).all(axis=1) for points in ends]
    )
    # For distant points, interpolate the exact distances of a face's corners linearly. The result
    # is at least the exact distance.
    for i in np.flatnonzero(is_distant.any(axis=0)):
        corners = np.concatenate([mesh.faces[points.faces[i]] for points in ends])
        exact = exact_distances(mesh, vertices[i], corners)
        weights = np.array([points.barycentric[i] for points in ends])
        interpolated = (exact.reshape(-1, 3) * weights).sum(axis=1)
        distances[:, i] = np.where(is_distant[:, i], interpolated, distances[:, i])
    return np.asarray(distances / mesh.length_scale)


def function_row(match: Match, bar: str = "function") -> tuple[Panel, ...]:
    """Return panels of the channel that changes most (source, target, result) and of the field.

    ``bar`` is the title of the colour bars of the channel.
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
