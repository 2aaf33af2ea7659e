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
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage, refined
from abfm.mesh.shapes import geodesic_sphere, torus
from abfm.sheets import Panel, Sheet, Streaks
from abfm.types import FloatArray

CLAIM = "exp(t ad_v) transports a field u over the flow lines of v, here to t = 0.125 and 0.25."

_TURN = np.pi  # radians per unit of time
# to try without a symmetry: sqrt(area) per unit of time
_SPEEDS = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125)
_MOST_STRETCHED = 2.0
_SHOWN = (0.125, 0.25)  # the paper's times
_LONGER = (0.5, 1.0)
_PUSHFORWARD = "exp(t ad_v) is the pushforward (Eq. 12)"


@dataclass(frozen=True, eq=False)
class Case:
    """A surface with fields ``v`` and ``u``, and where it is known what the flow of ``v`` makes of
    ``u`` in a time.
    """

    name: str
    mesh: TriangleMesh
    v: FloatArray
    u: FloatArray
    exact: Callable[[float], FloatArray] | None = None

    def carried(self, t: float) -> FloatArray:
        return pushforward(self.mesh, self.v, self.u, t)


def figure(stage: Stage) -> Script:
    """Carry fields along rotations of a sphere and of a torus, about its axis and around its tube,
    and compare them with the exact answers; on another mesh, along a field that stirs it.
    """
    if stage.mesh is None:
        surfaces, name = known_cases((1, 2) if stage.small else (1, 2, 4)), "sphere"
        turns = "v turns by half a turn in t = 1"
    else:
        surfaces, name = [[on_any(stage.mesh, stage.name)]], stage.name
        turns = "v and u are the turned gradients of two successive eigenfunctions"
    yield fields.field_example(surfaces[0][-1].mesh, surfaces[0][-1].v, name)

    measures: list[Measure] = []
    rows = []
    for number, levels in enumerate(surfaces):
        case = levels[-1]
        stage.report(refined(levels), number / len(surfaces))
        carried = [case.carried(t) for t in _SHOWN]
        measures += (
            against_functions(case, carried) if case.exact is None else against_exact(levels)
        )
        rows.append(
            (
                Panel(case.mesh, Streaks(case.v), "v", "field"),
                Panel(case.mesh, streaks(case, case.u), "u", "source"),
                *(
                    Panel(case.mesh, streaks(case, w), f"u, carried to t = {t:g}", "result")
                    for t, w in zip(_SHOWN, carried, strict=True)
                ),
            )
        )
    first = surfaces[0][-1]
    seen = tuple(fields.speed(first.mesh, w) for w in (first.u, first.carried(_SHOWN[-1])))
    sizes = "; ".join(map(refined, surfaces))
    setting = f"{sizes}. {turns}. The pushforward is exp(-t ad_v) u."
    return Findings(measures, Sheet(tuple(rows), seen=seen), setting)


def streaks(case: Case, field: FloatArray) -> Streaks:
    """Show a field with its speed."""
    return Streaks(field, fields.speed(case.mesh, field), "speed")


def against_exact(levels: Sequence[Case]) -> list[Measure]:
    """Compare with the exact answers on a surface, coarse to fine."""
    name, times = levels[-1].name, (*_SHOWN, *_LONGER)
    coarse, fine = ([error(case, t) for t in times] for case in levels[-2:])
    transports = "the pushforward transports u over the flow lines of v"
    measures = [
        Measure(f"{name}: relative L2 error at t = {t:g}", off)
        for t, off in zip(times, fine, strict=True)
    ]
    for t, order in zip(_SHOWN, np.log2(np.divide(coarse, fine)), strict=False):
        text = f"{name}: order in the edge length at t = {t:g}"
        measures.append(Measure(text, order, transports, order > 0.5))
    for t, off in zip(_SHOWN, fine, strict=False):
        printed = error(levels[-1], t, sign=-1)
        text = f"{name}: relative L2 error at t = {t:g} with the printed sign"
        measures.append(Measure(text, printed, _PUSHFORWARD, printed < 2 * off))
    return measures


def error(case: Case, time: float, sign: int = 1) -> float:
    """Return the relative L2 error of the field that is carried to a time."""
    assert case.exact is not None
    expected = case.exact(time)
    return fields.relative_norm(case.mesh, case.carried(sign * time) - expected, expected)


def against_functions(case: Case, carried: Sequence[FloatArray]) -> list[Measure]:
    """Measure what holds on any surface: carried fields derive carried functions as the fields
    derive the functions.
    """
    measures = []
    for t, field in zip(_SHOWN, carried, strict=True):
        ours, printed = (derivative_error(case, t, w) for w in (field, case.carried(-t)))
        text = (
            f"{case.name}: relative L2 error of D_w x' against (D_u x)' at t = {t:g}, x the "
            "coordinates, ' and w carried"
        )
        same = pushforward(case.mesh, case.v, case.v, t)
        measures += [
            Measure(text, ours),
            Measure(f"{text}, with the printed sign", printed, _PUSHFORWARD, printed < 2 * ours),
            Measure(
                f"{case.name}: relative L2 error of v carried along itself at t = {t:g}",
                fields.relative_norm(case.mesh, same - case.v, case.v),
            ),
        ]
    return measures


def derivative_error(case: Case, time: float, field: FloatArray) -> float:
    """Return how far a field is from deriving the carried coordinates as ``u`` does the others."""
    mesh, places, flow = case.mesh, case.mesh.vertices, Flow(case.mesh, case.v)
    derived = directional_derivative(mesh, to_frame(mesh, field)) @ flow.push(places, time)
    expected = flow.push(directional_derivative(mesh, to_frame(mesh, case.u)) @ places, time)
    return l2_norm(mesh, derived - expected) / l2_norm(mesh, expected)


def known_cases(sizes: Sequence[int]) -> list[list[Case]]:
    """Return the rotations, each on a surface from coarse to fine."""
    return [
        [on_sphere(6 * k) for k in sizes],
        [on_torus(24 * k, around_tube=False) for k in sizes],
        [on_torus(24 * k, around_tube=True) for k in sizes],
    ]


def on_sphere(frequency: int) -> Case:
    """Return the rotation about the y axis, which carries a field by turning it."""
    mesh = geodesic_sphere(frequency)
    points = fields.centres(mesh)

    def turned(time: float) -> FloatArray:
        turn = Rotation.from_rotvec([0.0, _TURN * time, 0.0])
        return fields.tangent(mesh, turn.apply(swirls(turn.inv().apply(points))))

    v = fields.tangent(mesh, _TURN * np.cross([0.0, 1.0, 0.0], points))
    return Case("sphere", mesh, v, turned(0.0), turned)


def swirls(points: FloatArray) -> FloatArray:
    """Return two vortices of unlike strength, at points (n, 3) of the sphere."""
    field = np.zeros_like(points)
    for centre, strength, width in (((0.5, 0.4, 0.77), 1.0, 0.4), ((-0.2, -0.5, 0.84), -0.8, 0.4)):
        middle = np.array(centre) / np.linalg.norm(centre)
        bell = strength * np.exp((points @ middle - 1) / width**2)
        field += np.cross(middle, points) * bell[:, None]
    return field


def on_torus(n: int, around_tube: bool) -> Case:
    """Return turning about the axis, an isometry, or around the tube, none: in the angles both
    move the components along.
    """
    mesh = torus(n, n // 2)
    x, y, z = fields.centres(mesh).T
    ring = np.hypot(x, z)
    about, around = np.arctan2(x, z), np.arctan2(y, ring - 1)
    # the coordinate fields of both angles, at the face centres
    by_about = np.stack([z, np.zeros_like(z), -x], axis=1)
    by_around = np.stack([-y * x / ring, ring - 1, -y * z / ring], axis=1)

    def moved(time: float) -> FloatArray:
        p, q = (about, around - _TURN * time) if around_tube else (about - _TURN * time, around)
        bell = np.exp((np.cos(p) + np.cos(q - 0.9) - 2) / 0.6)
        a, b = -bell * np.sin(q - 0.9), bell * np.sin(p)
        return fields.tangent(mesh, a[:, None] * by_about + b[:, None] * by_around)

    v = fields.tangent(mesh, _TURN * (by_around if around_tube else by_about))
    name = f"torus, {'around the tube' if around_tube else 'about the axis'}"
    return Case(name, mesh, v, moved(0.0), moved)


def on_any(mesh: TriangleMesh, name: str) -> Case:
    """Return a field that stirs the surface, with the next one: as fast as the pushforward,
    unstable on bad faces, stands.

    Raises
    ------
    MeshError
        If it grows without bounds for all fields and speeds that are tried.
    """
    stirring = [fields.with_speed(mesh, fields.stirring(mesh, k), 1.0) for k in (1, 2, 3)]
    for fast in _SPEEDS:
        for v, u in pairwise(stirring):
            with suppress(AdvectionError), np.errstate(over="ignore"):
                carried = pushforward(mesh, fast * v, u, _SHOWN[-1])
                if fields.relative_norm(mesh, carried, u) < _MOST_STRETCHED:
                    return Case(f"{name}, |v| = {fast:g} sqrt(area)", mesh, fast * v, u)
    raise MeshError(
        "the discrete pushforward grows without bounds on this mesh: remesh its thin and folded "
        "faces"
    )
