"""Verification of loaded matches: their numbers have to agree with their fields."""

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
    """Return the match of its file after changing arrays of the file by functions."""
    found.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **arrays | {name: change(arrays[name]) for name, change in changes.items()})
    return load(path)


def test_saved_match_agrees_with_its_field(found, tmp_path):
    loaded = reloaded(found, tmp_path / "m.npz")
    assert loaded.load_warning == ""
    assert (loaded.residual, loaded.verdict) == (found.residual, found.verdict)
    # rounding to single precision, and a difference as between two schemes
    single = reloaded(
        found, tmp_path / "m.npz", advected=np.float32, residual=lambda residual: residual - 0.004
    )
    assert single.load_warning == ""


def test_zero_field_is_recomputed(found, tmp_path):
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
    ("changes", "has_warning"),
    [
        ({"residual": lambda residual: residual / 100}, True),
        ({"residual": lambda residual: 0.9 * residual}, False),
        ({"advected": lambda f: f[::-1]}, True),
        ({"target": lambda g: g[::-1]}, True),
    ],
)
def test_changes_above_rounding_cause_a_warning(found, tmp_path, changes, has_warning):
    loaded = reloaded(found, tmp_path / "m.npz", **changes)
    assert bool(loaded.load_warning) == has_warning
    check_message(loaded.load_warning)


def test_verdict_better_than_residual_is_replaced(found, tmp_path):
    unmoved = match(PROBLEM.with_parameters(Parameters.of(iterations=1, cooling_stages=1)))
    assert unmoved.verdict.kind == "not reached"
    changed = replace(unmoved, verdict=Verdict(Outcome.MATCHED, "matched", ""))
    loaded = reloaded(changed, tmp_path / "m.npz")
    check_message(loaded.load_warning)
    assert loaded.verdict.kind == "not reached"


def test_overflowing_field_is_not_reached(found, tmp_path):
    name = "fine_velocity" if found.refined else "velocity"
    loaded = reloaded(found, tmp_path / "m.npz", **{name: lambda v: 1e9 * v})
    check_message(loaded.load_warning)
    assert loaded.verdict.kind == "not reached"


def test_interrupted_match_is_recomputed_silently(found):
    """The numbers of an interrupted run refer to a coarser level, which is not an error."""
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
