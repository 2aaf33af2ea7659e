"""A symmetry reached by a flow: what figures 9 and 10 set up, measure and show."""

from dataclasses import dataclass

import igl
import numpy as np

from abfm.calculus.operators import averaging, face_normals
from abfm.errors import MeshError
from abfm.experiments.experiment import Measure, Report, Setup, solved
from abfm.experiments.sheet import Coordinates, Panel, Streaks, Values
from abfm.flow.flow_lines import flow_lines
from abfm.functions import function
from abfm.maps.surface_points import SurfacePoints, project_onto_surface
from abfm.maps.symmetry import KINDS, Kind, Symmetry, SymmetryError, detect_symmetry
from abfm.matching.result import Match
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray, IntArray

Specs = tuple[str, ...]

_SHOWN = (0.0, 0.5, 1.0, 2.0)  # of tau
MEASURED = (1.0, 2.0)
"""Those of them, of tau, at which the map is measured."""
_WIDTH = 0.2  # of the Gaussian
_SAMPLE = 150
_CORRECT, _SMALL_DRIFT = 0.02, 0.05  # of sqrt(area), for what the paper says in words


@dataclass(frozen=True, eq=False, kw_only=True)
class SymmetrySetup(Setup):
    """Functions and the same functions after a symmetry map.

    Attributes
    ----------
    symmetry : Symmetry
    marks : (P,) array of int
        Vertices whose ways are shown.
    """

    symmetry: Symmetry
    marks: IntArray


def detected(mesh: TriangleMesh) -> Symmetry:
    """The rotation by 180 degrees that a mesh has, or else its mirror plane.

    A rotation that turns the surface over, as one about an axis in a flat one, acts on it as a mirror: no flow reaches
    it, and mirrors go before it.

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
        if kind == "mirror" or not _turns_over(mesh, found):
            return found
    if found is not None:
        return found
    raise MeshError(
        "the mesh has no symmetry: the best rotation by 180 degrees and the best mirror plane carry a vertex "
        f"{errors['rotation']:.3g} and {errors['mirror']:.3g} sqrt(area) away from the surface, and 0.02 is allowed"
    )


def _turns_over(mesh: TriangleMesh, symmetry: Symmetry) -> bool:
    """Whether normals arrive on the other side."""
    normals = averaging(mesh) @ face_normals(mesh)
    return float((normals @ symmetry.linear.T * normals[symmetry.vertex_map]).sum()) < 0


def set_up(mesh: TriangleMesh, name: str, symmetry: Symmetry, parameters: Parameters) -> SymmetrySetup:
    """The places in space as functions for a rotation; for a mirror, which no flow reaches as a map, a Gaussian.

    The Gaussian is where the symmetry moves a vertex farthest. The marks are such a vertex, among those that look along
    the axis of a rotation, where it goes, and the one of them that is as far as can be from both.
    """
    x, vertex_map = mesh.vertices, symmetry.vertex_map
    moved = np.linalg.norm(x[vertex_map] - x, axis=1)
    first = int(moved.argmax())
    looks = averaging(mesh) @ (face_normals(mesh) @ symmetry.axis)
    front = looks > 0.9 * looks.max() if symmetry.kind == "rotation" else np.ones(len(x), dtype=bool)
    mark = int(np.where(front, moved, -1).argmax())
    marks = [mark, int(vertex_map[mark])]
    apart = np.linalg.norm(x[:, None] - x[marks], axis=2).min(axis=1)
    marks.append(int(np.where(front, apart, -1).argmax()))
    sources = places(mesh) if symmetry.kind == "rotation" else (bump(mesh, first),)
    return SymmetrySetup(
        mesh=mesh,
        name=name,
        sources=sources,
        targets=tuple(f"permuted:{symmetry.kind}({spec})" for spec in sources),
        parameters=parameters,
        symmetry=symmetry,
        marks=np.array(marks),
    )


def solve(setup: SymmetrySetup, report: Report, text: str, shares: tuple[float, float], specs: Specs = ()) -> Match:
    """Match the set-up's functions, or others, with these after the symmetry; report from one share to another."""
    source = setup.source if not specs else np.stack([function(setup.mesh, spec) for spec in specs], axis=1)
    return solved(setup, report, text, shares, source, source[setup.symmetry.vertex_map])


def bump(mesh: TriangleMesh, vertex: int) -> str:
    """The spec of a bump around a vertex."""
    return f"gaussian:vertex={mesh.vertex_ids[vertex]},width={_WIDTH:g}"


def places(mesh: TriangleMesh) -> Specs:
    """The three coordinates from the mesh's middle in sqrt(area), so that sigma weighs them alike on all meshes."""
    middles = mesh.vertices.mean(axis=0) / mesh.length_scale
    return tuple(
        f"expression:{axis}/{mesh.length_scale:.6g}-({round(middle, 6) + 0.0:g})"
        for axis, middle in zip("xyz", middles, strict=True)
    )


def _sampled(mesh: TriangleMesh) -> IntArray:
    """Vertices on which maps are measured, evenly taken: exact geodesics cost much more than the map."""
    return np.linspace(0, len(mesh.vertices) - 1, min(_SAMPLE, len(mesh.vertices))).astype(np.int64)


def mean_error(match: Match, symmetry: Symmetry) -> float:
    """Mean distance of the point map at tau from the symmetry, along the surface, in sqrt(area)."""
    sample = _sampled(match.mesh)
    return float(geodesics(match.mesh, symmetry.vertex_map[sample], _at(match.point_map(), sample)).mean())


def measures(match: Match, symmetry: Symmetry) -> list[Measure]:
    """Mismatch, map error and drift, and the exact flow lines as a witness.

    Flow lines are walked against the flow: a vertex's value came from where its line ends.
    """
    mesh, tau, sample = match.mesh, match.parameters.tau, _sampled(match.mesh)
    [drift] = geodesics(mesh, sample, _at(match.point_map(2 * tau), sample))
    lines = flow_lines(mesh, match.velocity, project_onto_surface(mesh, mesh.vertices[sample]), -tau, tau)
    ends = project_onto_surface(mesh, np.array([line.positions[-1] for line in lines]))
    points = _at(match.point_map(), sample)
    error, by_lines = geodesics(mesh, symmetry.vertex_map[sample], points, ends)
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
    """Distance in sqrt(area) along the surface from each of P vertices to its own point, for K sets of points, (K, P).

    Exact on faces around the vertex and at vertices, elsewhere linear between the exact distances of a face's corners,
    which is never less than the distance (Mitchell, Mount, Papadimitriou 1987).
    """
    none = np.zeros(0, dtype=np.int64)
    distances = np.array([np.linalg.norm(points.positions - mesh.vertices[vertices], axis=1) for points in ends])
    far = np.array([(mesh.faces[points.faces] != vertices[:, None]).all(axis=1) for points in ends])
    for i in np.flatnonzero(far.any(axis=0)):
        corners = np.concatenate([mesh.faces[points.faces[i]] for points in ends])
        exact = igl.exact_geodesic(mesh.vertices, mesh.faces, VS=vertices[i : i + 1], FS=none, VT=corners, FT=none)
        weights = np.array([points.barycentric[i] for points in ends])
        distances[:, i] = np.where(far[:, i], (exact.reshape(-1, 3) * weights).sum(axis=1), distances[:, i])
    fractions: FloatArray = distances / mesh.length_scale
    return fractions


def _at(points: SurfacePoints, rows: IntArray) -> SurfacePoints:
    return SurfacePoints(points.faces[rows], points.barycentric[rows], points.positions[rows], points.distances[rows])


def function_row(match: Match, bar: str = "function") -> tuple[Panel, ...]:
    """Source, target, result, and the field with its norm; of several functions the one that changes most."""
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


def seen(setup: SymmetrySetup) -> tuple[FloatArray, ...]:
    """Functions that are large where the marks are, for the camera to show them."""
    return tuple(function(setup.mesh, bump(setup.mesh, mark)) for mark in setup.marks)


def map_row(match: Match, marks: IntArray) -> tuple[Panel, ...]:
    """Places as colours, carried by the flow, and marked points that move with it."""
    mesh, tau = match.mesh, match.parameters.tau
    panels = []
    for share in _SHOWN:
        places = match.push(mesh.vertices, share * tau)
        at = match.point_map(-share * tau).positions[marks]
        label = "t = 0" if not share else f"t = {'' if share == 1 else f'{share:g} '}τ"
        panels.append(Panel(mesh, Coordinates(places), label, points=at))
    return tuple(panels)


def setting(setup: SymmetrySetup) -> str:
    """What is matched, in a sentence or two."""
    symmetry = setup.symmetry
    axis = ", ".join(f"{value:.2g}" for value in np.round(symmetry.axis, 3) + 0.0)
    if symmetry.kind == "rotation":
        words = f"rotation by 180 degrees about ({axis}); the three coordinates are matched at once"
    else:
        words = f"mirror plane with normal ({axis}), no map that a flow can reach; one Gaussian is matched"
    return f"{setup.where}, {words}."
