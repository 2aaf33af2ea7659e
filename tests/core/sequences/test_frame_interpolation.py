"""Interpolated frames: the blend, and the share of motion that held-out frames confirm."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm.calculus.operators import vertex_areas
from abfm.flow.flow import Flow
from abfm.matching.judging.cause import Cause
from abfm.sequences import defaults, load_sequence
from abfm.sequences.between.interpolation import interpolate
from abfm.sequences.between.motion_evidence import motion_evidence
from abfm.sequences.solving.solve import SequenceSolver
from tests.core.sequences.known_motions import SPHERE, bumps, rotating_pattern
from tests.messages import check_message
from tests.shapes import icosphere

KINDS = ("turning", "travelling", "source and sink", "standing", "standing twice")
MESH, STEPS = icosphere(3), np.arange(9)
SETTINGS = defaults(sigma=0.3, alpha=1.0, order=1)


def waves(kind, noise=0.0):
    """Return a wave at half steps of time, (11, V), without and with noise."""
    x, y, z = MESH.vertices.T
    turn = 0.05 * STEPS[:, None]
    if kind == "turning":
        turned = np.cos(turn) * x + np.sin(turn) * y
        found = np.sin(5 * turned) * np.cos(3 * z)
    elif kind == "travelling":
        found = np.sin(5 * (np.cos(turn) * x + np.sin(turn) * z))
    elif kind == "source and sink":  # along the gradient of z, tanh(z) moves with time
        found = np.cos(5 * np.tanh(np.arctanh(np.clip(z, -1 + 1e-9, 1 - 1e-9)) - turn))
    else:
        found = np.cos(2 * turn + 0.4) * np.cos(5 * x)
        if kind == "standing twice":
            found = found + np.cos(3 * turn + 1.0) * np.sin(4 * y)
    scatter = np.random.default_rng(0).standard_normal(found.shape)
    return found, found + noise * found.std() * scatter


def errors(sequence, truth):
    """Return errors of the linear blend and of the sequence, over the standard deviation."""
    areas = vertex_areas(MESH) / vertex_areas(MESH).sum()
    found = []
    for i in range(len(sequence)):
        middle = truth[2 * i + 1]
        blend = sequence.frames[i : i + 2, :, 0].mean(axis=0)
        found.append([areas @ (f - middle) ** 2 for f in (blend, sequence.at(i + 0.5))])
    return np.sqrt(np.mean(found, axis=0)) / truth.std()


@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("kind", KINDS)
def test_interpolated_frames_are_not_worse_than_the_blend(kind, noise):
    truth, given = waves(kind, noise)
    found = abfm.sequence(MESH, given[::2], parameters=SETTINGS)
    blend, interpolated = errors(found, truth)
    if kind.startswith("standing"):
        assert interpolated == pytest.approx(blend, rel=1e-12)
        assert found.confirmed == 0
        assert np.isinf(found.uncertainty).all()
        assert not found.determined.any()
        assert found.facts.numbers["motion_share"] == 0
    else:
        assert interpolated < blend * (1.0 if noise else 0.5)
        assert found.confirmed == len(found)
        assert found.motion_share > 0.75


def test_noisy_standing_wave_is_not_confirmed():
    _, given = waves("standing", 0.3)
    found = abfm.sequence(MESH, given[::2], parameters=SETTINGS)
    assert found.confirmed == 0
    reasons = [v.reason for v in found.verdicts if v.cause is Cause.UNDETERMINED]
    assert reasons
    check_message(reasons[0])
    assert not found.facts.outcome.is_good


@pytest.mark.parametrize("kind", KINDS[:3])
def test_noisy_motions_remain_confirmed(kind):
    found = abfm.sequence(
        MESH, waves(kind, 0.3)[1][::2], parameters=defaults(sigma=0.9, alpha=1.0, order=1)
    )
    assert found.confirmed == len(found)


def test_motion_share_is_saved(tmp_path):
    found = replace(abfm.sequence(MESH, waves("turning", 0.1)[1][::2], None, SETTINGS))
    half = replace(found, motion_share=0.4)
    half.save(tmp_path / "s.npz")
    again = load_sequence(tmp_path / "s.npz")
    assert again.motion_share == 0.4
    assert_array_equal(again.at(1.3), half.at(1.3))
    assert_array_equal(again.uncertainty, half.uncertainty)
    blend, motion = (replace(found, motion_share=x).at(1.3) for x in (0.0, 1.0))
    assert_allclose(half.at(1.3), 0.6 * blend + 0.4 * motion, atol=1e-14)
    assert_allclose(blend, 0.7 * found.frames[1, :, 0] + 0.3 * found.frames[2, :, 0], atol=1e-14)


def test_interpolation_equals_the_frames_at_both_ends():
    frames, field = rotating_pattern(SPHERE, 0.1, 2)
    flow = Flow(SPHERE, field, 1.0)
    for motion in (0.0, 0.5, 1.0):
        found = interpolate(flow, *frames, np.array([0.0, 1.0]), motion)
        assert_allclose(found, frames, atol=1e-14)


def test_two_frames_have_none_to_hold_out():
    frames, _ = rotating_pattern(SPHERE, 0.1, 2)
    moving = abfm.sequence(SPHERE, frames, parameters=SETTINGS)
    jumping = abfm.sequence(SPHERE, bumps([0.0, np.pi]), parameters=SETTINGS)
    assert np.isnan([moving.motion_share, jumping.motion_share]).all()
    assert moving.facts.numbers["motion_share"] is None
    assert_array_equal(moving.motion_shares, 1)
    assert_array_equal(jumping.motion_shares, 0)


def test_three_uneven_frames_have_one_to_hold_out():
    frames, _ = rotating_pattern(SPHERE, 0.05, 4)
    found = abfm.sequence(SPHERE, frames[[0, 1, 3]], [0.0, 1.0, 3.0], SETTINGS)
    assert found.motion_share > 0.9


def test_too_distant_frames_do_not_refute_motion():
    """Held-out frames do not refute a wave of 16 edges that moves 12 edges between frames.

    The frames next to a held-out one are 24 edges apart, which looks like 8 edges backwards.
    """
    frames, _ = rotating_pattern(MESH, 1.2, 5, lambda p: (p[:, 0] + 1j * p[:, 1]) ** 3)
    found = abfm.sequence(MESH, np.stack([frames.real, frames.imag], axis=2), parameters=SETTINGS)
    assert np.isnan(found.motion_share) == (found.confirmed > 0)


def test_units_and_rotations_do_not_change_the_share():
    _, given = waves("turning", 0.1)
    reference = abfm.sequence(MESH, given[::2], parameters=SETTINGS).motion_share
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    other = abfm.TriangleMesh(7 * MESH.vertices @ turn.T, MESH.faces)
    there = abfm.sequence(other, 1e3 * given[::2] - 5, 0.01 * np.arange(5), SETTINGS)
    assert there.motion_share == pytest.approx(reference, rel=1e-4)


def test_jumps_among_motions_are_not_held_out():
    angles = [0.0, 0.1, 0.2, 0.3, 2.0, 2.1, 2.2]
    found = abfm.sequence(SPHERE, bumps(angles, noise=0.0), parameters=SETTINGS)
    assert found.motion_share > 0.9
    assert not found.verdicts[3].kind.is_good
    assert sum(verdict.kind.is_good for verdict in found.verdicts) == 5


def test_still_frames_have_an_unknown_share():
    still = np.repeat(rotating_pattern(SPHERE, 0.1, 1)[0], 4, axis=0)
    found = abfm.sequence(SPHERE, still, parameters=SETTINGS)
    assert np.isnan(found.motion_share)
    assert found.confirmed == 3


def test_holding_out_frames_changes_no_field():
    frames, _ = rotating_pattern(SPHERE, 0.1, 4)
    found = abfm.sequence(SPHERE, frames, parameters=SETTINGS)
    solver = SequenceSolver(found._frames, SETTINGS, 1.0)
    solver.run(lambda i: None)
    before = solver.fields.copy()
    assert motion_evidence(solver).share == found.motion_share
    assert_array_equal(solver.fields, before)
