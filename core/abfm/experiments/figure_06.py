"""Figure 6: a field carried along the flow of another (the pushforward)."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from abfm import AdvectionError, Flow, MeshError, TriangleMesh
from abfm.calculus import directional_derivative, l2_norm, pushforward, to_frame
from abfm.experiments import fields
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage
from abfm.io.sheets import Panel, Sheet, Streaks
from abfm.mesh.shapes import geodesic_sphere
from abfm.types import FloatArray

_TURN = np.pi  # radians per unit of time
# to try without a symmetry: sqrt(area) per unit of time
_SPEEDS = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125)
_STRETCH_MAX = 2.0
_TIMES = (0.125, 0.25)  # the paper's times
_MORE_TIMES = (0.5, 1.0)
_PUSHFORWARD = "exp(t ad_v) is the pushforward (Eq. 12)"


@dataclass(frozen=True, eq=False)
class Case(fields.Case):
    """With a field ``u``, and where it is known what the flow makes of that in a time."""

    u: FloatArray
    exact: Callable[[float], FloatArray] | None = None

    def carried(self, t: float) -> FloatArray:
        return pushforward(self.mesh, self.v, self.u, t)

    def error(self, field: FloatArray, t: float) -> float:
        assert self.exact is not None
        expected = self.exact(t)
        return fields.relative_norm(self.mesh, field - expected, expected)


def figure_6(stage: Stage) -> Script:
    """Carry fields along rotations of a sphere and of a torus, or one that stirs a mesh."""
    if stage.mesh is None:
        surfaces, name = known_cases((1, 2) if stage.small else (1, 2, 4)), "sphere"
        turns = "v turns by half a turn in t = 1"
    else:
        surfaces, name = [[on_any(stage.mesh, stage.name)]], stage.name
        turns = "v and u are the turned gradients of two successive eigenfunctions"
    first = surfaces[0][-1]
    yield fields.field_example(first, name)

    measures: list[Measure] = []
    rows = []
    for number, levels in enumerate(surfaces):
        case, mesh = levels[-1], levels[-1].mesh
        stage.report(fields.refined(levels), number / len(surfaces))
        carried = {t: case.carried(t) for t in _TIMES}
        measures += against_exact(levels) if case.exact else against_functions(case, carried)
        results = (
            Panel(mesh, fields.coloured(mesh, w), f"u, carried to t = {t:g}", "result")
            for t, w in carried.items()
        )
        v_panel = Panel(mesh, Streaks(case.v), "v", "field")
        rows.append((v_panel, Panel(mesh, fields.coloured(mesh, case.u), "u", "source"), *results))
    seen = tuple(fields.speed(first.mesh, w) for w in (first.u, first.carried(_TIMES[-1])))
    sizes = "; ".join(map(fields.refined, surfaces))
    setting = f"{sizes}. {turns}. The pushforward is exp(-t ad_v) u."
    return Findings(measures, Sheet(tuple(rows), seen=seen), setting)


def against_exact(levels: Sequence[Case]) -> list[Measure]:
    """Compare with the exact answers on a surface, coarse to fine."""
    name, transports = levels[-1].name, "the pushforward transports u over the flow lines of v"
    coarse, fine = (
        [case.error(case.carried(t), t) for t in (*_TIMES, *_MORE_TIMES)] for case in levels[-2:]
    )
    of_error = f"{name}: relative L2 error at t ="
    measures = [
        Measure(f"{of_error} {t:g}", x) for t, x in zip((*_TIMES, *_MORE_TIMES), fine, strict=True)
    ]
    for t, order in zip(_TIMES, np.log2(np.divide(coarse, fine)), strict=False):
        text = f"{name}: order in the edge length at t = {t:g}"
        measures.append(Measure(text, order, transports, order > 0.5))
    for t, off in zip(_TIMES, fine, strict=False):
        x = levels[-1].error(levels[-1].carried(-t), t)
        text = f"{of_error} {t:g} with the printed sign"
        measures.append(Measure(text, x, _PUSHFORWARD, x < 2 * off))
    return measures


def against_functions(case: Case, carried: dict[float, FloatArray]) -> list[Measure]:
    """Measure whether carried fields derive carried functions as the fields the functions."""
    mesh, places, flow = case.mesh, case.mesh.vertices, Flow(case.mesh, case.v)
    measures = []
    for t, field in carried.items():
        expected = flow.push(directional_derivative(mesh, to_frame(mesh, case.u)) @ places, t)
        after = flow.push(places, t)
        derived = (
            directional_derivative(mesh, to_frame(mesh, w)) @ after
            for w in (field, case.carried(-t))
        )
        ours, printed = (l2_norm(mesh, x - expected) / l2_norm(mesh, expected) for x in derived)
        text = (
            f"{case.name}: relative L2 error of D_w x' against (D_u x)' at t = {t:g}, x the "
            "coordinates, ' and w carried"
        )
        itself = f"{case.name}: relative L2 error of v carried along itself at t = {t:g}"
        same = pushforward(mesh, case.v, case.v, t)
        measures += [
            Measure(text, ours),
            Measure(f"{text}, with the printed sign", printed, _PUSHFORWARD, printed < 2 * ours),
            Measure(itself, fields.relative_norm(mesh, same - case.v, case.v)),
        ]
    return measures


def known_cases(sizes: Sequence[int]) -> list[list[Case]]:
    """Return the rotations, each on a surface from coarse to fine."""
    return [
        [on_sphere(6 * k) for k in sizes],
        [on_torus(24 * k, around_tube=False) for k in sizes],
        [on_torus(24 * k, around_tube=True) for k in sizes],
    ]


def on_sphere(frequency: int) -> Case:
    """Return the rotation about the y axis, which turns a field of two unlike vortices."""
    mesh = geodesic_sphere(frequency)
    points = fields.centres(mesh)

    def turned(time: float) -> FloatArray:
        turn = Rotation.from_rotvec([0.0, _TURN * time, 0.0])
        back = turn.inv().apply(points)
        field = np.zeros_like(points)
        for centre, strength in (((0.5, 0.4, 0.77), 1.0), ((-0.2, -0.5, 0.84), -0.8)):
            middle = np.array(centre) / np.linalg.norm(centre)
            bell = strength * np.exp((back @ middle - 1) / 0.4**2)
            field += np.cross(middle, back) * bell[:, None]
        return fields.tangent(mesh, turn.apply(field))

    v = fields.tangent(mesh, _TURN * np.cross([0.0, 1.0, 0.0], points))
    return Case("sphere", mesh, v, turned(0.0), turned)


def on_torus(n: int, around_tube: bool) -> Case:
    """Return turning about the axis, an isometry, or around the tube, none."""
    mesh, ring, by_about, by_around = fields.angular_torus(n)
    x, y, z = fields.centres(mesh).T
    about, around = np.arctan2(x, z), np.arctan2(y, ring - 1)

    def moved(time: float) -> FloatArray:
        p, q = (about, around - _TURN * time) if around_tube else (about - _TURN * time, around)
        bell = np.exp((np.cos(p) + np.cos(q - 0.9) - 2) / 0.6)
        a, b = -bell * np.sin(q - 0.9), bell * np.sin(p)
        return fields.tangent(mesh, a[:, None] * by_about + b[:, None] * by_around)

    v = fields.tangent(mesh, _TURN * (by_around if around_tube else by_about))
    name = f"torus, {'around the tube' if around_tube else 'about the axis'}"
    return Case(name, mesh, v, moved(0.0), moved)


def on_any(mesh: TriangleMesh, name: str) -> Case:
    """Return a stirring field, as fast as the pushforward, unstable on bad faces, stands."""
    stirring = [fields.stirring(mesh, k, 1.0) for k in (1, 2, 3)]
    for fast in _SPEEDS:
        for v, u in pairwise(stirring):
            with suppress(AdvectionError), np.errstate(over="ignore"):
                carried = pushforward(mesh, fast * v, u, _TIMES[-1])
                if fields.relative_norm(mesh, carried, u) < _STRETCH_MAX:
                    return Case(f"{name}, |v| = {fast:g} sqrt(area)", mesh, fast * v, u)
    raise MeshError(
        "the discrete pushforward grows without bounds on this mesh: remesh its thin and folded "
        "faces"
    )
