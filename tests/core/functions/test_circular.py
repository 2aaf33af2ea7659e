"""Circular functions are compared by cosine and sine; otherwise jumps cause a warning."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm.errors import AbfmWarning, FunctionError, ParameterError
from abfm.functions import function, parse, phase_warning
from abfm.functions.circular_channels import split_channels
from abfm.sequences import vertex_speed
from tests.messages import check_message, raises
from tests.shapes import icosphere, open_cylinder

RING = open_cylinder(40, 6)
AROUND = np.arctan2(RING.vertices[:, 1], RING.vertices[:, 0])
TURN = 0.3  # radians per frame
PERIODS = {"radians": (2 * np.pi, -np.pi), "from 0": (2 * np.pi, 0.0), "degrees": (360.0, -180.0)}


def phases(count, period=2 * np.pi, start=-np.pi):
    """Return frames (count, V) that rotate about the axis, with values from ``start``."""
    turned = AROUND - TURN * np.arange(count)[:, None]
    return (period / (2 * np.pi) * turned - start) % period + start


def warnings_of(call, *given, **named):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = call(*given, **named)
    return found, [str(each.message) for each in caught if each.category is AbfmWarning]


@pytest.mark.parametrize(("period", "start"), PERIODS.values(), ids=PERIODS)
def test_rotating_phases_have_their_speed(period, start):
    frames = phases(3, period, start)
    found, texts = warnings_of(abfm.sequence, RING, frames, circular=period)
    assert found.confirmed == 2
    assert_allclose(vertex_speed(found), TURN, rtol=0.01)
    assert texts == []
    assert found.frames.shape == (3, len(AROUND), 2)
    as_numbers, [text] = warnings_of(abfm.sequence, RING, frames)
    assert as_numbers.confirmed == 0
    check_message(text, "circular")


def test_match_of_phases_has_two_channels():
    f, g = phases(2)
    found, texts = warnings_of(abfm.match, RING, f, g, weights=[2.0], circular=True)
    assert texts == []
    assert_allclose(found.source, np.stack([np.cos(f), np.sin(f)], axis=1))
    assert found.weights.tolist() == [2, 2]
    speed = np.linalg.norm(found.velocity[0], axis=1)
    assert_allclose(speed, TURN, rtol=0.05)
    assert len(warnings_of(abfm.match, RING, f, g, abfm.Parameters.of(iterations=1))[1]) == 1


def test_texts_may_be_circular(tmp_path):
    for name, values in zip("fg", phases(2, 360.0, 0.0), strict=True):
        np.save(tmp_path / f"{name}.npy", values)
    f, g = (f"circular:period=360.0(file:{tmp_path}/{name}.npy)" for name in "fg")
    problem = abfm.Problem(RING, f, g)
    degrees = abfm.Problem(RING, f"file:{tmp_path}/f.npy", f"file:{tmp_path}/g.npy", circular=360)
    assert problem.digest == degrees.digest
    assert problem.specs[0][1] == f.replace("(", ",part=sine(", 1)
    angles = np.radians(phases(2, 360.0, 0.0))
    assert_allclose(problem.target, np.stack([np.cos(angles[1]), np.sin(angles[1])], axis=1))
    prepared = abfm.registration.prepare(RING, RING, [f, "coordinate:z"], [g, "coordinate:z"])
    assert prepared.problem.source.shape == (len(AROUND), 3)


@pytest.mark.parametrize(
    "text", ["circular:(coordinate:x)", "circular:period=360.0,part=sine(coordinate:x)"]
)
def test_circular_text_round_trip(text):
    assert str(parse(text)) == text


def test_channels_are_split_with_their_weights():
    spec = "circular:(coordinate:x)"
    cosine, sine = (f"circular:part={part}(coordinate:x)" for part in ("cosine", "sine"))
    found = split_channels(["coordinate:y", spec], ["coordinate:z", spec], [1.0, 0.5])
    both = [cosine, sine]
    assert found == (["coordinate:y", *both], ["coordinate:z", *both], [1.0, 0.5, 0.5])
    with raises(FunctionError, "circular", "coordinate:z"):
        split_channels([spec], ["coordinate:z"], [1.0])
    with raises(FunctionError, "part=cosine", "part=sine"):
        function(RING, spec)
    assert_array_equal(function(RING, sine), np.sin(RING.vertices[:, 0]))


@pytest.mark.parametrize("circular", [0, -1.0, np.inf, "phases"])
def test_periods_are_positive(circular):
    with raises(ParameterError, "circular"):
        abfm.Problem(RING, AROUND, AROUND, circular=circular)


def test_wrong_period_causes_a_warning(tmp_path):
    degrees = phases(1, *PERIODS["degrees"])[0]
    np.save(tmp_path / "a.npy", degrees)
    ring = open_cylinder(40, 6)
    text = f"circular:part=cosine(file:{tmp_path / 'a.npy'})"
    _, [warning] = warnings_of(function, ring, text)
    check_message(warning, "360", "2 pi")
    right = text.replace("part", "period=360,part")
    assert_allclose(function(ring, right), np.cos(np.radians(degrees)))
    assert warnings_of(function, ring, right)[1] == []


def test_only_phases_cause_a_warning():
    rng, sphere = np.random.default_rng(1), icosphere(3)
    z = sphere.vertices[:, 2]
    others = [
        180 * z,
        np.pi * np.sign(z + 0.01),
        180 * np.tanh(30 * z),
        rng.uniform(0, 360, len(z)),
        np.where(z > 0, 360.0, rng.uniform(0, 20, len(z))),
    ]
    assert phase_warning(sphere, np.array(others)) == ""
    noisy = phases(1)[0] + rng.normal(0, 0.2, len(AROUND))
    assert phase_warning(RING, np.angle(np.exp(1j * noisy))[None])
    assert phase_warning(RING, np.where(RING.vertices[:, 2] > 0.3, phases(1), np.nan))
    assert not phase_warning(RING, phases(1) / 3)
