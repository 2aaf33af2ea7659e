"""Figure 6: a field carried along the flow of another (the pushforward)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from abfm.calculus.operators import averaging, vertex_areas
from abfm.calculus.vector_fields import directional_derivative, pushforward, to_frame
from abfm.errors import AdvectionError, MeshError
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup
from abfm.experiments.given_fields import (
    carried_bump,
    centres,
    relative_error,
    relative_norm,
    stirring,
    tangent,
    with_speed,
)
from abfm.experiments.meshes import geodesic_sphere, torus
from abfm.experiments.sheet import Panel, Sheet, Streaks
from abfm.flow.flow import Flow
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray

_TURN = np.pi  # radians per unit of time
_SPEEDS = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125)  # to try without a symmetry: sqrt(area) per unit of time
_MOST_STRETCHED = 2.0
_SHOWN = (0.125, 0.25)  # the paper's
_LONGER = (0.5, 1.0)
_MINOR = 0.45


@dataclass(frozen=True, eq=False)
class _Case:
    """Two fields, and where it is known what the flow of ``v`` makes of ``u`` in a time."""

    name: str
    mesh: TriangleMesh
    v: FloatArray
    u: FloatArray
    exact: Callable[[float], FloatArray] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup6(Setup):
    """Surfaces with two fields each, every surface from coarse to fine."""

    cases: tuple[tuple[_Case, ...], ...]


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> Setup6:
    """Rotations of a sphere and of a torus, about its axis and around its tube."""
    cases: tuple[tuple[_Case, ...], ...]
    if mesh is None:
        sizes = (1, 2) if small else (1, 2, 4)
        cases = (
            tuple(_on_sphere(6 * k) for k in sizes),
            tuple(_on_torus(24 * k, around_tube=False) for k in sizes),
            tuple(_on_torus(24 * k, around_tube=True) for k in sizes),
        )
    else:
        cases = ((_on_any(mesh),),)
    first = cases[0][-1]
    return Setup6(
        mesh=first.mesh, name="mesh" if mesh else first.name, cases=cases, **carried_bump(first.mesh, first.v)
    )


def _on_sphere(frequency: int) -> _Case:
    """The rotation about the y axis carries a field by turning it."""
    mesh = geodesic_sphere(frequency)
    points = centres(mesh)

    def turned(time: float) -> FloatArray:
        turn = Rotation.from_rotvec([0.0, _TURN * time, 0.0])
        return tangent(mesh, turn.apply(_swirls(turn.inv().apply(points))))

    v = tangent(mesh, _TURN * np.cross([0.0, 1.0, 0.0], points))
    return _Case("sphere", mesh, v, turned(0.0), turned)


def _swirls(points: FloatArray) -> FloatArray:
    """Two vortices of unlike strength, at points (n, 3) of the sphere."""
    field = np.zeros_like(points)
    for centre, strength, width in (((0.5, 0.4, 0.77), 1.0, 0.4), ((-0.2, -0.5, 0.84), -0.8, 0.4)):
        middle = np.array(centre) / np.linalg.norm(centre)
        bell = strength * np.exp((points @ middle - 1) / width**2)
        field += np.cross(middle, points) * bell[:, None]
    return field


def _on_torus(n: int, around_tube: bool) -> _Case:
    """Turning about the axis, an isometry, or around the tube, none: in the angles both move the components along."""
    mesh = torus(n, n // 2, 1.0, _MINOR)
    x, y, z = centres(mesh).T
    ring = np.hypot(x, z)
    about, around = np.arctan2(x, z), np.arctan2(y, ring - 1)
    # the coordinate fields of both angles, at the face centres
    by_about = np.stack([z, np.zeros_like(z), -x], axis=1)
    by_around = np.stack([-y * x / ring, ring - 1, -y * z / ring], axis=1)

    def moved(time: float) -> FloatArray:
        p, q = (about, around - _TURN * time) if around_tube else (about - _TURN * time, around)
        bell = np.exp((np.cos(p) + np.cos(q - 0.9) - 2) / 0.6)
        a, b = -bell * np.sin(q - 0.9), bell * np.sin(p)
        return tangent(mesh, a[:, None] * by_about + b[:, None] * by_around)

    v = tangent(mesh, _TURN * (by_around if around_tube else by_about))
    return _Case(f"torus, {'around the tube' if around_tube else 'about the axis'}", mesh, v, moved(0.0), moved)


def _on_any(mesh: TriangleMesh) -> _Case:
    """A field that stirs the surface, with the next one: as fast as the pushforward, unstable on bad faces, stands.

    Raises
    ------
    MeshError
        If it grows without bounds for all fields and speeds that are tried.
    """
    fields = [with_speed(mesh, stirring(mesh, index), 1.0) for index in (1, 2, 3)]
    for speed in _SPEEDS:
        for v, u in pairwise(fields):
            with suppress(AdvectionError), np.errstate(over="ignore"):
                if relative_norm(mesh, pushforward(mesh, speed * v, u, _SHOWN[-1]), u) < _MOST_STRETCHED:
                    return _Case(f"|v| = {speed:g} sqrt(area)", mesh, speed * v, u)
    raise MeshError("the discrete pushforward grows without bounds on this mesh: remesh its thin and folded faces")


def run(setup: Setup6, report: Report) -> Findings:
    """Carry the fields, and compare them with the exact answers."""
    measures: list[Measure] = []
    rows = []
    seen: list[FloatArray] = []
    known = setup.cases[0][0].exact is not None
    alone = setup.cases[0][0]
    cases = setup.cases if known else ((replace(alone, name=f"{setup.name}, {alone.name}"),),)
    total = sum(len(levels) for levels in cases)
    done = 0
    for levels in cases:
        errors = []
        for case in levels:
            report(f"{case.name}, {len(case.mesh.vertices):,} vertices", done / total)
            if case.exact is not None:
                errors.append([_error(case, t) for t in (*_SHOWN, *_LONGER)])
            done += 1
        carried = [pushforward(case.mesh, case.v, case.u, t) for t in _SHOWN]
        measures += _against_exact(case, errors) if errors else _against_functions(case, carried)
        seen = seen or [_speed(case.mesh, w) for w in (case.u, carried[-1])]
        rows.append(
            (
                Panel(case.mesh, Streaks(case.v), "v", "field"),
                Panel(case.mesh, Streaks(case.u, _speed(case.mesh, case.u), "speed"), "u", "source"),
                *(
                    Panel(case.mesh, Streaks(w, _speed(case.mesh, w), "speed"), f"u, carried to t = {t:g}", "result")
                    for t, w in zip(_SHOWN, carried, strict=True)
                ),
            )
        )
    sizes = "; ".join(
        f"{levels[-1].name}, {', '.join(f'{len(case.mesh.vertices):,}' for case in levels)} vertices"
        for levels in cases
    )
    turns = (
        "v turns by half a turn in t = 1"
        if known
        else "v and u are the turned gradients of two successive eigenfunctions"
    )
    setting = f"{sizes}. {turns}. The pushforward is exp(-t ad_v) u."
    return Findings(tuple(measures), Sheet(tuple(rows), seen=tuple(seen)), setting)


def _speed(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Length of a field at the vertices, (V,)."""
    return np.asarray(averaging(mesh) @ np.linalg.norm(field, axis=1))


def _error(case: _Case, time: float) -> float:
    assert case.exact is not None
    return relative_error(case.mesh, pushforward(case.mesh, case.v, case.u, time), case.exact(time))


def _against_exact(case: _Case, errors: list[list[float]]) -> list[Measure]:
    assert case.exact is not None
    claim = "exp(t ad_v) is the pushforward (Eq. 12)"
    found = [
        Measure(f"{case.name}: relative L2 error at t = {t:g}", error)
        for t, error in zip((*_SHOWN, *_LONGER), errors[-1], strict=True)
    ]
    orders = np.log2(np.divide(errors[-2], errors[-1]))
    transports = "the pushforward transports u over the flow lines of v"
    for t, order in zip(_SHOWN, orders, strict=False):
        name = f"{case.name}: order in the edge length at t = {t:g}"
        found.append(Measure(name, float(order), None, transports, bool(order > 0.5)))
    for t, error in zip(_SHOWN, errors[-1], strict=False):
        printed = relative_error(case.mesh, pushforward(case.mesh, case.v, case.u, -t), case.exact(t))
        name = f"{case.name}: relative L2 error at t = {t:g} with the printed sign"
        found.append(Measure(name, printed, None, claim, printed < 2 * error))
    return found


def _against_functions(case: _Case, carried: list[FloatArray]) -> list[Measure]:
    """What holds on any surface: carried fields derive carried functions as the fields derive the functions."""
    found = []
    for t, field in zip(_SHOWN, carried, strict=True):
        ours, printed = (_derivative_error(case, t, w) for w in (field, pushforward(case.mesh, case.v, case.u, -t)))
        text = f"relative L2 error of D_w x' against (D_u x)' at t = {t:g}, x the coordinates, ' and w carried"
        claim = "exp(t ad_v) is the pushforward (Eq. 12)"
        found.append(Measure(f"{case.name}: {text}", ours))
        found.append(Measure(f"{case.name}: {text}, with the printed sign", printed, None, claim, printed < 2 * ours))
        same = relative_error(case.mesh, pushforward(case.mesh, case.v, case.v, t), case.v)
        found.append(Measure(f"{case.name}: relative L2 error of v carried along itself at t = {t:g}", same))
    return found


def _derivative_error(case: _Case, time: float, field: FloatArray) -> float:
    mesh, places = case.mesh, case.mesh.vertices

    def carried(functions: FloatArray) -> FloatArray:
        return Flow(mesh, case.v).push(functions, time)

    derived = directional_derivative(mesh, to_frame(mesh, field)) @ carried(places)
    expected = carried(directional_derivative(mesh, to_frame(mesh, case.u)) @ places)
    areas = vertex_areas(mesh)
    squares = [float(areas @ (w**2).sum(axis=1)) for w in (derived - expected, expected)]
    return float(np.sqrt(squares[0] / squares[1]))


EXPERIMENT = Experiment(
    6,
    "exp(t ad_v) transports a field u over the flow lines of v, here to t = 0.125 and 0.25.",
    set_up,
    run,
)
