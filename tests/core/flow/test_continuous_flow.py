"""Points carried along the continuous field: exact, invertible, at home on boundaries."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from abfm.errors import ParameterError
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.maps.surface_points import project_onto_surface
from abfm.workers.control import CancelledError, Control, controlled
from tests.core.fields import rotation_field, wavy_field
from tests.core.surfaces import SURFACES
from tests.core.verification import observed_orders
from tests.shapes import disc, icosphere, square, torus

AXIS = np.array([0.3, -0.5, 0.8])


def mean_distance(points, others):
    """Root mean square of distances between rows (P, 3)."""
    return float(np.sqrt(((points - others) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("backwards", [False, True])
def test_a_rotating_sphere_turns_with_order_two(backwards):
    errors = []
    for level in (3, 4, 5):
        mesh = icosphere(level)
        flow = ContinuousFlow(mesh, rotation_field(mesh, AXIS), 2.0)
        points = (flow.origins() if backwards else flow.destinations()).positions
        exact = mesh.vertices @ Rotation.from_rotvec((-2 if backwards else 2) * AXIS).as_matrix().T
        errors.append(mean_distance(points / np.linalg.norm(points, axis=1, keepdims=True), exact))
    assert errors[-1] < 0.0005
    assert_allclose(observed_orders([4, 2, 1], errors), 2, rtol=0, atol=0.1)


def test_a_torus_turned_about_its_axis_turns_with_order_two():
    errors = []
    for n in (24, 48, 96):
        mesh = torus(n, n // 2)
        points = ContinuousFlow(mesh, rotation_field(mesh, [0, 0, 1]), 1.0).destinations()
        exact = mesh.vertices @ Rotation.from_rotvec([0, 0, 1.0]).as_matrix().T
        errors.append(mean_distance(points.positions, exact))
    assert observed_orders([4, 2, 1], errors).min() > 1.8


def test_a_constant_field_moves_the_plane_exactly_and_stops_at_its_sides():
    """Also at boundary vertices and in faces with two boundary edges."""
    mesh = square(7)
    field = np.tile([0.31, -0.17, 5.0], (len(mesh.faces), 1))  # the normal part is dropped
    points = ContinuousFlow(mesh, field, 1.0).destinations()
    exact = np.clip(mesh.vertices + np.array([0.31, -0.17, 0]), 0, 1)
    assert_allclose(points.positions, exact * [1, 1, 0], rtol=0, atol=1e-10)


def test_a_disc_turns_along_its_boundary():
    errors = []
    for n in (8, 16, 32):
        mesh = disc(n)
        points = ContinuousFlow(mesh, rotation_field(mesh, [0, 0, 1]), 1.5).destinations()
        exact = mesh.vertices @ Rotation.from_rotvec([0, 0, 1.5]).as_matrix().T
        errors.append(mean_distance(points.positions, exact))
    assert errors[-1] < 0.001
    # one less on the boundary itself, which is a line
    assert observed_orders([4, 2, 1], errors).min() > 1.5


def test_there_and_back_is_the_identity_in_the_limit():
    errors = []
    for n in (24, 48, 96):
        mesh = torus(n, n // 2)
        field = np.stack([wavy_field(mesh, 2), wavy_field(mesh, 5)])
        flow = ContinuousFlow(mesh, field, 0.2)
        back = flow.origins(flow.destinations())
        errors.append(mean_distance(back.positions, mesh.vertices))
    assert errors[-1] < 1e-3
    assert observed_orders([4, 2, 1], errors).min() > 1.5


def test_several_fields_follow_each_other():
    """Two quarter turns that do not commute, in this order; backwards the last is undone first."""
    mesh = icosphere(4)
    fields = np.stack(
        [rotation_field(mesh, [np.pi / 2, 0, 0]), rotation_field(mesh, [0, 0, np.pi / 2])]
    )
    turn = Rotation.from_rotvec([0, 0, np.pi / 2]) * Rotation.from_rotvec([np.pi / 2, 0, 0])
    flow, there = ContinuousFlow(mesh, fields, 2.0), mesh.vertices @ turn.as_matrix().T
    assert_allclose(flow.destinations().positions, there, rtol=0, atol=0.02)
    back = mesh.vertices @ turn.as_matrix()
    assert_allclose(flow.origins().positions, back, rtol=0, atol=0.02)


def test_equal_fields_in_a_row_are_one():
    mesh = torus(48, 24)
    field = wavy_field(mesh, 2)
    once = ContinuousFlow(mesh, field, 0.3).destinations()
    thrice = ContinuousFlow(mesh, np.stack([field] * 3), 0.3).destinations()
    assert_allclose(once.positions, thrice.positions, rtol=0, atol=2e-3)


@pytest.mark.parametrize("mesh", SURFACES.values(), ids=SURFACES)
def test_points_stay_on_the_surface_on_any_mesh(mesh):
    points = ContinuousFlow(mesh, 3 * wavy_field(mesh, 4), 1.0).destinations()
    assert (points.barycentric >= 0).all()
    assert_allclose(points.barycentric.sum(axis=1), 1, rtol=1e-12)
    landed = project_onto_surface(mesh, points.positions)
    assert_allclose(landed.distances_from(points.positions), 0, atol=1e-12)


def test_no_field_and_no_time_move_nothing():
    mesh = icosphere(2)
    for points in (
        ContinuousFlow(mesh, 0 * mesh.vertices[mesh.faces[:, 0]], 1.0).destinations(),
        ContinuousFlow(mesh, wavy_field(mesh, 1), 0).destinations(),
    ):
        assert_allclose(points.positions, mesh.vertices, rtol=0, atol=1e-10)


def test_points_do_not_jump_away_from_a_source():
    """Near a zero of the field steps are short although it is slow; growth is exponential."""
    mesh = disc(6)
    field = 3 * mesh.vertices[mesh.faces].mean(axis=1)
    near = project_onto_surface(mesh, mesh.vertices[:1] + np.array([1e-4, 2e-4, 0]))
    end = ContinuousFlow(mesh, field, 2.0).destinations(near).positions[0]
    assert_allclose(end, near.positions[0] * np.exp(6), rtol=0.2)


def test_the_caller_may_end_the_work_between_chunks():
    control, calls = Control(), []

    def heeds():
        calls.append(1)
        return len(calls) == 2

    control.cancel()
    mesh = torus(80, 60)
    with pytest.raises(CancelledError), controlled(control, heeds):
        ContinuousFlow(mesh, wavy_field(mesh, 2), 0.3).destinations()


@pytest.mark.parametrize("factor", [1e6, 1e200, 1e307])
def test_fields_that_would_take_very_long_are_refused(factor):
    mesh = icosphere(2)
    with pytest.raises(ParameterError, match=r"leads points over .* faces .* scale it down"):
        ContinuousFlow(mesh, factor * wavy_field(mesh, 1), 1.0)


def test_what_does_not_fit_is_refused():
    mesh = icosphere(1)
    field = wavy_field(mesh, 1)
    with pytest.raises(ParameterError, match="velocity has shape"):
        ContinuousFlow(mesh, field[1:], 1.0)
    with pytest.raises(ParameterError, match="not finite"):
        ContinuousFlow(mesh, np.full_like(field, np.nan), 1.0)
    for tau in (-1.0, np.inf, np.nan, np.ones(2)):
        with pytest.raises(ParameterError, match="tau is"):
            ContinuousFlow(mesh, field, tau)
