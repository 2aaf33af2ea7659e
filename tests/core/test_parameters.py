import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm import ParameterError, Parameters
from abfm.matching import Remedy
from abfm.parameters import (
    FIELDS,
    FIRST_SIGMA_MAX,
    LAST_SIGMA,
    TABLE_1,
    SolverSettings,
    in_options,
    row_of,
)
from tests.messages import raises


@pytest.mark.parametrize(
    ("advice", "expected"),
    [
        (
            "limit it, for example with max_distortion 1",
            "limit it, for example with --max-distortion 1",
        ),
        (
            "smooth the functions, or use a larger sigma",
            "smooth the functions, or use a larger --sigma",
        ),
    ],
)
def test_advice_names_options(advice, expected):
    assert in_options(advice) == expected


def test_segments_depend_on_method():
    assert Parameters().solver.segments == 0
    assert Parameters.of(method="linearised").solver.segments == 10
    assert Parameters.of(method="linearised", segments=3).solver.segments == 3
    assert all(entry.metadata["help"] for entry in FIELDS.values())


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"tau": 0}, ("tau", 0)),
        ({"tau": float("nan")}, ("tau", "nan")),
        ({"alpha": -1}, ("alpha", -1, 0)),
        ({"sigma": "x"}, ("sigma", "x")),
        ({"beta": float("inf")}, ("beta", "inf")),
        ({"iterations": 2.5}, ("iterations", "2.5", 0)),
        ({"substeps": 0}, (1,)),
        ({"memory": True}, ("memory",)),
        ({"alpha": None}, ("alpha",)),
        ({"goal": None}, ("goal", 0, 1)),
        ({"goal": 0}, ("goal", 0, 1)),
        ({"refine": 4}, ("refine", 4, 0, 3)),
        ({"method": "magic"}, ("method", "magic", "nonlinear", "linearised")),
        ({"gradient": "exact"}, ("adjoint", "bracket")),
        ({"cooling_stages": 400}, ()),
        ({"cooling_stages": 10**6}, (0, 1000)),
        ({"cooling_stages": 3, "stage_iterations": 60, "iterations": 100}, ()),
        ({"cooling_factor": 1e300}, (1, "1e+30")),
        ({"sigma": 1e-300}, ("sigma", "1e-300", 0, "1e-30")),
        ({"beta": 1e300}, ("beta", "1e+300")),
        ({"segments": 10**300}, ("segments", 1000)),
        ({"memory": 10**5}, ("memory", 100000)),
        ({"alpha": 1e12}, ("alpha", "1000000000000.0", "1e+07")),
        ({"order": 3}, ("order", 3, 1, 2)),
        ({"reach": -0.1}, ("reach", "-0.1", 0)),
        ({"levels": 11}, ("levels", 11, 0, 10)),
        ({"sigma_unit": "metres"}, ("metres", "relative", "absolute", "sigma_unit")),
    ],
)
def test_invalid_values_are_refused(changes, named):
    with raises(ParameterError, *named):
        Parameters.of(**changes)


def test_parameters_round_trip():
    for p in (Parameters.of(alpha=3.0, method="linearised", segments=4), Parameters(sigma=0.3)):
        assert Parameters.of(**json.loads(json.dumps(p.to_dict()))) == p
    with raises(ParameterError, "aplha"):
        Parameters.of(aplha=1)
    p = Parameters.of(tau=np.float32(1), memory=np.uint8(3), segments=2.0, iterations=np.int64(7))
    kinds = [
        type(value) for value in (p.tau, p.solver.memory, p.solver.segments, p.solver.iterations)
    ]
    assert kinds == [float, int, int, int]


def test_missing_values_are_defaults():
    given = {"tau": 2.0, "alpha": 0.02, "iterations": 150}
    parts = Parameters(tau=2.0, alpha=0.02, solver=SolverSettings(iterations=150))
    assert Parameters.of(**given) == parts
    with raises(ParameterError, "sigmma"):
        Remedy("Smoother", "a smoother field", {"order": 2, "sigmma": 0.5})


@given(sigma=st.floats(1e-8, 1e3), stages=st.integers(1, 6), iterations=st.integers(0, 1000))
def test_cooling_ends_at_sigma_within_the_iterations(sigma, stages, iterations):
    p = Parameters.of(sigma=sigma, cooling_stages=stages, iterations=iterations)
    assert len(p.stage_sigmas()) == len(p.stage_limits()) == stages
    assert p.stage_sigmas()[-1] == sigma
    assert p.stage_sigmas() == sorted(p.stage_sigmas(), reverse=True)
    assert sum(p.stage_limits()[:-1]) <= iterations


@given(sigma=st.none() | st.floats(1e-8, 1e3), factor=st.floats(1.5, 100))
def test_stage_sigmas_end_at_given_sigma(sigma, factor):
    p = Parameters.of(sigma=sigma, cooling_factor=factor)
    sigmas = p.stage_sigmas()
    assert sigmas[-1] == p.last_sigma == (sigma or LAST_SIGMA)
    assert all(one / following == pytest.approx(factor) for one, following in pairwise(sigmas))
    assert len(sigmas) == 1 or sigmas[0] <= FIRST_SIGMA_MAX * (1 + 1e-8)
    assert sigmas[0] * factor > FIRST_SIGMA_MAX
    limits = p.with_values(stage_iterations=200).stage_limits()
    assert len(limits) == len(sigmas)
    assert sum(limits[:-1]) <= p.solver.iterations


def test_automatic_parameters_are_none():
    p = Parameters()
    assert (p.sigma, p.refine, p.paper.cooling_stages) == (None, None, 0)
    assert Parameters(sigma=2.0).stage_sigmas() == [18.0, 6.0, 2.0]
    assert Parameters(sigma=20.0).stage_sigmas() == [20.0]
    assert len(Parameters.of(cooling_factor=1 + 1e-15).stage_sigmas()) == 1000


PRINTED = """
Fig. 1  | 1  | 1    | 0    | 1e-2* | -  | 10
Fig. 3  | 2  | 1e+3 | 1e-5 | 1e-4  | -  | 40
Fig. 7  | 1  | 1e+3 | 0    | 1e-1* | 20 | -
Fig. 8  | 10 | 1e+3 | 0    | 1e-2* | -  | 200
Fig. 9  | 1  | 1    | 1e-4 | 5e-3  | -  | 20
Fig. 10 | 1  | 1e+3 | 0    | 1e-2* | -  | 20
Fig. 11 | 1  | 1    | 0    | 1e-2* | 10 | -
Fig. 12 | 1  | 1    | 0    | 1e-2* | 10 | -
"""


@pytest.mark.parametrize(
    ("row", "printed"), [*zip(TABLE_1.values(), PRINTED.strip().splitlines(), strict=True)]
)
def test_table_row_is_as_printed(row, printed):
    name, tau, alpha, beta, sigma, N, n = (cell.strip() for cell in printed.split("|"))
    parameters = row.parameters(iterations=7)
    assert row.name == name
    assert parameters.solver.iterations == 7
    found = (parameters.tau, parameters.alpha, parameters.beta)
    assert found == (float(tau), float(alpha), float(beta))
    assert parameters.stage_sigmas()[0] == pytest.approx(float(sigma.strip("*")))
    assert parameters.paper.cooling_stages == (3 if sigma.endswith("*") else 1)
    if n == "-":
        assert (parameters.paper.method, parameters.solver.segments) == ("linearised", int(N))
    else:
        found = (parameters.paper.method, parameters.solver.segments, parameters.paper.substeps)
        assert found == ("nonlinear", 1, int(n))


@pytest.mark.parametrize("row", TABLE_1.values())
def test_row_is_recognized_by_its_values(row):
    p = row.parameters(iterations=7)
    assert (p.solver.order, p.solver.reach, p.solver.levels) == (1, 0, 1)
    assert p.paper.sigma_unit == "absolute"
    assert row_of(p).values == row.values
    for other in (row.parameters(order=2), row.parameters(alpha=2.0), Parameters()):
        assert row_of(other) is None
