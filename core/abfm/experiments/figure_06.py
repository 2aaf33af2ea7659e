"""Figure 6: a field carried along the flow of another (the pushforward)."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from abfm.calculus.operators import l2_norm
from abfm.calculus.vector_fields import directional_derivative, pushforward, to_frame
from abfm.errors import AdvectionError, MeshError
from abfm.experiments import given_flow as given
from abfm.experiments.experiment import Experiment, Findings, Measure, Report
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
_PUSHFORWARD = "exp(t ad_v) is the pushforward (Eq. 12)"


@dataclass(frozen=True, eq=False)
class Carrying(given.Case):
    """A field ``v`` and another, and where it is known what the flow of ``v`` makes of ``u`` in a time."""

    u: FloatArray
    exact: Callable[[float], FloatArray] | None = None

    def carried(self, t: float) -> FloatArray:
        return pushforward(self.mesh, self.v, self.u, t)


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> given.GivenFields[Carrying]:
    """Rotations of a sphere and of a torus, about its axis and around its tube."""
    if mesh is not None:
        return given.GivenFields.on(((_on_any(mesh),),), "mesh")
    sizes = (1, 2) if small else (1, 2, 4)
    cases = (
        tuple(_on_sphere(6 * k) for k in sizes),
        tuple(_on_torus(24 * k, around_tube=False) for k in sizes),
        tuple(_on_torus(24 * k, around_tube=True) for k in sizes),
    )
    return given.GivenFields.on(cases, cases[0][-1].name)


def _on_sphere(frequency: int) -> Carrying:
    """The rotation about the y axis carries a field by turning it."""
    mesh = geodesic_sphere(frequency)
    points = given.centres(mesh)

    def turned(time: float) -> FloatArray:
        turn = Rotation.from_rotvec([0.0, _TURN * time, 0.0])
        return given.tangent(mesh, turn.apply(_swirls(turn.inv().apply(points))))

    v = given.tangent(mesh, _TURN * np.cross([0.0, 1.0, 0.0], points))
    return Carrying("sphere", mesh, v, turned(0.0), turned)


def _swirls(points: FloatArray) -> FloatArray:
    """Two vortices of unlike strength, at points (n, 3) of the sphere."""
    field = np.zeros_like(points)
    for centre, strength, width in (((0.5, 0.4, 0.77), 1.0, 0.4), ((-0.2, -0.5, 0.84), -0.8, 0.4)):
        middle = np.array(centre) / np.linalg.norm(centre)
        bell = strength * np.exp((points @ middle - 1) / width**2)
        field += np.cross(middle, points) * bell[:, None]
    return field


def _on_torus(n: int, around_tube: bool) -> Carrying:
    """Turning about the axis, an isometry, or around the tube, none: in the angles both move the components along."""
    mesh = torus(n, n // 2, 1.0, _MINOR)
    x, y, z = given.centres(mesh).T
    ring = np.hypot(x, z)
    about, around = np.arctan2(x, z), np.arctan2(y, ring - 1)
    # the coordinate fields of both angles, at the face centres
    by_about = np.stack([z, np.zeros_like(z), -x], axis=1)
    by_around = np.stack([-y * x / ring, ring - 1, -y * z / ring], axis=1)

    def moved(time: float) -> FloatArray:
        p, q = (about, around - _TURN * time) if around_tube else (about - _TURN * time, around)
        bell = np.exp((np.cos(p) + np.cos(q - 0.9) - 2) / 0.6)
        a, b = -bell * np.sin(q - 0.9), bell * np.sin(p)
        return given.tangent(mesh, a[:, None] * by_about + b[:, None] * by_around)

    v = given.tangent(mesh, _TURN * (by_around if around_tube else by_about))
    return Carrying(f"torus, {'around the tube' if around_tube else 'about the axis'}", mesh, v, moved(0.0), moved)


def _on_any(mesh: TriangleMesh) -> Carrying:
    """A field that stirs the surface, with the next one: as fast as the pushforward, unstable on bad faces, stands.

    Raises
    ------
    MeshError
        If it grows without bounds for all fields and speeds that are tried.
    """
    fields = [given.with_speed(mesh, given.stirring(mesh, index), 1.0) for index in (1, 2, 3)]
    for fast in _SPEEDS:
        for v, u in pairwise(fields):
            with suppress(AdvectionError), np.errstate(over="ignore"):
                if given.relative_norm(mesh, pushforward(mesh, fast * v, u, _SHOWN[-1]), u) < _MOST_STRETCHED:
                    return Carrying(f"|v| = {fast:g} sqrt(area)", mesh, fast * v, u)
    raise MeshError("the discrete pushforward grows without bounds on this mesh: remesh its thin and folded faces")


def run(setup: given.GivenFields[Carrying], report: Report) -> Findings:
    """Carry the fields, and compare them with the exact answers."""
    measures: list[Measure] = []
    rows = []
    seen: tuple[FloatArray, ...] = ()
    for levels in setup.told(report):
        errors = []
        for case in levels:
            errors.append([_error(case, case.exact, t) for t in (*_SHOWN, *_LONGER) if case.exact])
        name, mesh = setup.title(case), case.mesh
        carried = [case.carried(t) for t in _SHOWN]
        if case.exact is not None:
            measures += _against_exact(name, case, case.exact, errors)
        else:
            measures += _against_functions(name, case, carried)
        seen = seen or (given.speed(mesh, case.u), given.speed(mesh, carried[-1]))
        rows.append(
            (
                Panel(mesh, Streaks(case.v), "v", "field"),
                Panel(mesh, _streaks(mesh, case.u), "u", "source"),
                *(
                    Panel(mesh, _streaks(mesh, w), f"u, carried to t = {t:g}", "result")
                    for t, w in zip(_SHOWN, carried, strict=True)
                ),
            )
        )
    stirring = "v and u are the turned gradients of two successive eigenfunctions"
    turns = "v turns by half a turn in t = 1" if setup.cases[0][0].exact else stirring
    setting = f"{setup.sizes}. {turns}. The pushforward is exp(-t ad_v) u."
    return Findings(measures, Sheet(tuple(rows), seen=seen), setting)


def _streaks(mesh: TriangleMesh, field: FloatArray) -> Streaks:
    return Streaks(field, given.speed(mesh, field), "speed")


def _error(case: Carrying, exact: Callable[[float], FloatArray], time: float, sign: int = 1) -> float:
    expected = exact(time)
    return given.relative_norm(case.mesh, case.carried(sign * time) - expected, expected)


def _against_exact(
    name: str, case: Carrying, exact: Callable[[float], FloatArray], errors: list[list[float]]
) -> list[Measure]:
    found = [
        Measure(f"{name}: relative L2 error at t = {t:g}", error)
        for t, error in zip((*_SHOWN, *_LONGER), errors[-1], strict=True)
    ]
    transports = "the pushforward transports u over the flow lines of v"
    for t, order in zip(_SHOWN, np.log2(np.divide(errors[-2], errors[-1])), strict=False):
        found.append(Measure(f"{name}: order in the edge length at t = {t:g}", order, transports, order > 0.5))
    for t, error in zip(_SHOWN, errors[-1], strict=False):
        printed = _error(case, exact, t, sign=-1)
        text = f"{name}: relative L2 error at t = {t:g} with the printed sign"
        found.append(Measure(text, printed, _PUSHFORWARD, printed < 2 * error))
    return found


def _against_functions(name: str, case: Carrying, carried: list[FloatArray]) -> list[Measure]:
    """What holds on any surface: carried fields derive carried functions as the fields derive the functions."""
    found = []
    for t, field in zip(_SHOWN, carried, strict=True):
        ours, printed = (_derivative_error(case, t, w) for w in (field, case.carried(-t)))
        text = f"{name}: relative L2 error of D_w x' against (D_u x)' at t = {t:g}, x the coordinates, ' and w carried"
        same = pushforward(case.mesh, case.v, case.v, t)
        found += [
            Measure(text, ours),
            Measure(f"{text}, with the printed sign", printed, _PUSHFORWARD, printed < 2 * ours),
            Measure(
                f"{name}: relative L2 error of v carried along itself at t = {t:g}",
                given.relative_norm(case.mesh, same - case.v, case.v),
            ),
        ]
    return found


def _derivative_error(case: Carrying, time: float, field: FloatArray) -> float:
    mesh, places, flow = case.mesh, case.mesh.vertices, Flow(case.mesh, case.v)
    derived = directional_derivative(mesh, to_frame(mesh, field)) @ flow.advect(places, time)
    expected = flow.advect(directional_derivative(mesh, to_frame(mesh, case.u)) @ places, time)
    return l2_norm(mesh, derived - expected) / l2_norm(mesh, expected)


EXPERIMENT = Experiment(
    6, "exp(t ad_v) transports a field u over the flow lines of v, here to t = 0.125 and 0.25.", set_up, run
)
