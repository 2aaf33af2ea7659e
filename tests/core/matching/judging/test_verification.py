"""Verification of matches: agreement with exact flows, and order of convergence."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import abfm
from abfm.calculus.operators import l2_norm, vertex_areas
from abfm.errors import ParameterError
from abfm.flow.flow import advect
from abfm.matching.judging import verification
from abfm.matching.judging.verification import Verification
from abfm.parameters import Parameters
from tests.core.fields import bump, rotation_field
from tests.core.verification import observed_orders
from tests.messages import check_message, raises
from tests.shapes import disc, icosphere

AXIS = np.array([0.3, -0.5, 0.8])


def verify(mesh, f, g, velocity, *, linearised=False, subdivided=True, **given):
    parameters = Parameters.of(method="linearised" if linearised else "nonlinear")
    problem = abfm.Problem(mesh, f, g, parameters, **given)
    return abfm.matching.verify(problem, velocity, subdivided)


def rotated(mesh, axis, width):
    """Return a bump before and after a rotation about a vector, and the field of the rotation."""
    place = np.array([0.8, 0.0, 0.6]) if mesh.is_closed else np.array([0.8, 0.0, 0.0])
    place_after = Rotation.from_rotvec(axis).as_matrix() @ place
    return bump(mesh, place, width), bump(mesh, place_after, width), rotation_field(mesh, axis)


def noisy(mesh, field, size):
    noise = np.random.default_rng(3).normal(size=field.shape)
    return field + size * mesh.length_scale * noise


def test_rotation_of_sphere_is_verified_with_order_two():
    found = []
    for level in (3, 4, 5):
        mesh = icosphere(level)
        found.append(verify(mesh, *rotated(mesh, AXIS, 0.12)))
    for name in ("flow_lines", "subdivided"):
        errors = [getattr(one, name) for one in found]
        assert errors[-1] < 0.01
        assert observed_orders([4, 2, 1], errors).min() > 1.8
    assert all(one.folded == one.flipped == 0 and not one.checks_disagree for one in found)
    assert [one.resolved for one in found] == [False, True, True]
    orders = observed_orders([1, 2, 4], [one.resolution for one in found])
    assert_allclose(orders, 1, rtol=0, atol=0.1)


def test_rotation_of_disc_is_verified_up_to_the_boundary():
    errors = []
    for n in (10, 20, 40):
        mesh = disc(n)
        one = verify(mesh, *rotated(mesh, np.array([0, 0, 1.2]), 0.15))
        errors.append([one.flow_lines, one.subdivided])
        assert one.folded == 0
    assert max(errors[-1]) < 0.02
    for column in np.transpose(errors):
        assert observed_orders([4, 2, 1], column).min() > 1.4


def test_discrete_match_of_noise_is_not_confirmed():
    """A target made by the discrete flow of noise has discrete residual 0, but no confirmation."""
    mesh = icosphere(4)
    f, _, field = rotated(mesh, AXIS, 0.15)
    fields = field, noisy(mesh, field, 2.0)
    smooth, rough = (verify(mesh, f, advect(mesh, v, f, 1.0), v) for v in fields)
    assert smooth.residual < 0.03
    assert not smooth.checks_disagree
    assert min(rough.residual, rough.subdivided) > 5 * smooth.residual
    assert rough.flipped > 0.02


def test_rough_fields_flip_faces_or_overflow():
    """Flow lines of rough fields flip faces without folds; overflow makes the residual infinite.

    For the zero field, the residual is known.
    """
    mesh = icosphere(3)
    f, g, field = rotated(mesh, AXIS, 0.2)
    fields = field, noisy(mesh, field, 10.0)
    smooth, rough = (verify(mesh, f, g, v, subdivided=False) for v in fields)
    assert smooth.folded == smooth.flipped == 0
    assert rough.folded == 0
    assert rough.flipped > 0.2
    fields = np.stack([60 * noisy(mesh, field, 1.0)] * 40)
    overflowing = verify(mesh, 1e99 * f, 1e99 * g, fields, linearised=True)
    assert overflowing.subdivided == np.inf
    assert overflowing.checks_disagree
    varying = g - np.average(g, weights=vertex_areas(mesh))
    unmoved, expected = verify(mesh, f, g, 0 * field), l2_norm(mesh, f - g) / l2_norm(mesh, varying)
    assert_allclose(unmoved.flow_lines, expected, rtol=1e-8)
    # both use the same functions, with different quadratures
    assert_allclose(unmoved.subdivided, expected, rtol=0.1)


def test_several_fields_and_channels_are_verified():
    mesh = icosphere(4)
    first, second = [np.pi / 2, 0, 0], [0, 0, np.pi / 2]
    fields = np.stack([2 * rotation_field(mesh, first), 2 * rotation_field(mesh, second)])
    place = np.array([0.8, 0.0, 0.6])
    end = (Rotation.from_rotvec(second) * Rotation.from_rotvec(first)).as_matrix() @ place
    f, g = bump(mesh, place, 0.2), bump(mesh, end, 0.2)
    one = verify(mesh, f, g, fields)
    assert max(one.flow_lines, one.subdivided) < 0.05
    jump = np.sign(mesh.vertices[:, 0])
    two = np.stack([f, jump], axis=1), np.stack([g, -jump], axis=1)
    both = verify(mesh, *two, fields, weights=[2.0, 0.0])
    assert_allclose(dataclasses.astuple(both), dataclasses.astuple(one), rtol=1e-9)


def test_masked_values_have_no_effect():
    mesh = icosphere(4)
    f, g, field = rotated(mesh, AXIS, 0.2)
    mask = (mesh.vertices[:, 2] > -0.5).astype(float)
    hidden = np.where(mask > 0, [f, g], 1e3)
    clean, changed = (verify(mesh, *pair, field, mask=mask) for pair in ((f, g), hidden))
    assert changed == clean
    assert verify(mesh, *hidden, field).residual > 0.5


def test_linearised_steps_converge_on_the_subdivision():
    """Many short linearised steps are as good as the exponential, one long step is not."""
    mesh = icosphere(3)
    f, g, field = rotated(mesh, 0.3 * AXIS, 0.2)
    exact = verify(mesh, f, g, field)
    many, few = (verify(mesh, f, g, np.stack([field] * n), linearised=True) for n in (60, 1))
    assert_allclose(many.subdivided, exact.subdivided, rtol=0, atol=0.03)
    assert few.subdivided > 3 * exact.subdivided
    assert_allclose([many.flow_lines, few.flow_lines], exact.flow_lines, rtol=0.02)


def test_match_has_a_verification():
    mesh = icosphere(3)
    f, g, _ = rotated(mesh, 0.5 * AXIS, 0.25)
    match = abfm.match(mesh, f, g, abfm.Parameters.of(iterations=30, segments=2))
    one = match.verify()
    assert isinstance(one, abfm.matching.Verification)
    assert one == abfm.matching.verify(match.problem, match.velocity)
    assert abs(one.residual - match.residual) < 0.1
    assert np.isnan(match.verify(subdivided=False).subdivided)


def test_check_on_subdivision_is_optional(monkeypatch):
    mesh = icosphere(2)
    given = (mesh, *rotated(mesh, AXIS, 0.3))
    one = verify(*given, subdivided=False)
    assert np.isnan(one.subdivided)
    assert not one.checks_disagree
    monkeypatch.setattr(verification, "SUBDIVIDED_LIMIT", len(mesh.vertices) - 1)
    assert np.isnan(verify(*given).subdivided)


@pytest.mark.parametrize(
    ("flow_lines", "subdivided", "checks_disagree"),
    [
        (0.01, 0.05, False),  # both residuals are small
        (0.10, 0.19, False),
        (0.10, 0.21, True),
        (0.30, 0.10, True),
        (0.50, 0.40, False),
        (0.02, np.inf, True),
        (0.02, np.nan, False),
    ],
)
def test_checks_disagree_by_difference_and_ratio(flow_lines, subdivided, checks_disagree):
    one = Verification(flow_lines, subdivided, 0.0, 0.0, 10.0)
    assert one.checks_disagree == checks_disagree
    assert one.residual == flow_lines
    assert ("disagree" in one.report()) == checks_disagree
    assert ("subdivided" in one.report()) == (not np.isnan(subdivided))


def test_report_contains_all_numbers():
    check_message(Verification(0.1, 0.1, 0.012, 0.05, 3.0).report(), "0.1000", "1.2", "3.0")


def test_wrong_number_of_vectors_is_refused():
    mesh = icosphere(1)
    f, g, field = rotated(mesh, AXIS, 0.3)
    with raises(ParameterError, "velocity"):
        verify(mesh, f, g, field[1:])
