import pickle
import subprocess
import sys
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import abfm
from abfm.errors import AbfmError, ResultError
from abfm.matching.terms.functions import FunctionTerm
from tests.core.fields import bump, wavy_field
from tests.messages import raises
from tests.shapes import icosphere

SPHERE = icosphere(2)
F, G, H = (bump(SPHERE, SPHERE.vertices[vertex], 0.3) for vertex in (0, 30, 60))
P = abfm.Parameters.of(iterations=5)
INPUTS = {
    "mask": np.abs(SPHERE.vertices[:, 0]),
    "weights": [1.0, 0.5],
    "start": 0.01 * wavy_field(SPHERE, 0),
}


def problem(**changes):
    channels = [np.stack(pair, axis=1) for pair in ((F, G), (G, F))]
    return abfm.Problem(SPHERE, *channels, P, **INPUTS | changes)


@pytest.fixture(params=["complete", "plain"])
def made(request):
    return problem() if request.param == "complete" else abfm.Problem(SPHERE, F, G)


def test_match_accepts_problem_or_its_arguments():
    made = problem()
    one, other = abfm.match(made), abfm.match(SPHERE, made.source, made.target, P, **INPUTS)
    assert np.array_equal(one.velocity, other.velocity)
    assert one.problem.digest == other.problem.digest == problem(start=None).digest
    with raises(AbfmError):
        abfm.match(SPHERE)
    for more, named in (((P,), {}), ((), {"mask": np.ones(len(F))})):
        with raises(AbfmError):
            abfm.match(problem(), *more, **named)


def test_problem_survives_files_and_pickling(made, tmp_path):
    made.save(tmp_path / "p.npz")
    loaded = abfm.load(tmp_path / "p.npz")
    assert loaded.digest == made.digest
    assert loaded.channels_given == made.channels_given
    assert loaded.parameters == made.parameters
    for name, array in made.arrays().items():
        assert np.array_equal(loaded.arrays()[name], array), name
    copy = pickle.loads(pickle.dumps(made))
    assert copy.digest == made.digest
    assert copy.functions.mesh is copy.mesh.normalized()
    found = abfm.match(copy.with_parameters(P)), abfm.match(made.with_parameters(P))
    assert np.array_equal(found[0].velocity, found[1].velocity)


def test_digest_is_the_same_in_every_process(tmp_path):
    problem().save(tmp_path / "p.npz")
    code = "import abfm, sys; print(abfm.load(sys.argv[1]).digest)"
    found = subprocess.check_output([sys.executable, "-c", code, tmp_path / "p.npz"], text=True)
    assert found.strip() == problem().digest
    assert len(problem().digest) == 64


def test_digest_depends_on_all_inputs():
    f, g = problem().source, problem().target
    others = [
        problem(mask=None),
        problem(weights=[1.0, 0.6]),
        problem(start=None),
        problem().with_parameters(abfm.Parameters.of(iterations=6)),
        problem().starting_from(0 * INPUTS["start"]),
        abfm.Problem(SPHERE, g, f, P, **INPUTS),
        abfm.Problem(icosphere(2, 2.0), f, g, P, **INPUTS | {"start": None}),
        abfm.Problem(SPHERE, F, G),
        abfm.Problem(SPHERE, F[:, None], G[:, None]),
    ]
    digests = {each.digest for each in [problem(), *others]}
    assert len(digests) == len(others) + 1


def test_digest_distinguishes_equal_array_names(tmp_path):
    other, same = (FunctionTerm(SPHERE.normalized(), H, g) for g in (F, G))
    made = [abfm.Problem(SPHERE, F, G, terms=[term]) for term in (other, same)]
    made += [abfm.Problem(SPHERE, G, F, terms=[other]), abfm.Problem(SPHERE, H, F)]
    assert len({each.digest for each in made}) == len(made)
    with raises(ResultError, 1):
        made[0].save(tmp_path / "lost.npz")


@given(st.floats(-1e6, 1e6))
def test_problem_copies_its_inputs(value):
    f, g, mask = F.copy(), G.copy(), np.ones(len(F))
    start = np.zeros((1, len(SPHERE.faces), 3))
    made = abfm.Problem(SPHERE, f, g, mask=mask, start=start)
    before = made.digest
    f[0] = g[2] = mask[1] = start[0, 0, 0] = value
    assert made._with().digest == before


def test_problem_is_immutable():
    with pytest.raises(AttributeError, match="parameters"):
        problem().parameters = P
    made = abfm.Problem(SPHERE, F, G, mask=np.ones(len(F)), start=np.zeros((len(SPHERE.faces), 3)))
    for array in (made.source, made.target, made.mask, made.weights, made.start):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2
    assert repr(problem()).startswith("Problem(TriangleMesh(")
    found = repr(abfm.match(problem()))
    assert "residual=" in found
    assert "array" not in found


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"f": F[1:]}, ()),
        ({"f": np.full(162, np.nan)}, ("value",)),
        ({"f": np.full(162, np.inf)}, (162,)),
        ({"f": np.array(["a"] * 162)}, ()),
        ({"f": np.zeros((162, 0))}, ()),
        ({"mask": 0 * F}, ()),
        ({"mask": np.ones(5)}, ("mask",)),
        ({"g": np.stack([G, G], axis=1)}, ("source", 1, 2)),
        ({"f": 1e101 * F}, ()),
        ({"mesh": 3}, ("TriangleMesh",)),
        ({"parameters": {"tau": 1}}, ("abfm.Parameters",)),
        ({"mask": -F}, ()),
        ({"weights": [1, 2]}, ("(1,)",)),
        ({"start": np.zeros((3, 3))}, ("start",)),
        ({"start": np.full((len(SPHERE.faces), 3), np.inf)}, ()),
    ],
)
def test_invalid_inputs_are_refused(changes, named):
    with raises(AbfmError, *named):
        abfm.Problem(**{"mesh": SPHERE, "f": F, "g": G} | changes)


def test_other_files_are_refused(tmp_path):
    abfm.match(SPHERE, F, G, P).save(tmp_path / "m.npz")
    assert abfm.load(tmp_path / "m.npz").channels_given is False  # a result contains a problem
    with np.load(tmp_path / "m.npz") as file:
        arrays = dict(file)
    del arrays["velocity"]
    np.savez(tmp_path / "damaged.npz", **arrays)
    with raises(ResultError, "velocity"):
        abfm.load(tmp_path / "damaged.npz")
    np.savez(tmp_path / "other.npz", source=F)
    with raises(ResultError):
        abfm.load(tmp_path / "other.npz")
    with raises(ResultError, "population.npz"):
        abfm.load(tmp_path)  # a folder, as of a batch


def test_missing_values_are_masked_with_a_warning():
    f, missing = F.copy(), np.arange(len(F)) < 9
    f[missing] = np.nan
    with pytest.warns(abfm.errors.AbfmWarning, match="9 of 162 vertices have no value"):
        made = abfm.Problem(SPHERE, f, G)
    masked = abfm.Problem(SPHERE, np.where(missing, 7.0, F), G, mask=~missing * 1.0)
    assert made.digest == masked.digest


def test_missing_values_below_a_mask_cause_no_warning():
    f, mask = F.copy(), np.ones(len(F))
    f[:9], mask[:9] = np.nan, 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_array_equal(abfm.Problem(SPHERE, f, G, mask=mask).mask, mask)
