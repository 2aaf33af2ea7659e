"""Figure 5: the smoothest field that commutes with a given field."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh_tridiagonal

from abfm import Flow, TriangleMesh
from abfm.calculus import commuting_fields, face_areas, hodge_laplacian, relative_bracket, to_frame
from abfm.experiments import fields
from abfm.experiments.scripts import FigureSetup, Findings, Measure, Script
from abfm.io.sheets import Panel, Sheet, Streaks
from abfm.mesh.shapes import gourd, gourd_radius
from abfm.types import FloatArray

_SPEED = 0.25  # root mean square of v, in sqrt(area) per unit of time
_COMPARED_FIELDS = 8  # number of the smoothest fields whose brackets are compared with that of u


@dataclass(frozen=True, eq=False)
class Case(fields.Case):
    """A surface with a field ``v`` and, if known, the commuting field ``u`` and its roughness."""

    u: FloatArray | None = None
    roughness: float = np.nan


def figure_5(setup: FigureSetup) -> Script:
    """Find the smoothest field that commutes with a rotation or, on a given mesh, another field."""
    if setup.mesh is None:
        surfaces = known_cases((1, 2) if setup.small else (1, 2, 4))
        kind = "rotation about the axis"
    else:
        case = Case(setup.name, setup.mesh, fields.stirring_field(setup.mesh, 1, _SPEED))
        surfaces, kind = [[case]], "rotated gradient of eigenfunction 1"
    yield fields.field_example(surfaces[0][-1], surfaces[0][-1].name)

    measures: list[Measure] = []
    rows = []
    for number, levels in enumerate(surfaces):
        case = levels[-1]
        name, mesh, v = case.name, case.mesh, case.v
        setup.report(fields.sizes_text(levels), number / len(surfaces))
        found = [(level, commuting_fields(level.mesh, level.v)[0]) for level in levels]
        u = found[-1][1]
        brackets = [relative_bracket(level.mesh, level.v, w) for level, w in found]
        others = commuting_fields(mesh, v, min(_COMPARED_FIELDS, len(mesh.faces)), weight=0)
        median_bracket = float(np.median([relative_bracket(mesh, v, w) for w in others]))
        # distance between the points after the flow of v, then u, and after that of u, then v
        x, along_v, along_u = mesh.vertices, Flow(mesh, v), Flow(mesh, u)
        v_then_u, u_then_v = along_u.push(along_v.push(x)), along_v.push(along_u.push(x))
        exchanged = float(np.linalg.norm(v_then_u - u_then_v) / np.linalg.norm(v_then_u - x))
        areas, coefficients = face_areas(mesh), to_frame(mesh, u).ravel()
        energy = float(coefficients @ (hodge_laplacian(mesh) @ coefficients))
        roughness_of_u = energy * float(areas.sum()) / float(areas @ (u**2).sum(axis=1))
        of_bracket, commutes = "bracket norm relative to both fields", "u commutes with v"
        of_usual = f"median bracket norm of the {len(others)} smoothest fields orthogonal to v"
        exchange = (
            "distance of the ends when the two flows are exchanged, relative to the displacement"
        )
        roughness = "roughness of u, squared div and curl times area over squared norm"
        measures += [
            Measure(
                f"{name}: {of_bracket}", brackets[-1], commutes, brackets[-1] < 0.1 * median_bracket
            ),
            Measure(f"{name}: {of_usual}", median_bracket),
            Measure(f"{name}: {exchange}", exchanged),
            Measure(f"{name}: {roughness}", roughness_of_u),
        ]
        if errors := [distance(c.mesh, w, c.u) for c, w in found if c.u is not None]:
            order, of_errors = (np.log2(x[-2] / x[-1]) for x in (brackets, errors))
            exact, claim = f"{name}: relative L2 error against the exact u", "u is the smoothest"
            reproduces = errors[-1] < 0.1
            measures += [
                Measure(f"{name}: order of the bracket norm in the edge length", order),
                Measure(exact, errors[-1], f"{claim} field that commutes with v", reproduces),
                Measure(f"{name}: order of the error against the exact u", of_errors),
                Measure(f"{name}: roughness of the exact u", case.roughness),
            ]
        # without colours for speed if u is known, because the speed is only informative on a given
        # mesh
        paint = fields.speed_streaks if case.u is None else lambda mesh, field: Streaks(field)
        v_panel = Panel(mesh, paint(mesh, v), "v", "field")
        rows.append((v_panel, Panel(mesh, paint(mesh, u), "u", "result")))
    setting = (
        f"{'; '.join(map(fields.sizes_text, surfaces))}. v is the {kind}. u is "
        "orthogonal to v in L2. It minimises its Hodge energy plus the squared bracket, weighted "
        "by sqrt(area) over the edge length. Bracket norms are sqrt(area) |[v, u]| / (|v| |u|), of "
        "root mean squares."
    )
    return Findings(measures, Sheet(tuple(rows)), setting)


def distance(mesh: TriangleMesh, u: FloatArray, exact: FloatArray) -> float:
    """Return the relative L2 difference of ``u`` and ``exact``, scaled to one norm and sign."""
    scaled, found = (fields.with_speed(mesh, field, _SPEED) for field in (exact, u))
    return min(fields.relative_norm(mesh, found - signed, signed) for signed in (scaled, -scaled))


def known_cases(sizes: Sequence[int]) -> list[list[Case]]:
    return [[on_gourd(6 * k) for k in sizes], [on_torus(24 * k) for k in sizes]]


def rotation(mesh: TriangleMesh) -> FloatArray:
    around = np.cross([0.0, 1.0, 0.0], fields.face_centres(mesh))
    return fields.with_speed(mesh, fields.tangential_part(mesh, around), _SPEED)


def on_torus(n: int) -> Case:
    """Return a torus with its rotation ``v``, and the harmonic field around the tube as ``u``."""
    mesh, ring, _, around = fields.angular_torus(n)
    around /= np.linalg.norm(around, axis=1)[:, None] * ring[:, None]
    return Case("torus", mesh, rotation(mesh), fields.tangential_part(mesh, around), 0.0)


def on_gourd(frequency: int) -> Case:
    """Return a gourd with its rotation ``v``, and the gradient of an eigenfunction as ``u``."""
    mesh = gourd(frequency)
    polar, slope, roughness_of_u = first_on_meridian()
    x, y, z = points = fields.face_centres(mesh).T
    angle = np.arccos(y / np.linalg.norm(points.T, axis=1))
    # unit tangents of the meridians, away from the upper pole
    step, radius, ring = 1e-5, gourd_radius(angle), np.hypot(x, z)
    growth = (gourd_radius(angle + step) - gourd_radius(angle - step)) / (2 * step)
    out = radius * np.cos(angle) + growth * np.sin(angle)
    up = growth * np.cos(angle) - radius * np.sin(angle)
    along = np.stack([out * x / ring, up, out * z / ring], axis=1)
    along /= np.linalg.norm(along, axis=1)[:, None]
    u = fields.tangential_part(mesh, along * np.interp(angle, polar, slope)[:, None])
    return Case("surface of revolution", mesh, rotation(mesh), u, roughness_of_u)


def first_on_meridian(count: int = 4000) -> tuple[FloatArray, FloatArray, float]:
    """Compute the first eigenfunction of the gourd that is constant on circles around its axis.

    The method is finite volumes, with ``count`` cells on the meridian. Return the angles of ``count
    + 1`` points on the meridian, the slopes there, and the eigenvalue times the area.
    """
    polar = np.linspace(0, np.pi, 2 * count + 1)
    radius = gourd_radius(polar)
    ring, height = radius * np.sin(polar), radius * np.cos(polar)
    lengths = np.hypot(np.diff(ring), np.diff(height))
    cells = ring[1::2] * (lengths[::2] + lengths[1::2])  # areas divided by 2 pi
    gaps = lengths[1:-1:2] + lengths[2::2]  # distances between cell centres
    fluxes = ring[2:-1:2] / gaps
    diagonal = (np.append(fluxes, 0) + np.append(0, fluxes)) / cells
    values, vectors = eigh_tridiagonal(
        diagonal, -fluxes / np.sqrt(cells[1:] * cells[:-1]), select="i", select_range=(1, 1)
    )
    gradient_field = np.diff(vectors[:, 0] / np.sqrt(cells)) / gaps
    roughness_of_u = float(values[0] * 2 * np.pi * cells.sum())
    return polar[::2], np.concatenate([[0.0], gradient_field, [0.0]]), roughness_of_u
