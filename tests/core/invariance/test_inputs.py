"""Whatever a Python user may give for functions, fields and numbers: taken for what it is, or
refused in one line.
"""

import numpy as np
import pytest

import abfm
from abfm import baselines, calculus, flow, maps
from abfm.flow.continuous_flow import ContinuousFlow
from tests.core.fields import bump, wavy_field
from tests.core.invariance.moves import MESHES

pytestmark = pytest.mark.filterwarnings("error")

MESH = MESHES["potato"]
F, G = bump(MESH, MESH.vertices[3], 0.3), bump(MESH, MESH.vertices[20], 0.3)
V = 0.1 * wavy_field(MESH, 1)
PARAMETERS = abfm.Parameters(iterations=1)
START = maps.vertex_points(MESH, [3])


def locked(x):
    x = x.copy()
    x.flags.writeable = False
    return x


SAME = {
    "read-only": locked,
    "column after column": np.asfortranarray,
    "every second row": lambda x: np.repeat(x, 2, axis=0)[::2],
    "backwards": lambda x: x[::-1].copy()[::-1],
    "other bytes first": lambda x: x.astype(">f8"),
    "long": lambda x: x.astype(np.longdouble),
    "list": lambda x: x.tolist(),
}
OTHER = {
    "single": lambda x: x.astype(np.float32),
    "half": lambda x: x.astype(np.float16),
    "truth": lambda x: x > 0,
    "whole": lambda x: np.round(x).astype(int),
    "small whole": lambda x: np.round(abs(x)).astype(np.uint8),
    "minus nothing": lambda x: -0.0 * x,
    "huge": lambda x: np.full(x.shape, 1.7e308),
    "tiny": lambda x: np.full(x.shape, 5e-324),
    "huge whole numbers": lambda x: [10**400] * len(x),
    "objects": lambda x: np.array([None] * len(x)),
    "texts": lambda x: ["a"] * len(x),
    "ragged": lambda x: [[1, 2], [3]],
    "one number": lambda x: np.array(1.0),
    "nothing": lambda x: None,
    "empty": lambda x: [],
    "complex": lambda x: x * 1j,
    "not finite": lambda x: x * np.nan,
    "dates": lambda x: np.full(x.shape, np.datetime64("2020-01-01")),
    "mapping": lambda x: {},
    "too long": lambda x: np.concatenate([x, x]),
    "too deep": lambda x: x[None, None],
}
TAKEN = {"single", "half", "truth", "whole", "small whole", "minus nothing", "huge", "tiny"}
TAKEN |= {"nothing"}  # where it is optional
OF_FUNCTIONS = {
    "match": lambda f: abfm.match(MESH, f, G, PARAMETERS).velocity,
    "mask": lambda f: abfm.match(MESH, F, G, PARAMETERS, mask=f).velocity,
    "push": lambda f: abfm.Flow(MESH, V).push(f, 1.0),
    "advect": lambda f: abfm.advect(MESH, V, f, 1.0),
    "channels": lambda f: calculus.channels(MESH, f, "f"),
    "transport": lambda f: baselines.optimal_transport(MESH, f, G, 0.5),
    "blend": lambda f: baselines.linear_blend(f, f, 0.5),
    "verify": lambda f: abfm.verify(abfm.Problem(MESH, f, G), V, subdivided=False).mismatch,
    "pull back": lambda f: START.pull_back(f),
}
OF_FIELDS = {
    "start": lambda v: abfm.match(MESH, F, G, PARAMETERS, start=v).velocity,
    "flow": lambda v: abfm.Flow(MESH, v).push(F, 0.5),
    "advect": lambda v: abfm.advect(MESH, v, F, 1.0),
    "parts": lambda v: calculus.helmholtz_hodge(MESH, v),
    "bracket": lambda v: calculus.lie_bracket_of(MESH, v, V),
    "pushforward": lambda v: calculus.pushforward(MESH, v, V, 0.01),
    "lines": lambda v: flow.flow_lines(MESH, v, START, 0.1)[0].positions,
    "map": lambda v: ContinuousFlow(MESH, v, 0.5).destinations().positions,
    "energy": lambda v: abfm.MatchingEnergy(MESH, F, G, PARAMETERS)(v)[0],
}
NUMBERS = [
    *(None, "a", "1", 1j, {}, [[1, 2], [3]], "\n".join("abc" * 100)),
    *(np.arange(1000.0), np.array([1.0]), True),
    *(10**400, -(10**400), 10**5000, 10**20, 1e308, 5e-324, np.nan, np.inf, -1, 0, -0.0, 2.5),
    *(1, np.float32(1), np.int64(1), np.array(1.0), np.bool_(True)),
]
OF_NUMBERS = {
    "flow's tau": lambda t: abfm.Flow(MESH, V, t),
    "push to": lambda t: abfm.Flow(MESH, V).push(F, t),
    "advect to": lambda t: abfm.advect(MESH, V, F, t),
    "pushforward to": lambda t: calculus.pushforward(MESH, V, V, t),
    "walk to": lambda t: flow.flow_lines(MESH, V, START, t),
    "map to": lambda t: ContinuousFlow(MESH, V, t),
    "method": lambda t: abfm.Flow(MESH, V, 1.0, t),
    "parameters": lambda t: abfm.match(MESH, F, G, t) if t is not None else None,
    "transport to": lambda t: baselines.optimal_transport(MESH, F, G, t),
    "blur": lambda t: baselines.HeatKernel(MESH, t, 2),
    "steps": lambda t: baselines.HeatKernel(MESH, 0.1, t),
    "blend to": lambda t: baselines.linear_blend(F, G, t),
    "blend's tau": lambda t: baselines.linear_blend(F, G, 0.1, t),
    "eigenfunctions": lambda k: calculus.eigenbasis(MESH, k),
    "sources": lambda k: calculus.geodesic_distance(MESH, k),
    "commuting": lambda k: calculus.commuting_fields(MESH, V, k),
    "bracket's weight": lambda w: calculus.commuting_fields(MESH, V, 1, w),
    "spec": lambda s: abfm.function(MESH, s),
}


def refused(call, given):
    """Whether it is refused in one short line, and not taken."""
    try:
        found = call(given)
    except abfm.AbfmError as error:
        text = str(error)
        assert "\n" not in text
        assert 10 < len(text) < 300
        return True
    if isinstance(found, np.ndarray):
        assert np.isfinite(found).all()
    return False


@pytest.mark.parametrize(
    ("calls", "array"), [(OF_FUNCTIONS, F), (OF_FIELDS, V)], ids=["functions", "fields"]
)
def test_the_same_numbers_in_another_form_are_the_same(calls, array):
    for name, call in calls.items():
        expected = call(array)
        for what, same in SAME.items():
            assert np.array_equal(call(same(array)), expected), (name, what)


@pytest.mark.parametrize("what", OTHER)
def test_other_arrays_are_taken_or_refused(what):
    for calls, array in ((OF_FUNCTIONS, F), (OF_FIELDS, V)):
        for call in calls.values():
            is_refused = refused(call, OTHER[what](array))
            assert is_refused or what in TAKEN or call is OF_FUNCTIONS["blend"]


@pytest.mark.parametrize("what", OF_NUMBERS)
def test_other_numbers_are_taken_or_refused(what):
    for number in NUMBERS:
        refused(OF_NUMBERS[what], number)


def test_functions_are_copied_when_they_are_taken():
    source, target = F.copy(), G.copy()
    energy = abfm.MatchingEnergy(MESH, source, target, PARAMETERS)
    source[:] = target[:] = 7
    assert np.array_equal(energy.functions.source, [F])
    assert np.array_equal(energy.functions.target, [G])
