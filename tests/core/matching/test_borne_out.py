"""Files are held against their arrays: what a result's field does not do is not believed."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm import Parameters, Problem, load, match
from abfm.matching import StopReason, Verdict
from abfm.outcome import Outcome
from tests.core.fields import bump
from tests.messages import check_message
from tests.shapes import icosphere

BALL = icosphere(2)
PROBLEM = Problem(BALL, *(bump(BALL, BALL.vertices[i], 0.25) for i in (3, 20)))


@pytest.fixture(scope="module", params=[0, 1], ids=["as it is", "refined"])
def found(request):
    one = match(PROBLEM.refined(request.param).with_parameters(Parameters.of(iterations=40)))
    head = one.advected[: len(BALL.vertices)]
    problem = PROBLEM.with_parameters(one.parameters)
    one = replace(one, problem=problem, advected=head, path=())
    assert one.verdict.kind == "matched"
    return one


def reloaded(found, path, **changes):
    """The match of its file, some of whose arrays were changed by what they are given to."""
    found.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **arrays | {name: change(arrays[name]) for name, change in changes.items()})
    return load(path)


def test_what_was_saved_is_believed_as_it_is(found, tmp_path):
    loaded = reloaded(found, tmp_path / "m.npz")
    assert loaded.load_warning == ""
    assert (loaded.residual, loaded.verdict) == (found.residual, found.verdict)
    # rounding to single precision, and what another scheme may come to
    single = reloaded(
        found,
        tmp_path / "m.npz",
        advected=np.float32,
        residual=lambda left: left - 0.004,
    )
    assert single.load_warning == ""


def test_a_field_that_was_set_to_zero_matches_nothing(found, tmp_path):
    name = "fine_velocity" if found.refined else "velocity"
    loaded = reloaded(found, tmp_path / "m.npz", **{name: np.zeros_like})
    check_message(loaded.load_warning, f"{found.residual:.3g}")
    assert "\n" not in loaded.load_warning
    initial = loaded.problem.refined(loaded.refined).functions
    assert loaded.residual == pytest.approx(initial.residual(initial.source))
    assert loaded.verified_residual == pytest.approx(loaded.residual, rel=1e-3)
    assert loaded.path[0].residual == loaded.residual
    assert loaded.verdict.kind == "not reached"
    assert_allclose(loaded.advected, loaded.source, atol=1e-9)
    loaded.save(again := tmp_path / "again.npz")
    assert load(again).load_warning == ""


@pytest.mark.parametrize(
    ("changes", "is_told"),
    [
        ({"residual": lambda left: left / 100}, True),
        ({"residual": lambda left: 0.9 * left}, False),
        ({"advected": lambda f: f[::-1]}, True),
        ({"target": lambda g: g[::-1]}, True),
    ],
)
def test_other_changes_are_told_where_they_are_larger_than_rounding(
    found, tmp_path, changes, is_told
):
    loaded = reloaded(found, tmp_path / "m.npz", **changes)
    assert bool(loaded.load_warning) == is_told
    check_message(loaded.load_warning)


def test_a_word_that_is_better_than_its_numbers_is_not_believed(found, tmp_path):
    still = match(PROBLEM.with_parameters(Parameters.of(iterations=1, cooling_stages=1)))
    assert still.verdict.kind == "not reached"
    praised = replace(still, verdict=Verdict(Outcome.MATCHED, "so it is", ""))
    loaded = reloaded(praised, tmp_path / "m.npz")
    check_message(loaded.load_warning)
    assert loaded.verdict.kind == "not reached"


def test_a_field_too_fast_to_carry_anything_is_no_match(found, tmp_path):
    name = "fine_velocity" if found.refined else "velocity"
    loaded = reloaded(found, tmp_path / "m.npz", **{name: lambda v: 1e9 * v})
    check_message(loaded.load_warning)
    assert loaded.verdict.kind == "not reached"


def test_a_field_taken_out_of_a_run_has_numbers_of_a_coarser_level_and_is_no_cheat(found):
    coarse = replace(
        found,
        residual=found.residual / 3,
        advected=found.target,
        verified_residual=math.nan,
        stop_reason=StopReason.CANCELLED,
    )
    judged = coarse.reverified()
    assert judged.load_warning == ""
    assert judged.residual == pytest.approx(found.residual, rel=1e-6)
    assert json.dumps(judged.parameters.to_dict()) == json.dumps(found.parameters.to_dict())
