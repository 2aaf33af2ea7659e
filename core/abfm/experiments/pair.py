"""Two poses of one surface, a map between them with errors, and the functions that a flow is to correct it by.

Figures 11 to 13 share this. Functions on pose A are its coordinates. The start is a point map from B to A, the nearest
neighbour in the spectral embedding by few eigenfunctions, so that A's coordinates arrive on B with jumps; the targets
are A's coordinates carried by the true functional map, cut off at more eigenfunctions, and smooth.
"""

from dataclasses import dataclass

import numpy as np

from abfm.calculus.operators import vertex_areas
from abfm.errors import MeshError
from abfm.experiments.experiment import Report, Setup, affordable_iterations, solved
from abfm.experiments.meshes import bundled
from abfm.experiments.sheet import Checker
from abfm.experiments.table_1 import TABLE_1
from abfm.flow.flow_lines import flow_lines
from abfm.maps.functional_maps import carry, functional_map, point_map
from abfm.maps.surface_points import SurfacePoints, project_onto_surface, pull_back, vertex_points
from abfm.matching.result import Match
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IntArray

FEW = 10
"""Eigenfunctions of the start map."""
_MANY, _MANY_SMALL = 100, 30
_FEWEST_VERTICES = 60
_BEND = np.pi / 3
_FIELDS = 16  # of the checkerboard, along the longest axis
MATCHED = 0.1
"""Share of the first mismatch that may be left where functions count as matched."""
_AXES = "xyz"


@dataclass(frozen=True, eq=False, kw_only=True)
class PairSetup(Setup):
    """What a flow on B is to correct.

    Attributes
    ----------
    other : TriangleMesh
        Pose A, vertex by vertex the same surface as B, which is `mesh`.
    start : SurfacePoints
        Where on A the start map takes each vertex of B.
    wanted : (k, k) array
        The true functional map, cut off.
    setting : str
    """

    other: TriangleMesh
    start: SurfacePoints
    wanted: FloatArray
    setting: str

    @property
    def axes(self) -> tuple[int, ...]:
        """Which coordinate each channel is: 0, 1 or 2."""
        return tuple(_AXES.index(spec[-5]) for spec in self.sources)

    @property
    def longest(self) -> tuple[int, ...]:
        """The coordinates by extent, the largest one first."""
        return tuple(_by_extent(self.other).tolist())

    def checker(self, functions: FloatArray) -> Checker:
        """Two coordinate functions (V, 2) as a checkerboard, on either pose."""
        extent = np.ptp(coordinates(self.other), axis=0).max()
        return Checker(functions * (0.5 * _FIELDS / extent))


def pair(figure: int, mesh: TriangleMesh | None, small: bool, channels: int) -> PairSetup:
    """Set up the match of so many of A's coordinates, those with the largest extents.

    Raises
    ------
    MeshError
        If the mesh has too few vertices.
    """
    if mesh is None:
        a, b, name = bundled("human_A.off"), bundled("human_B.off"), "human_B.off"
        poses = "human_B.off against human_A.off, the same vertices in another pose"
    else:
        if len(mesh.vertices) < _FEWEST_VERTICES:
            raise MeshError(
                f"the mesh has {len(mesh.vertices)} vertices; for {_MANY} eigenfunctions, or a third of the number of "
                f"vertices, give one with at least {_FEWEST_VERTICES}"
            )
        a, b, name = mesh, bent(mesh), "bent mesh"
        poses = f"the mesh bent by {np.degrees(_BEND):.0f}° against itself, as no second pose is known"
    count = len(b.vertices)
    many = min(_MANY_SMALL if small else _MANY, count // 3)
    truth = vertex_points(a, np.arange(count))
    start = point_map(a, b, functional_map(a, b, truth, FEW))
    wanted = functional_map(a, b, truth, many)
    places = coordinates(a)
    axes = sorted(_by_extent(a)[:channels])
    sources, targets = ([f"file:{kind}_{_AXES[x]}.npy" for x in axes] for kind in ("start", "target"))
    columns = np.concatenate([pull_back(a, start, places), carry(a, b, wanted, places)], axis=1).T
    named = dict(zip([*sources, *targets], columns[[*axes, *(3 + x for x in axes)]], strict=True))
    parameters = TABLE_1[figure].parameters(iterations=20 if small else affordable_iterations(b, 500))
    return PairSetup(
        mesh=b,
        name=name,
        sources=tuple(sources),
        targets=tuple(targets),
        values=named,
        parameters=parameters,
        other=a,
        start=start,
        wanted=wanted,
        setting=(
            f"{poses}, {count:,} vertices. Functions: coordinates {', '.join(_AXES[x] for x in axes)} of A in units of "
            f"sqrt(area); start: by the nearest neighbour in the spectral embedding, {FEW} eigenfunctions; targets: "
            f"by the true functional map, {many} x {many}. Parameters of Table 1, {parameters.iterations} iterations"
        ),
    )


@per_mesh
def coordinates(mesh: TriangleMesh) -> FloatArray:
    """Coordinates from the centroid, in units of sqrt(area), (V, 3)."""
    places = mesh.normalized().vertices
    areas = vertex_areas(mesh.normalized())
    centred: FloatArray = places - areas @ places
    return centred


def share_left(after: float, before: float) -> float:
    """What of a mismatch is left; all of it where there was none."""
    return after / before if before > 0 else 1.0


def _by_extent(mesh: TriangleMesh) -> IntArray:
    return np.argsort(-np.ptp(mesh.vertices, axis=0), kind="stable")


@per_mesh
def bent(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh bent into an arc along its longest axis, towards its shortest one: almost an isometry where it is thin.

    Lengths along the middle of the arc stay, and those at a depth ``w`` from it change by the factor ``1 - w / R``.
    """
    corner = mesh.vertices.min(axis=0)
    extent = mesh.vertices.max(axis=0) - corner
    along, _, deep = _by_extent(mesh)
    middle = corner + extent / 2
    radius = extent[along] / _BEND
    angle = (mesh.vertices[:, along] - middle[along]) / radius
    height = radius - (mesh.vertices[:, deep] - middle[deep])
    moved = mesh.vertices.copy()
    moved[:, along] = middle[along] + height * np.sin(angle)
    moved[:, deep] = middle[deep] + radius - height * np.cos(angle)
    return TriangleMesh(moved, mesh.faces)


def matched(
    setup: PairSetup,
    channels: list[int],
    report: Report,
    text: str,
    shares: tuple[float, float] = (0.0, 1.0),
    source: FloatArray | None = None,
) -> Match:
    """Match some of the set-up's functions, or `source` (V, C) in place of its sources."""
    source = setup.source if source is None else source
    return solved(setup, report, text, shares, source[:, channels], setup.target[:, channels])


def closest(setup: PairSetup, functions: FloatArray) -> SurfacePoints:
    """The point map that three functions (V, 3) on B, read as coordinates of A, stand for: closest points of A."""
    a = setup.other
    origin = a.vertices[0] - coordinates(a)[0] * a.length_scale
    return project_onto_surface(a, functions * a.length_scale + origin)


def followed(setup: PairSetup, velocity: FloatArray) -> SurfacePoints:
    """The start map composed with the flow lines of fields (N, F, 3): where on A each vertex of B goes then.

    Each vertex is followed back along the flow, exactly, and what the start map makes of the place is read off
    linearly inside its face, and brought onto A.
    """
    b, a = setup.mesh, setup.other
    here = vertex_points(b, np.arange(len(b.vertices)))
    tau = setup.parameters.tau
    lines = flow_lines(b, -velocity[::-1], here, tau, tau)
    origins = SurfacePoints(
        faces=np.array([line.faces[-1] for line in lines]),
        barycentric=np.array([line.barycentric[-1] for line in lines]),
        positions=np.array([line.positions[-1] for line in lines]),
        distances=here.distances,
    )
    return project_onto_surface(a, pull_back(b, origins, setup.start.positions))
