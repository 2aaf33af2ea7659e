"""Figure 5: the smoothest field that commutes with a given one."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh_tridiagonal

from abfm.calculus.commuting_fields import commuting_fields, relative_bracket
from abfm.calculus.operators import face_areas, hodge_laplacian
from abfm.calculus.vector_fields import to_frame
from abfm.experiments import given_flow as given
from abfm.experiments.experiment import Experiment, Findings, Measure, Report
from abfm.experiments.meshes import gourd, gourd_radius, torus
from abfm.experiments.sheet import Panel, Sheet, Streaks
from abfm.flow.flow import Flow
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

_SPEED = 0.25  # of v, in sqrt(area) per unit of time
_OTHERS = 8  # smooth fields to compare the bracket with


@dataclass(frozen=True, eq=False)
class Commuting(given.Case):
    """A field, and where it is known the field ``u`` that commutes with it and its roughness."""

    u: FloatArray | None = None
    roughness: float = np.nan


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> given.GivenFields[Commuting]:
    """Rotations of two surfaces of revolution; on another mesh, a field that stirs it."""
    if mesh is not None:
        stirred = Commuting("", mesh, given.with_speed(mesh, given.stirring(mesh, 1), _SPEED))
        return given.GivenFields.on(((stirred,),), "mesh")
    sizes = (1, 2) if small else (1, 2, 4)
    cases = (tuple(_on_gourd(6 * k) for k in sizes), tuple(_on_torus(24 * k) for k in sizes))
    return given.GivenFields.on(cases, cases[0][-1].name)


def _rotation(mesh: TriangleMesh) -> FloatArray:
    return given.with_speed(mesh, given.tangent(mesh, np.cross([0.0, 1.0, 0.0], given.centres(mesh))), _SPEED)


def _on_torus(n: int) -> Commuting:
    """The rotation commutes with the harmonic field around the tube, the smoothest of all that are orthogonal to it."""
    mesh = torus(n, n // 2)
    x, y, z = given.centres(mesh).T
    ring = np.hypot(x, z)
    around = np.stack([-y * x / ring, ring - 1, -y * z / ring], axis=1)
    around /= np.linalg.norm(around, axis=1)[:, None] * ring[:, None]
    return Commuting("torus", mesh, _rotation(mesh), given.tangent(mesh, around), 0.0)


def _on_gourd(frequency: int) -> Commuting:
    """The rotation commutes with the gradient of the first eigenfunction that is constant along the circles."""
    mesh = gourd(frequency)
    polar, slope, roughness = _first_on_meridian()
    points = given.centres(mesh)
    angle = np.arccos(points[:, 1] / np.linalg.norm(points, axis=1))
    u = _along_meridian(points, angle) * np.interp(angle, polar, slope)[:, None]
    return Commuting("surface of revolution", mesh, _rotation(mesh), given.tangent(mesh, u), roughness)


def _along_meridian(points: FloatArray, angle: FloatArray) -> FloatArray:
    """Unit tangents of the gourd's meridians, away from the upper pole."""
    step = 1e-5
    radius, growth = gourd_radius(angle), (gourd_radius(angle + step) - gourd_radius(angle - step)) / (2 * step)
    out = radius * np.cos(angle) + growth * np.sin(angle)
    up = growth * np.cos(angle) - radius * np.sin(angle)
    ring = np.hypot(points[:, 0], points[:, 2])
    vectors = np.stack([out * points[:, 0] / ring, up, out * points[:, 2] / ring], axis=1)
    along: FloatArray = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    return along


def _first_on_meridian(count: int = 4000) -> tuple[FloatArray, FloatArray, float]:
    """The gourd's eigenfunction as above, by finite volumes: angles (count + 1,), its slopes, eigenvalue times area."""
    polar = np.linspace(0, np.pi, 2 * count + 1)
    radius = gourd_radius(polar)
    ring, height = radius * np.sin(polar), radius * np.cos(polar)
    lengths = np.hypot(np.diff(ring), np.diff(height))
    cells = ring[1::2] * (lengths[::2] + lengths[1::2])  # their areas over 2 pi
    gaps = lengths[1:-1:2] + lengths[2::2]  # between the cells' middles
    fluxes = ring[2:-1:2] / gaps
    diagonal = (np.append(fluxes, 0) + np.append(0, fluxes)) / cells
    values, vectors = eigh_tridiagonal(
        diagonal, -fluxes / np.sqrt(cells[1:] * cells[:-1]), select="i", select_range=(1, 1)
    )
    slopes = np.diff(vectors[:, 0] / np.sqrt(cells)) / gaps
    return polar[::2], np.concatenate([[0.0], slopes, [0.0]]), float(values[0] * 2 * np.pi * cells.sum())


def run(setup: given.GivenFields[Commuting], report: Report) -> Findings:
    """Find the smoothest commuting fields, and compare them with the known ones."""
    measures: list[Measure] = []
    rows = []
    for levels in setup.told(report):
        found = [(case, commuting_fields(case.mesh, case.v)[0]) for case in levels]
        measures += _measures(setup.title(found[0][0]), found)
        case, u = found[-1]
        v_panel = Panel(case.mesh, _streaks(case, case.v), "v", "field")
        rows.append((v_panel, Panel(case.mesh, _streaks(case, u), "u", "result")))
    known = setup.cases[0][0].u is not None
    kind = "the rotation about the axis" if known else "the turned gradient of eigenfunction 1"
    setting = (
        f"{setup.sizes}. v is {kind}; u is orthogonal to v in L2 and minimises its Hodge energy plus the squared "
        "bracket, weighted by sqrt(area) over the edge length. Bracket norms are sqrt(area) |[v, u]| / (|v| |u|), of "
        "root mean squares."
    )
    return Findings(measures, Sheet(tuple(rows)), setting)


def _streaks(case: Commuting, field: FloatArray) -> Streaks:
    """Where ``u`` may be a multiple of ``v`` from place to place, streaks differ only by the speed."""
    return Streaks(field) if case.u is not None else Streaks(field, given.speed(case.mesh, field), "speed")


def _measures(name: str, levels: list[tuple[Commuting, FloatArray]]) -> list[Measure]:
    case, u = levels[-1]
    mesh, v = case.mesh, case.v
    brackets = [relative_bracket(level.mesh, level.v, field) for level, field in levels]
    errors = [_distance(level.mesh, field, level.u) for level, field in levels if level.u is not None]
    others = commuting_fields(mesh, v, min(_OTHERS, len(mesh.faces)), weight=0)
    usual = float(np.median([relative_bracket(mesh, v, w) for w in others]))
    commutes = brackets[-1] < 0.1 * usual
    found = [
        Measure(f"{name}: bracket norm relative to both fields", brackets[-1], "u commutes with v", commutes),
        Measure(f"{name}: the same, median of the {len(others)} smoothest fields orthogonal to v", usual),
        Measure(f"{name}: distance of the ends when the two flows are exchanged, over the way", _exchanged(mesh, v, u)),
        Measure(f"{name}: roughness of u, squared div and curl times area over squared norm", _roughness(mesh, u)),
    ]
    if len(levels) > 1:
        order = np.log2(brackets[-2] / brackets[-1])
        found.append(Measure(f"{name}: order of the bracket norm in the edge length", order))
    if errors:
        claim = "u is the smoothest field that commutes with v"
        found += [
            Measure(f"{name}: relative L2 error against the exact u", errors[-1], claim, errors[-1] < 0.1),
            Measure(f"{name}: order of that error", np.log2(errors[-2] / errors[-1])),
            Measure(f"{name}: roughness of the exact u", case.roughness),
        ]
    return found


def _distance(mesh: TriangleMesh, u: FloatArray, exact: FloatArray) -> float:
    """Relative L2 error of a field that is determined up to a factor."""
    scaled, found = (given.with_speed(mesh, field, _SPEED) for field in (exact, u))
    return min(given.relative_norm(mesh, found - signed, signed) for signed in (scaled, -scaled))


def _roughness(mesh: TriangleMesh, u: FloatArray) -> float:
    areas = face_areas(mesh)
    coefficients = to_frame(mesh, u).ravel()
    energy = float(coefficients @ (hodge_laplacian(mesh) @ coefficients))
    return energy * float(areas.sum()) / float(areas @ (u**2).sum(axis=1))


def _exchanged(mesh: TriangleMesh, v: FloatArray, u: FloatArray) -> float:
    """Root mean square distance between first v then u and first u then v, over that from the start."""
    along_v, along_u = Flow(mesh, v), Flow(mesh, u)
    one, other = along_u.advect(along_v.advect(mesh.vertices)), along_v.advect(along_u.advect(mesh.vertices))
    return float(np.linalg.norm(one - other) / np.linalg.norm(one - mesh.vertices))


EXPERIMENT = Experiment(
    5, "The kernel of ad_v consists of many fields that commute with v, of which the smoothest is shown.", set_up, run
)
