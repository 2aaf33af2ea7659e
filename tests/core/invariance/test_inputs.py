"""Extreme and invalid inputs: a correct result or an error in one line, and no warning."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import abfm
from abfm import baselines, calculus, flow, maps
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.matching.terms.functions import VALUE_MAX, VALUE_MIN
from abfm.parameters import CHOICES, FIELDS, PAPER, Parameters, is_integer
from tests.core.fields import bump, wavy_field
from tests.core.invariance.moves import MESHES, examples
from tests.messages import check_message, raises

pytestmark = pytest.mark.filterwarnings("error")

MESH = MESHES["potato"]
F, G = bump(MESH, MESH.vertices[3], 0.3), bump(MESH, MESH.vertices[20], 0.3)
V = 0.1 * wavy_field(MESH, 1)
PARAMETERS = abfm.Parameters.of(iterations=1, refine=0)
START = maps.vertex_points(MESH, [3])


EQUAL_LAYOUTS = {
    "read-only": lambda x: np.broadcast_to(x, x.shape),
    "column-major": np.asfortranarray,
    "strided": lambda x: np.repeat(x, 2, axis=0)[::2],
    "negative stride": lambda x: x[::-1].copy()[::-1],
    "big-endian": lambda x: x.astype(">f8"),
    "long double": lambda x: x.astype(np.longdouble),
    "list": lambda x: x.tolist(),
}
OTHER_ARRAYS = {
    "single": lambda x: x.astype(np.float32),
    "half": lambda x: x.astype(np.float16),
    "boolean": lambda x: x > 0,
    "integer": lambda x: np.round(x).astype(int),
    "unsigned": lambda x: np.round(abs(x)).astype(np.uint8),
    "negative zero": lambda x: -0.0 * x,
    "huge": lambda x: np.full(x.shape, 1.7e308),
    "tiny": lambda x: np.full(x.shape, 5e-324),
    "huge integers": lambda x: [10**400] * len(x),
    "objects": lambda x: np.array([None] * len(x)),
    "text": lambda x: "abc",
    "texts": lambda x: ["a"] * len(x),
    "records": lambda x: np.zeros(x.shape, dtype=[("a", float)]),
    "masked": lambda x: np.ma.array(x, mask=x > 0),
    "generator": iter,
    "ragged": lambda x: [[1, 2], [3]],
    "one number": lambda x: np.array(1.0),
    "none": lambda x: None,
    "empty": lambda x: [],
    "complex": lambda x: x * 1j,
    "not finite": lambda x: x * np.nan,
    "dates": lambda x: np.full(x.shape, np.datetime64("2020-01-01")),
    "mapping": lambda x: {},
    "too long": lambda x: np.concatenate([x, x]),
    "too deep": lambda x: x[None, None],
}
ACCEPTED = {"single", "half", "boolean", "integer", "unsigned", "negative zero", "huge", "tiny"}
ACCEPTED |= {"none"}  # allowed for optional arguments
OF_FUNCTIONS = {
    "match": lambda f: abfm.match(MESH, f, G, PARAMETERS).velocity,
    "target": lambda f: abfm.match(MESH, F, f, PARAMETERS).velocity,
    "mask": lambda f: abfm.match(MESH, F, G, PARAMETERS, mask=f).velocity,
    "push": lambda f: abfm.Flow(MESH, V).push(f, 1.0),
    "advect": lambda f: abfm.advect(MESH, V, f, 1.0),
    "channels": lambda f: calculus.channels(MESH, f, "f"),
    "transport": lambda f: baselines.optimal_transport(MESH, f, G, 0.5),
    "blend": lambda f: baselines.linear_blend(f, f, 0.5),
    "verify": lambda f: (
        abfm.matching.verify(abfm.Problem(MESH, f, G), V, subdivided=False).residual
    ),
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
NO_NUMBERS = [
    *("a", "1", 1j, {}, [[1, 2], [3]], "\n".join("abc" * 100), iter([1.0]), [None]),
    *(np.zeros(3, dtype=[("a", float)]), np.full(3, "2020", dtype="M8[D]")),
    np.ma.array([1, 2], mask=True),
]
NUMBERS = [
    *(None, np.arange(1000.0), np.array([1.0]), True),
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
    "weights": lambda w: abfm.match(MESH, F, G, PARAMETERS, weights=w),
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
    """Return whether a call refuses an argument, with a message of one short line."""
    try:
        found = call(given)
    except abfm.AbfmError as error:
        text = str(error)
        assert "\n" not in text
        assert 10 < len(text) < 200
        return True
    if isinstance(found, np.ndarray):
        assert np.isfinite(found).all()
    return False


@pytest.mark.parametrize(
    ("calls", "array"), [(OF_FUNCTIONS, F), (OF_FIELDS, V)], ids=["functions", "fields"]
)
def test_memory_layouts_have_no_influence(calls, array):
    for name, call in calls.items():
        expected = call(array)
        for what, same in EQUAL_LAYOUTS.items():
            assert np.array_equal(call(same(array)), expected), (name, what)


@pytest.mark.parametrize("what", OTHER_ARRAYS)
def test_other_arrays_are_accepted_or_refused(what):
    for calls, array in ((OF_FUNCTIONS, F), (OF_FIELDS, V)):
        for call in calls.values():
            is_refused = refused(call, OTHER_ARRAYS[what](array))
            assert is_refused or what in ACCEPTED or call is OF_FUNCTIONS["blend"]


@pytest.mark.parametrize("what", OF_NUMBERS)
def test_other_numbers_are_accepted_or_refused(what):
    for number in NUMBERS:
        refused(OF_NUMBERS[what], number)
    assert all(refused(OF_NUMBERS[what], wrong) for wrong in NO_NUMBERS)


ZEROS = np.zeros(len(MESH.vertices))
POINTS = np.eye(len(MESH.vertices))
OPTIONS = [
    {},
    {"method": "linearised"},
    {"preconditioner": "none"},
    {"gradient": "bracket"},
    {"refine": 1},
    {**PAPER, "sigma": 0.1},
]


def matched(f, g, start=None, **changes):
    match = abfm.match(
        MESH, f, g, Parameters.of(**{"iterations": 3, "refine": 0, **changes}), start=start
    )
    for values in (match.velocity, match.advected, match.energy_history):
        assert np.isfinite(values).all()
    assert np.isfinite(match.residual)
    assert match.verdict.reason
    return match


def outcome_of(call):
    try:
        return str(call().residual)
    except abfm.AbfmError as error:
        return str(error)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_verdicts_fit_equal_constant_and_distant_functions(options):
    for f, kind in ((F, "matched"), *((f, "impossible") for f in (ZEROS, ZEROS + 3, -0.0 * F))):
        match = matched(f, f, **options)
        assert (match.residual, match.verdict.kind, match.velocity.any()) == (0, kind, False)
    check_message(matched(ZEROS, G, **options).verdict.reason)
    check_message(matched(F, ZEROS + 1, **options).verdict.reason)
    assert matched(ZEROS + 1, ZEROS + 2, **options).verdict.kind == "impossible"
    assert matched(-F, F, **options).verdict.kind == "impossible"
    far = matched(POINTS[3], POINTS[80], **options).verdict
    assert far.kind in ("not reached", "nearly", "matched")


@examples(5)
@given(exponent=st.integers(-300, 300), options=st.sampled_from(OPTIONS[:5]))
def test_powers_of_two_have_no_influence(exponent, options):
    expected = matched(F, G, **options)
    match = matched(2.0**exponent * F, 2.0**exponent * G, **options)
    for name in ("velocity", "energy_history", "residual", "verified_residual"):
        assert np.array_equal(getattr(match, name), getattr(expected, name))


@pytest.mark.parametrize("size", [1e-12, 1e12, 2 * VALUE_MIN, VALUE_MAX / 2])
def test_units_of_functions_change_only_rounding(size):
    match, expected = matched(size * F, size * G), matched(F, G)
    assert np.abs(match.velocity - expected.velocity).max() < 1e-9 * np.abs(expected.velocity).max()


@pytest.mark.parametrize("unit", ["relative", "absolute"])
@pytest.mark.parametrize("size", [5e-324, 1e-300, 1e-162, 1e-101, 1e101, 1e200, 1e300, 1.7e308])
def test_functions_with_overflowing_squares_are_refused(size, unit):
    with raises(abfm.FunctionError):
        matched(size * F, size * G, sigma_unit=unit)
    with raises(abfm.FunctionError):
        abfm.matching.verify(abfm.Problem(MESH, size * F, size * G), np.zeros((len(MESH.faces), 3)))


@pytest.mark.parametrize("reach", [0.0, 1.0])
@pytest.mark.parametrize("speed", [10.0, 100.0, 1e4, 1e8, 1e200, 1e308])
def test_fast_starts_are_refused_or_corrected(speed, reach):
    start = speed * np.random.default_rng(0).normal(size=(len(MESH.faces), 3)).clip(-1, 1)
    outcome = outcome_of(lambda: matched(F, G, start=start, reach=reach))
    assert "start" in outcome or float(outcome) < 2


def test_starts_with_growing_values_are_corrected():
    start = 3 * np.random.default_rng(0).normal(size=(len(MESH.faces), 3)).clip(-1, 1)
    assert abfm.Flow(MESH, start).push(F, 1.0).max() > 100 * F.max()
    assert matched(F, G, start=start, reach=0, iterations=40).residual < 0.7


def ends():
    """Return parameters, each at one end of its range."""
    found = []
    for entry in FIELDS.values():
        if entry.name in CHOICES:
            found += [(entry.name, choice) for choice in CHOICES[entry.name]]
            continue
        least, most, without_least = entry.metadata["range"]
        if is_integer(entry):
            found += [(entry.name, least), (entry.name, most)]
        else:
            low = [] if without_least else [least]
            found += [(entry.name, value) for value in (*low, max(1e-30, 1.000001 * least), most)]
    return found


@pytest.mark.parametrize(("name", "value"), ends(), ids=str)
def test_parameters_at_their_bounds_are_used_or_refused(name, value):
    bounded = {"gradient": "adjoint"} if name in ("substeps", "quadrature", "segments") else {}
    if (name, value) == ("segments", 1000):
        value = 20  # 1000 segments would take seconds
    outcome = outcome_of(lambda: matched(F, G, **{"iterations": 2, **bounded, name: value}))
    assert name in outcome or float(outcome) < 2


@pytest.mark.parametrize(("name", "value"), ends(), ids=str)
def test_parameters_out_of_range_are_refused(name, value):
    if name in CHOICES:
        wrong = [value + "s", None, 1, ["hodge"], np.arange(1000), "\n" * 100]
    else:
        entry = FIELDS[name]
        least, most, _ = entry.metadata["range"]
        wrong = [np.nan, np.inf, 10**400, -(10**400), 10**5000, "1", None, 1j, [1]]
        wrong += [-1e-9 if least == 0 else least - 1, most + 1 if most < 1e30 else 1e31]
        wrong += [1.5] if is_integer(entry) else [1e-31]
        if entry.default is None:
            wrong.remove(None)
    for refused in wrong:
        with pytest.raises(abfm.ParameterError) as error:
            Parameters.of(**{name: refused})
        assert name in str(error.value)
        assert len(str(error.value)) < 250
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("unit", ["relative", "absolute"])
@pytest.mark.parametrize("weight", [1e-30, 1e30])
@pytest.mark.parametrize("size", [VALUE_MIN, VALUE_MAX])
@pytest.mark.parametrize("sigma", [1e-30, 1e30])
def test_extreme_units_may_be_combined(sigma, size, weight, unit):
    f, g = (0.99 * size * h / F.max() if size == VALUE_MAX else 2 * size * h for h in (F, G))
    p = Parameters.of(iterations=2, sigma=sigma, sigma_unit=unit)
    mask = np.full(len(ZEROS), weight)
    outcome = outcome_of(lambda: abfm.match(MESH, f, g, p, weights=[weight], mask=mask))
    assert "scale" in outcome or 0 < float(outcome) < 2


@pytest.mark.parametrize("name", ["mask", "weights"])
def test_extreme_masks_and_weights_are_refused(name):
    count = len(ZEROS) if name == "mask" else 1
    for value in (1e-31, 1e31, 5e-324, 1e308):
        with raises(abfm.ParameterError, name):
            abfm.match(MESH, F, G, **{name: np.full(count, value)})
