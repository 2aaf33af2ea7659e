"""Figure 11: two functions with jumps become smooth ones. In figures 11 to 13 coordinates of pose A
go to B by a point map of few eigenfunctions; targets are those of the true map, cut off at more.
"""

from dataclasses import dataclass

import numpy as np

from abfm import MeshError, PointMap, Problem, TriangleMesh
from abfm.calculus import vertex_areas
from abfm.experiments import vocabulary as words
from abfm.experiments.vocabulary import Example, Findings, Measure, Script, Stage
from abfm.io.sheets import Checker, Panel, Sheet, Values
from abfm.maps import functional_map, point_map
from abfm.maps.functional_maps import carry
from abfm.mesh import per_mesh
from abfm.parameters import TABLE_1, Row
from abfm.types import FloatArray, IntArray

CLAIM = (
    "Two non-smooth functions are matched to smooth versions of them at once, and the required "
    "functions are achieved."
)
FEW = 10
"""Eigenfunctions of the start map."""
MATCHED = 0.1
"""Share of the first mismatch that may be left where functions count as matched."""

_MANY, _MANY_SMALL = 100, 30
_FEWEST_VERTICES = 60
_BEND = np.pi / 3
_FIELDS = 16  # of the checkerboard, along the longest axis


def figure(stage: Stage) -> Script:
    """Match two coordinates of pose A on pose B at once, and see what is left at every vertex."""
    poses = Poses.of(stage)
    axes = sorted(by_extent(poses.a)[:2].tolist())
    example = poses.example(TABLE_1[11], axes, stage.small)
    yield example

    a, b, problem = poses.a, poses.b, example.problem
    found = stage.match(problem, "matching two functions", (0.0, 1.0))
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
        Measure(of_sum, left, claim, left <= MATCHED),
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
        mesh = stage.mesh
        if mesh is None:
            a, b, name = words.bundled("human_A.off"), words.bundled("human_B.off"), "human_B.off"
            told = "human_B.off against human_A.off, the same vertices in another pose"
        else:
            if len(mesh.vertices) < _FEWEST_VERTICES:
                raise MeshError(
                    f"the mesh has {len(mesh.vertices)} vertices; for {_MANY} eigenfunctions, or a "
                    f"third of the number of vertices, give one with at least {_FEWEST_VERTICES}"
                )
            a, b, name = mesh, bent(mesh), "bent mesh"
            bend = f"{np.degrees(_BEND):.0f}°"
            told = f"the mesh bent by {bend} against itself, as no second pose is known"
        truth = PointMap.of_vertices(b, a)
        start = point_map(a, b, functional_map(truth, FEW))
        many = min(_MANY_SMALL if stage.small else _MANY, len(b.vertices) // 3)
        return cls(a, b, name, told, start, functional_map(truth, many))

    def example(self, row: Row, axes: list[int], small: bool) -> Example:
        """Return the match of some of A's coordinates."""
        places = coordinates(self.a)
        source = self.start.pull_back(places)[:, axes]
        target = carry(self.a, self.b, self.wanted, places)[:, axes]
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
            f"nearest neighbour in the spectral embedding, {FEW} eigenfunctions; targets: by the "
            f"true functional map, {k} x {k}. Parameters of Table 1, "
            f"{problem.parameters.iterations} iterations"
        )

    def checker(self, functions: FloatArray) -> Checker:
        """Return two coordinate functions (V, 2) as a checkerboard, on either pose."""
        extent = np.ptp(coordinates(self.a), axis=0).max()
        return Checker(functions * (0.5 * _FIELDS / extent))


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
