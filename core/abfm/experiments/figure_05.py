"""Figure 5: the smoothest field that commutes with a given one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh_tridiagonal

from abfm import Flow, TriangleMesh
from abfm.calculus import commuting_fields, face_areas, hodge_laplacian, relative_bracket, to_frame
from abfm.experiments import fields
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage
from abfm.io.sheets import Panel, Sheet, Streaks
from abfm.mesh.shapes import gourd, gourd_radius
from abfm.types import FloatArray

CLAIM = (
    "The kernel of ad_v consists of many fields that commute with v, of which the smoothest is "
    "shown."
)

_SPEED = 0.25  # of v, in sqrt(area) per unit of time
_OTHERS = 8  # smooth fields to compare the bracket with


@dataclass(frozen=True, eq=False)
class Case(fields.Case):
    """Where it is known, with the ``u`` that commutes with the field, and the roughness of that."""

    u: FloatArray | None = None
    roughness: float = np.nan


def figure(stage: Stage) -> Script:
    """Find the smoothest fields that commute with rotations, or with a field that stirs a mesh."""
    if stage.mesh is None:
        surfaces = known_cases((1, 2) if stage.small else (1, 2, 4))
        kind = "the rotation about the axis"
    else:
        v = fields.stirring(stage.mesh, 1, _SPEED)
        surfaces, kind = (
            [[Case(stage.name, stage.mesh, v)]],
            "the turned gradient of eigenfunction 1",
        )
    yield fields.field_example(surfaces[0][-1], surfaces[0][-1].name)

    measures: list[Measure] = []
    rows = []
    for number, levels in enumerate(surfaces):
        case = levels[-1]
        stage.report(fields.refined(levels), number / len(surfaces))
        found = [commuting_fields(level.mesh, level.v)[0] for level in levels]
        measures += measured(levels, found)
        # where u may be a multiple of v from place to place, with its speed
        paint = fields.coloured if case.u is None else lambda mesh, field: Streaks(field)
        v_panel = Panel(case.mesh, paint(case.mesh, case.v), "v", "field")
        rows.append((v_panel, Panel(case.mesh, paint(case.mesh, found[-1]), "u", "result")))
    setting = (
        f"{'; '.join(map(fields.refined, surfaces))}. v is {kind}; u is "
        "orthogonal to v in L2 and minimises its Hodge energy plus the squared bracket, weighted "
        "by sqrt(area) over the edge length. Bracket norms are sqrt(area) |[v, u]| / (|v| |u|), of "
        "root mean squares."
    )
    return Findings(measures, Sheet(tuple(rows)), setting)


def measured(levels: Sequence[Case], found: Sequence[FloatArray]) -> list[Measure]:
    """Measure the fields that were found on a surface, coarse to fine."""
    case, u = levels[-1], found[-1]
    name, mesh, v = case.name, case.mesh, case.v
    pairs = list(zip(levels, found, strict=True))
    brackets = [relative_bracket(level.mesh, level.v, w) for level, w in pairs]
    others = commuting_fields(mesh, v, min(_OTHERS, len(mesh.faces)), weight=0)
    usual = float(np.median([relative_bracket(mesh, v, w) for w in others]))
    commutes, same = brackets[-1] < 0.1 * usual, f"{name}: the same, median of the {len(others)}"
    bracket = f"{name}: bracket norm relative to both fields"
    exchange = f"{name}: distance of the ends when the two flows are exchanged, over the way"
    rough = f"{name}: roughness of u, squared div and curl times area over squared norm"
    areas, coefficients = face_areas(mesh), to_frame(mesh, u).ravel()
    energy = float(coefficients @ (hodge_laplacian(mesh) @ coefficients))
    measures = [
        Measure(bracket, brackets[-1], "u commutes with v", commutes),
        Measure(f"{same} smoothest fields orthogonal to v", usual),
        Measure(exchange, exchanged(mesh, v, u)),
        Measure(rough, energy * float(areas.sum()) / float(areas @ (u**2).sum(axis=1))),
    ]
    errors = [distance(level.mesh, w, level.u) for level, w in pairs if level.u is not None]
    if errors:
        order = np.log2(brackets[-2] / brackets[-1])
        exact, claim = f"{name}: relative L2 error against the exact u", "u is the smoothest field"
        measures += [
            Measure(f"{name}: order of the bracket norm in the edge length", order),
            Measure(exact, errors[-1], f"{claim} that commutes with v", errors[-1] < 0.1),
            Measure(f"{name}: order of that error", np.log2(errors[-2] / errors[-1])),
            Measure(f"{name}: roughness of the exact u", case.roughness),
        ]
    return measures


def distance(mesh: TriangleMesh, u: FloatArray, exact: FloatArray) -> float:
    """Return the relative L2 error of a field that is determined up to a factor."""
    scaled, found = (fields.with_speed(mesh, field, _SPEED) for field in (exact, u))
    return min(fields.relative_norm(mesh, found - signed, signed) for signed in (scaled, -scaled))


def exchanged(mesh: TriangleMesh, v: FloatArray, u: FloatArray) -> float:
    """Return how far first v then u ends from first u then v, over the way, in RMS."""
    x, along_v, along_u = mesh.vertices, Flow(mesh, v), Flow(mesh, u)
    one, other = along_u.push(along_v.push(x)), along_v.push(along_u.push(x))
    return float(np.linalg.norm(one - other) / np.linalg.norm(one - x))


def known_cases(sizes: Sequence[int]) -> list[list[Case]]:
    """Return rotations of two surfaces of revolution, each from coarse to fine."""
    return [[on_gourd(6 * k) for k in sizes], [on_torus(24 * k) for k in sizes]]


def rotation(mesh: TriangleMesh) -> FloatArray:
    """Return the rotation about the y axis, (F, 3)."""
    around = np.cross([0.0, 1.0, 0.0], fields.centres(mesh))
    return fields.with_speed(mesh, fields.tangent(mesh, around), _SPEED)


def on_torus(n: int) -> Case:
    """Return a torus' rotation: it commutes with the harmonic field around the tube."""
    mesh, ring, _, around = fields.angular_torus(n)
    around /= np.linalg.norm(around, axis=1)[:, None] * ring[:, None]
    return Case("torus", mesh, rotation(mesh), fields.tangent(mesh, around), 0.0)


def on_gourd(frequency: int) -> Case:
    """Return a gourd's: it commutes with the first eigenfunction's gradient along meridians."""
    mesh = gourd(frequency)
    polar, slope, rough = first_on_meridian()
    x, y, z = points = fields.centres(mesh).T
    angle = np.arccos(y / np.linalg.norm(points.T, axis=1))
    # unit tangents of the meridians, away from the upper pole
    step, radius, ring = 1e-5, gourd_radius(angle), np.hypot(x, z)
    growth = (gourd_radius(angle + step) - gourd_radius(angle - step)) / (2 * step)
    out = radius * np.cos(angle) + growth * np.sin(angle)
    up = growth * np.cos(angle) - radius * np.sin(angle)
    along = np.stack([out * x / ring, up, out * z / ring], axis=1)
    along /= np.linalg.norm(along, axis=1)[:, None]
    u = along * np.interp(angle, polar, slope)[:, None]
    return Case("surface of revolution", mesh, rotation(mesh), fields.tangent(mesh, u), rough)


def first_on_meridian(count: int = 4000) -> tuple[FloatArray, FloatArray, float]:
    """Solve for that by finite volumes: angles (count + 1,), slopes, eigenvalue times area."""
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
    rough = float(values[0] * 2 * np.pi * cells.sum())
    return polar[::2], np.concatenate([[0.0], slopes, [0.0]]), rough
