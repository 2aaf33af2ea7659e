"""Figures 9 and 10: one field whose flow is a symmetry, the rotation of a shape by 180 degrees."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from abfm import Match, MeshError, Parameters, Problem, TriangleMesh, function, maps
from abfm.assets import asset_path
from abfm.calculus import averaging, face_normals
from abfm.calculus.geodesics import exact_distances
from abfm.experiments import vocabulary as words
from abfm.experiments.vocabulary import Example, Findings, Measure, Script, Sought, Stage
from abfm.flow import flow_lines
from abfm.functions import read_vertex_map
from abfm.io.sheets import Coordinates, Panel, Sheet, Streaks, Values
from abfm.maps import Symmetry
from abfm.mesh.shapes import stepped_slab, two_armed
from abfm.parameters import TABLE_1
from abfm.types import FloatArray, IntArray

_MEASURED_TIMES = (1.0, 2.0)  # times, of tau, of the map
_SHOWN_TIMES = {0.0: "t = 0", 0.5: "t = 0.5 τ", 1.0: "t = τ", 2.0: "t = 2 τ"}  # by shares of tau
_WIDTH = 0.2  # of the Gaussian
_SAMPLE = 150
# of sqrt(area), for what the paper says in words
_ERROR_MAX = 0.02
_DRIFT_MAX = 0.05


def figure_9(stage: Stage) -> Script:
    """Match all functions after a rotation, one alone, all without cooling; then a mirror."""
    mesh, name = stage.surface("two arms", two_armed, 3 if stage.small else 4)
    # cooled to the printed sigma: a turn to the left and one to the right fit equally well at
    # first, and without cooling some parts of the shape turn one way and some the other, for good
    iterations = 100 if stage.small else words.affordable_iterations(mesh, 250)
    p = TABLE_1[9].parameters(cooling_stages=3, iterations=iterations)
    scene = Symmetric(mesh, name, detected(mesh))
    example = scene.example(p)
    yield example

    sought = [Sought(example.problem, share=0.3)]
    if scene.rotates:
        alone = scene.problem([scene.bump(scene.marks[0])], p)
        uncooled = p.with_values(cooling_stages=1, iterations=min(p.solver.iterations, 150))
        hotter = scene.problem(scene.places(), uncooled)
        sought += [Sought(alone, "one function", 0.2), Sought(hotter, "without cooling", 0.25)]
    if stage.mesh is None:
        # a function and its mirror image, and the mirror as a map, which is out of reach
        short = p.with_values(iterations=15) if stage.small else p
        human = words.bundled("human_A.off")
        mirror = Symmetric(human, "human_A.off", maps.detect_symmetry(human, "mirror"))
        mirrored = mirror.problem(mirror.places(), short)
        sought.append(Sought(mirror.example(short).problem, "mirror", 0.1))
        sought.append(Sought(mirrored, "mirror, as a map", 0.1))
    found, *others = yield sought

    stage.report("following the map", 0.95)
    rows, measures = [function_row(found), scene.map_row(found)], scene.measured(found)
    judged = words.maps_of_flow(found, "the map", _MEASURED_TIMES)
    if scene.rotates:
        one, hot = others[:2]
        of_one, of_hot = scene.mean_errors(one, hot)
        energies = [match.energy_history[-1, 0] for match in (hot, found)]
        measures += [
            Measure("mismatch with one Gaussian as the only function", one.mismatch),
            Measure("map error with one Gaussian only, mean", of_one),
            Measure("energy without cooling over the energy here", energies[0] / energies[1]),
            Measure("map error without cooling, mean", of_hot),
        ]
    if stage.mesh is None:
        bumps, as_map = others[-2:]
        image = mirror.symmetry.vertex_map
        of_bumps, of_map = mirror.mean_errors(bumps, as_map)
        other = read_vertex_map(human, str(asset_path("human.symperm.txt"))) != image
        goal = Panel(human, Coordinates(human.vertices[image]), "the mirror as a map", "target")
        end = Panel(human, Coordinates(as_map.advected), "matched: not reached", "result")
        rows.append((*function_row(bumps, "mirrored function")[:4], goal, end))
        measures += [
            Measure("mirror: vertices where the detected map is not the file's", other.sum()),
            Measure("mirror: mismatch of the function", bumps.mismatch),
            Measure("mirror: map error, mean", of_bumps),
            Measure("mirror: mismatch of the three coordinates", as_map.mismatch),
            Measure("mirror: map error with the three coordinates, mean", of_map),
        ]
        judged |= words.maps_of_flow(as_map, "mirror, three coordinates, the map")
    of_maps, notes = words.map_findings(judged)
    setting = (
        f"{scene.words()} Printed parameters, but sigma is cooled to {p.sigma:g} in three stages."
    )
    sheet = Sheet(tuple(rows), seen=scene.seen(), notes=notes)
    return Findings([*measures, *of_maps], sheet, setting)


def figure_10(stage: Stage) -> Script:
    """Match the places on a slab with a step and a rotation, or by the symmetry of a given mesh."""
    mesh, name = stage.surface("stepped slab", stepped_slab, 2 if stage.small else 6)
    iterations = 60 if stage.small else words.affordable_iterations(mesh, 300)
    scene = Symmetric(mesh, name, detected(mesh))
    example = scene.example(TABLE_1[10].parameters(iterations=iterations))
    yield example

    [found] = yield [Sought(example.problem, share=0.9)]
    stage.report("following the map", 0.9)
    of_maps, notes = words.map_findings(words.maps_of_flow(found, "the map", _MEASURED_TIMES))
    sides, normals = mesh.edge_faces[~mesh.is_boundary_edge], face_normals(mesh)
    steep = (normals[sides[:, 0]] * normals[sides[:, 1]]).sum(axis=1) < np.cos(np.pi / 4)
    creases = "edges with an angle of more than 45 degrees, share"
    share = float(steep.sum() / max(len(steep), 1))
    measures = (*scene.measured(found), Measure(creases, share), *of_maps)
    rows = (function_row(found), scene.map_row(found))
    return Findings(measures, Sheet(rows, "z", scene.seen(), notes=notes), scene.words())


def detected(mesh: TriangleMesh) -> Symmetry:
    """Find the rotation by 180 degrees that a mesh has, or else its mirror plane, or MeshError."""
    errors, found = {}, None
    for kind in reversed(maps.KINDS):
        try:
            found = maps.detect_symmetry(mesh, kind)
        except maps.SymmetryError as error:
            errors[kind] = error.error
            continue
        # one that turns the surface over acts on it as a mirror, which no flow reaches
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


@dataclass(frozen=True)
class Symmetric:
    """A mesh with a symmetry, by its name, and what is matched and measured there."""

    mesh: TriangleMesh
    name: str
    symmetry: Symmetry

    @property
    def rotates(self) -> bool:
        """Whether a flow can reach it."""
        return self.symmetry.kind == "rotation"

    def example(self, p: Parameters) -> Example:
        """Return the places and these after a rotation; for a mirror a Gaussian, moved far."""
        sources = self.places() if self.rotates else (self.bump(int(self.moved.argmax())),)
        specs = tuple((spec, f"permuted:{self.symmetry.kind}({spec})") for spec in sources)
        return Example(self.problem(sources, p), self.name, specs)

    def problem(self, specs: Iterable[str], p: Parameters) -> Problem:
        """Return functions and these after the symmetry."""
        source = np.stack([function(self.mesh, spec) for spec in specs], axis=1)
        return Problem(self.mesh, source, source[self.symmetry.vertex_map], p)

    @property
    def moved(self) -> FloatArray:
        """How far the symmetry moves each vertex, (V,)."""
        x = self.mesh.vertices
        return np.asarray(np.linalg.norm(x[self.symmetry.vertex_map] - x, axis=1))

    @cached_property
    def marks(self) -> list[int]:
        """Three vertices to show: moved farthest in front, where it goes, and far from both."""
        mesh, x = self.mesh, self.mesh.vertices
        front = np.ones(len(x), dtype=bool)
        if self.rotates:
            looks = averaging(mesh) @ (face_normals(mesh) @ self.symmetry.axis)
            front = looks > 0.9 * looks.max()
        mark = int(np.where(front, self.moved, -1).argmax())
        marks = [mark, int(self.symmetry.vertex_map[mark])]
        apart = np.linalg.norm(x[:, None] - x[marks], axis=2).min(axis=1)
        return [*marks, int(np.where(front, apart, -1).argmax())]

    def bump(self, vertex: int) -> str:
        return words.gaussian(self.mesh, vertex, _WIDTH)

    def places(self) -> tuple[str, ...]:
        """Return the coordinates from the middle in sqrt(area), for sigma to weigh them alike."""
        scale = self.mesh.length_scale
        middles = self.mesh.vertices.mean(axis=0) / scale
        return tuple(
            f"expression:{axis}/{scale:.6g}-({round(middle, 6) + 0.0:g})"
            for axis, middle in zip("xyz", middles, strict=True)
        )

    def seen(self) -> tuple[FloatArray, ...]:
        """Return functions that are large where the marks are, for the camera to show them."""
        return tuple(function(self.mesh, self.bump(mark)) for mark in self.marks)

    @property
    def sample(self) -> IntArray:
        """Some vertices, evenly taken: exact geodesics cost much more than the map."""
        count = len(self.mesh.vertices)
        return np.linspace(0, count - 1, min(_SAMPLE, count)).astype(np.int64)

    def mean_errors(self, *matches: Match) -> list[float]:
        """Return the mean distances of the maps at tau along the surface, in sqrt(area)."""
        rows = self.sample
        ends = [match.flow.coordinate_map().points[rows] for match in matches]
        found = geodesics(self.mesh, self.symmetry.vertex_map[rows], *ends)
        return [float(distances.mean()) for distances in found]

    def measured(self, match: Match) -> list[Measure]:
        """Measure mismatch, map error and drift, with exact flow lines, walked back, as witness."""
        mesh, tau, rows = self.mesh, match.parameters.tau, self.sample
        [drift] = geodesics(mesh, rows, match.flow.coordinate_map(2 * tau).points[rows])
        starts = maps.project_onto_surface(mesh, mesh.vertices[rows])
        lines = flow_lines(mesh, match.fine_velocity, starts, -tau, tau)
        ends = maps.project_onto_surface(mesh, np.array([line.positions[-1] for line in lines]))
        points = match.flow.coordinate_map().points[rows]
        error, by_lines = geodesics(mesh, self.symmetry.vertex_map[rows], points, ends)
        apart = np.linalg.norm(ends.positions - points.positions, axis=1) / mesh.length_scale
        reached, kept = error.mean(), drift.mean()
        correct = (
            "the points and the coordinate functions are smoothly mapped to the correct values"
        )
        small = "some drift is noticeable, yet it is relatively small"
        return [
            Measure("mismatch of the functions", match.mismatch),
            Measure(
                "map error at τ, mean, geodesic / √area", reached, correct, reached < _ERROR_MAX
            ),
            Measure("map error at τ, 95th percentile", np.quantile(error, 0.95)),
            Measure("drift at 2 τ, mean, geodesic / √area", kept, small, kept < _DRIFT_MAX),
            Measure("drift at 2 τ, 95th percentile", np.quantile(drift, 0.95)),
            Measure("map error at τ by exact flow lines, mean", by_lines.mean()),
            Measure("advected points from the ends of exact flow lines, mean", apart.mean()),
        ]

    def map_row(self, match: Match) -> tuple[Panel, ...]:
        """Show places as colours, carried by the flow, and marked points that move with it."""
        panels = []
        for share, label in _SHOWN_TIMES.items():
            time = share * match.parameters.tau
            places = Coordinates(match.push(self.mesh.vertices, time))
            points = match.flow.coordinate_map(-time).positions[self.marks]
            panels.append(Panel(self.mesh, places, label, points=points))
        return tuple(panels)

    def words(self) -> str:
        """Say what is matched, in a sentence."""
        axis = ", ".join(f"{value:.2g}" for value in np.round(self.symmetry.axis, 3) + 0.0)
        matched = (
            f"rotation by 180 degrees about ({axis}); the three coordinates are matched at once"
            if self.rotates
            else f"mirror plane with normal ({axis}), no map that a flow can reach; one Gaussian "
            "is matched"
        )
        return f"{words.sized(self.name, self.mesh)}, {matched}."


def geodesics(mesh: TriangleMesh, vertices: IntArray, *ends: maps.SurfacePoints) -> FloatArray:
    """Measure how far in sqrt(area) along the surface P vertices are from K points each, (K, P)."""
    distances = np.array([points.distances_from(mesh.vertices[vertices]) for points in ends])
    far = np.array([(mesh.faces[points.faces] != vertices[:, None]).all(axis=1) for points in ends])
    # far ones linearly between the exact distances of a face's corners: never less than exact
    for i in np.flatnonzero(far.any(axis=0)):
        corners = np.concatenate([mesh.faces[points.faces[i]] for points in ends])
        exact = exact_distances(mesh, vertices[i], corners)
        weights = np.array([points.barycentric[i] for points in ends])
        between = (exact.reshape(-1, 3) * weights).sum(axis=1)
        distances[:, i] = np.where(far[:, i], between, distances[:, i])
    return np.asarray(distances / mesh.length_scale)


def function_row(match: Match, bar: str = "function") -> tuple[Panel, ...]:
    """Show source, target, result, field and its norm; of several functions the one most moved."""
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
