"""Witnesses of a match: they agree with what is known, fall with order two."""

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
    """Ask the witnesses of a problem with these functions."""
    parameters = Parameters.of(method="linearised" if linearised else "nonlinear")
    problem = abfm.Problem(mesh, f, g, parameters, **given)
    return abfm.matching.verify(problem, velocity, subdivided)


def turned(mesh, axis, width):
    """A bump, the same after a turn by a rotation vector (exact on a surface of revolution)."""
    place = np.array([0.8, 0.0, 0.6]) if mesh.is_closed else np.array([0.8, 0.0, 0.0])
    place_after = Rotation.from_rotvec(axis).as_matrix() @ place
    return bump(mesh, place, width), bump(mesh, place_after, width), rotation_field(mesh, axis)


def noisy(mesh, field, size):
    """The field with independent noise on each face."""
    noise = np.random.default_rng(3).normal(size=field.shape)
    return field + size * mesh.length_scale * noise


def test_a_turning_sphere_is_verified_with_order_two():
    found = []
    for level in (3, 4, 5):
        mesh = icosphere(level)
        found.append(verify(mesh, *turned(mesh, AXIS, 0.12)))
    for name in ("flow_lines", "subdivided"):
        errors = [getattr(one, name) for one in found]
        assert errors[-1] < 0.01
        assert observed_orders([4, 2, 1], errors).min() > 1.8
    assert all(one.folded == one.overturned == 0 and not one.checks_disagree for one in found)
    assert [one.resolved for one in found] == [False, True, True]
    orders = observed_orders([1, 2, 4], [one.resolution for one in found])
    assert_allclose(orders, 1, rtol=0, atol=0.1)


def test_a_turning_disc_is_verified_up_to_its_boundary():
    errors = []
    for n in (10, 20, 40):
        mesh = disc(n)
        one = verify(mesh, *turned(mesh, np.array([0, 0, 1.2]), 0.15))
        errors.append([one.flow_lines, one.subdivided])
        assert one.folded == 0
    assert max(errors[-1]) < 0.02
    for column in np.transpose(errors):
        assert observed_orders([4, 2, 1], column).min() > 1.4


def test_what_only_the_scheme_carries_is_found_out():
    """A target made with the scheme itself, so that the discrete mismatch is 0."""
    mesh = icosphere(4)
    f, _, field = turned(mesh, AXIS, 0.15)
    smooth, rough = (
        verify(mesh, f, advect(mesh, v, f, 1.0), v) for v in (field, noisy(mesh, field, 2.0))
    )
    assert smooth.residual < 0.03
    assert not smooth.checks_disagree
    assert min(rough.residual, rough.subdivided) > 5 * smooth.residual
    assert rough.overturned > 0.02


def test_rough_fields_turn_faces_over_or_overflow_and_one_that_does_nothing_leaves_the_distance():
    """The flow of a continuous field tears nothing."""
    mesh = icosphere(3)
    f, g, field = turned(mesh, AXIS, 0.2)
    smooth, rough = (
        verify(mesh, f, g, v, subdivided=False) for v in (field, noisy(mesh, field, 10.0))
    )
    assert smooth.folded == smooth.overturned == 0
    assert rough.folded == 0
    assert rough.overturned > 0.2
    fields = np.stack([60 * noisy(mesh, field, 1.0)] * 40)
    wild = verify(mesh, 1e99 * f, 1e99 * g, fields, linearised=True)
    assert wild.subdivided == np.inf
    assert wild.checks_disagree
    varying = g - np.average(g, weights=vertex_areas(mesh))
    still, expected = verify(mesh, f, g, 0 * field), l2_norm(mesh, f - g) / l2_norm(mesh, varying)
    assert_allclose(still.flow_lines, expected, rtol=1e-8)
    assert_allclose(still.subdivided, expected, rtol=0.1)  # the same functions, other quadrature


def test_several_fields_and_channels():
    """Two turns that do not commute; of two channels, one with no weight does not count."""
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


def test_what_a_mask_hides_does_not_matter():
    mesh = icosphere(4)
    f, g, field = turned(mesh, AXIS, 0.2)
    mask = (mesh.vertices[:, 2] > -0.5).astype(float)
    hidden = np.where(mask > 0, [f, g], 1e3)
    clean, junk = (verify(mesh, *pair, field, mask=mask) for pair in ((f, g), hidden))
    assert junk == clean
    assert verify(mesh, *hidden, field).residual > 0.5


def test_linearised_steps_are_those_of_the_subdivided_mesh():
    """Many short ones are as good as the exponential, few long ones are not."""
    mesh = icosphere(3)
    f, g, field = turned(mesh, 0.3 * AXIS, 0.2)
    exact = verify(mesh, f, g, field)
    many, few = (verify(mesh, f, g, np.stack([field] * n), linearised=True) for n in (60, 1))
    assert_allclose(many.subdivided, exact.subdivided, rtol=0, atol=0.03)
    assert few.subdivided > 3 * exact.subdivided
    assert_allclose([many.flow_lines, few.flow_lines], exact.flow_lines, rtol=0.02)


def test_a_match_verifies_itself():
    mesh = icosphere(3)
    f, g, _ = turned(mesh, 0.5 * AXIS, 0.25)
    match = abfm.match(mesh, f, g, abfm.Parameters.of(iterations=30, segments=2))
    one = match.verify()
    assert isinstance(one, abfm.matching.Verification)
    assert one == abfm.matching.verify(match.problem, match.velocity)
    assert abs(one.residual - match.residual) < 0.1
    assert np.isnan(match.verify(subdivided=False).subdivided)


def test_the_subdivided_mesh_is_asked_only_where_wanted_and_possible(monkeypatch):
    mesh = icosphere(2)
    given = (mesh, *turned(mesh, AXIS, 0.3))
    one = verify(*given, subdivided=False)
    assert np.isnan(one.subdivided)
    assert not one.checks_disagree
    monkeypatch.setattr(verification, "SUBDIVIDED_LIMIT", len(mesh.vertices) - 1)
    assert np.isnan(verify(*given).subdivided)


@pytest.mark.parametrize(
    ("flow_lines", "subdivided", "checks_disagree"),
    [
        (0.01, 0.05, False),  # far below what anyone sees
        (0.10, 0.19, False),
        (0.10, 0.21, True),
        (0.30, 0.10, True),
        (0.50, 0.40, False),
        (0.02, np.inf, True),
        (0.02, np.nan, False),
    ],
)
def test_witnesses_that_disagree_are_doubtful(flow_lines, subdivided, checks_disagree):
    one = Verification(flow_lines, subdivided, 0.0, 0.0, 10.0)
    assert one.checks_disagree == checks_disagree
    assert one.residual == flow_lines
    assert ("disagree" in one.report()) == checks_disagree
    assert ("subdivided" in one.report()) == (not np.isnan(subdivided))


def test_the_report_says_what_is_too_narrow():
    check_message(Verification(0.1, 0.1, 0.012, 0.05, 3.0).report(), "0.1000", "1.2", "3.0")


def test_what_does_not_fit_is_refused():
    mesh = icosphere(1)
    f, g, field = turned(mesh, AXIS, 0.3)
    with raises(ParameterError, "velocity"):
        verify(mesh, f, g, field[1:])
