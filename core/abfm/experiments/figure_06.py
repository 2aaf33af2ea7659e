"""Figure 6: a field transported along the flow of another field (pushforward)."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from abfm import AdvectionError, Flow, MeshError, TriangleMesh
from abfm.calculus import directional_derivative, l2_norm, pushforward, to_frame
from abfm.experiments import fields
from abfm.experiments.scripts import FigureSetup, Findings, Measure, Script
from abfm.io.sheets import Panel, Sheet, Streaks
from abfm.mesh.shapes import geodesic_sphere
from abfm.types import FloatArray

_ANGULAR_SPEED = np.pi  # radians per unit of time
# speeds of v that are tried on a given mesh, in sqrt(area) per unit of time
_SPEEDS = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125)
_STRETCH_MAX = 2.0  # largest factor by which the flow may change the norm of u
_TIMES = (0.125, 0.25)  # times in the paper
_MORE_TIMES = (0.5, 1.0)
_PUSHFORWARD = "exp(t ad_v) is the pushforward (Eq. 12)"


@dataclass(frozen=True, eq=False)
class Case(fields.Case):
    """A surface with fields ``v`` and ``u``, and, if known, the exact pushforward at any time."""

    u: FloatArray
    exact: Callable[[float], FloatArray] | None = None

    def pushed(self, t: float) -> FloatArray:
        return pushforward(self.mesh, self.v, self.u, t)

    def error(self, field: FloatArray, t: float) -> float:
        assert self.exact is not None
        expected = self.exact(t)
        return fields.relative_norm(self.mesh, field - expected, expected)


def figure_6(setup: FigureSetup) -> Script:
    """Push fields forward along rotations of a sphere and a torus, or along a field of a mesh."""
    if setup.mesh is None:
        surfaces, name = known_cases((1, 2) if setup.small else (1, 2, 4)), "sphere"
        motion = "v rotates by 180 degrees in t = 1"
    else:
        surfaces, name = [[on_any(setup.mesh, setup.name)]], setup.name
        motion = "v and u are the rotated gradients of two consecutive eigenfunctions"
    first = surfaces[0][-1]
    yield fields.field_example(first, name)

    measures: list[Measure] = []
    rows = []
    for number, levels in enumerate(surfaces):
        case, mesh = levels[-1], levels[-1].mesh
        setup.report(fields.sizes_text(levels), number / len(surfaces))
        pushed = {t: case.pushed(t) for t in _TIMES}
        measures += against_exact(levels) if case.exact else against_functions(case, pushed)
        results = (
            Panel(mesh, fields.speed_streaks(mesh, w), f"u, pushed to t = {t:g}", "result")
            for t, w in pushed.items()
        )
        v_panel = Panel(mesh, Streaks(case.v), "v", "field")
        rows.append(
            (v_panel, Panel(mesh, fields.speed_streaks(mesh, case.u), "u", "source"), *results)
        )
    view_functions = tuple(fields.speed(first.mesh, w) for w in (first.u, first.pushed(_TIMES[-1])))
    sizes = "; ".join(map(fields.sizes_text, surfaces))
    setting = f"{sizes}. {motion}. The pushforward is exp(-t ad_v) u."
    return Findings(measures, Sheet(tuple(rows), view_functions=view_functions), setting)


def against_exact(levels: Sequence[Case]) -> list[Measure]:
    """Measure the error of the pushforward against the exact one, on the two finest meshes."""
    name, transports = levels[-1].name, "the pushforward transports u over the flow lines of v"
    coarse, fine = (
        [case.error(case.pushed(t), t) for t in (*_TIMES, *_MORE_TIMES)] for case in levels[-2:]
    )
    of_error = f"{name}: relative L2 error at t ="
    measures = [
        Measure(f"{of_error} {t:g}", x) for t, x in zip((*_TIMES, *_MORE_TIMES), fine, strict=True)
    ]
    for t, order in zip(_TIMES, np.log2(np.divide(coarse, fine)), strict=False):
        text = f"{name}: order in the edge length at t = {t:g}"
        measures.append(Measure(text, order, transports, order > 0.5))
    for t, error in zip(_TIMES, fine, strict=False):
        x = levels[-1].error(levels[-1].pushed(-t), t)
        text = f"{of_error} {t:g} with the printed sign"
        measures.append(Measure(text, x, _PUSHFORWARD, x < 2 * error))
    return measures


def against_functions(case: Case, pushed: dict[float, FloatArray]) -> list[Measure]:
    """Compare derivatives of advected coordinates with advected derivatives of coordinates.

    The latter are derivatives along ``u``, advected along ``v``. They should equal the derivatives
    of the advected coordinates along the pushforward of ``u``, which ``pushed`` has for each time.
    """
    mesh, places, flow = case.mesh, case.mesh.vertices, Flow(case.mesh, case.v)
    measures = []
    for t, field in pushed.items():
        expected = flow.push(directional_derivative(mesh, to_frame(mesh, case.u)) @ places, t)
        after = flow.push(places, t)
        derived = (
            directional_derivative(mesh, to_frame(mesh, w)) @ after
            for w in (field, case.pushed(-t))
        )
        ours, printed = (l2_norm(mesh, x - expected) / l2_norm(mesh, expected) for x in derived)
        text = (
            f"{case.name}: relative L2 error of D_w x' against (D_u x)' at t = {t:g}, with "
            "coordinates x, pushed field w and advected functions '"
        )
        itself = f"{case.name}: relative L2 error of v pushed along itself at t = {t:g}"
        same = pushforward(mesh, case.v, case.v, t)
        measures += [
            Measure(text, ours),
            Measure(f"{text}, with the printed sign", printed, _PUSHFORWARD, printed < 2 * ours),
            Measure(itself, fields.relative_norm(mesh, same - case.v, case.v)),
        ]
    return measures


def known_cases(sizes: Sequence[int]) -> list[list[Case]]:
    return [
        [on_sphere(6 * k) for k in sizes],
        [on_torus(24 * k, around_tube=False) for k in sizes],
        [on_torus(24 * k, around_tube=True) for k in sizes],
    ]


def on_sphere(frequency: int) -> Case:
    """Return a sphere with its rotation about the y axis and a field of two different vortices."""
    mesh = geodesic_sphere(frequency)
    points = fields.face_centres(mesh)

    def exact(time: float) -> FloatArray:
        turn = Rotation.from_rotvec([0.0, _ANGULAR_SPEED * time, 0.0])
        back = turn.inv().apply(points)
        field = np.zeros_like(points)
        for direction, strength in (((0.5, 0.4, 0.77), 1.0), ((-0.2, -0.5, 0.84), -0.8)):
            centre = np.array(direction) / np.linalg.norm(direction)
            bell = strength * np.exp((back @ centre - 1) / 0.4**2)
            field += np.cross(centre, back) * bell[:, None]
        return fields.tangential_part(mesh, turn.apply(field))

    v = fields.tangential_part(mesh, _ANGULAR_SPEED * np.cross([0.0, 1.0, 0.0], points))
    return Case("sphere", mesh, v, exact(0.0), exact)


def on_torus(n: int, around_tube: bool) -> Case:
    """Return a torus rotated about its axis (an isometry) or around the tube (not one)."""
    mesh, ring, by_about, by_around = fields.angular_torus(n)
    x, y, z = fields.face_centres(mesh).T
    about, around = np.arctan2(x, z), np.arctan2(y, ring - 1)

    def exact(time: float) -> FloatArray:
        turned = _ANGULAR_SPEED * time
        p, q = (about, around - turned) if around_tube else (about - turned, around)
        bell = np.exp((np.cos(p) + np.cos(q - 0.9) - 2) / 0.6)
        a, b = -bell * np.sin(q - 0.9), bell * np.sin(p)
        return fields.tangential_part(mesh, a[:, None] * by_about + b[:, None] * by_around)

    v = fields.tangential_part(mesh, _ANGULAR_SPEED * (by_around if around_tube else by_about))
    name = f"torus, {'around the tube' if around_tube else 'about the axis'}"
    return Case(name, mesh, v, exact(0.0), exact)


def on_any(mesh: TriangleMesh, name: str) -> Case:
    """Return a mesh with two rotated gradients of eigenfunctions as fields.

    The first field has the highest tried speed for which the pushforward of the second field is
    stable. Raise a MeshError if no speed is stable.
    """
    stirring_field = [fields.stirring_field(mesh, k, 1.0) for k in (1, 2, 3)]
    for speed in _SPEEDS:
        for v, u in pairwise(stirring_field):
            with suppress(AdvectionError), np.errstate(over="ignore"):
                pushed = pushforward(mesh, speed * v, u, _TIMES[-1])
                if fields.relative_norm(mesh, pushed, u) < _STRETCH_MAX:
                    return Case(f"{name}, |v| = {speed:g} sqrt(area)", mesh, speed * v, u)
    raise MeshError(
        "the discrete pushforward is unbounded on this mesh; remesh its thin and folded faces"
    )
