"""Points carried along the continuous field: exact where the flow is known, invertible, at home on boundaries."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from abfm.errors import ParameterError
from abfm.flow.continuous_flow import flow_map
from abfm.maps.surface_points import SurfacePoints, project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from tests.core.fields import rotation_field, wavy_field
from tests.core.surfaces import SURFACES
from tests.core.verification import observed_orders
from tests.shapes import disc, icosphere, square, torus

AXIS = np.array([0.3, -0.5, 0.8])


def mean_distance(points: FloatArray, others: FloatArray) -> float:
    """Root mean square of distances between rows (P, 3)."""
    return float(np.sqrt(((points - others) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("backwards", [False, True])
def test_a_rotating_sphere_turns_with_order_two(backwards: bool) -> None:
    errors = []
    for level in (3, 4, 5):
        mesh = icosphere(level)
        points = flow_map(mesh, rotation_field(mesh, AXIS), 2.0, backwards=backwards).positions
        exact = mesh.vertices @ Rotation.from_rotvec((-2 if backwards else 2) * AXIS).as_matrix().T
        errors.append(mean_distance(points / np.linalg.norm(points, axis=1, keepdims=True), exact))
    assert errors[-1] < 0.0005
    assert_allclose(observed_orders([4, 2, 1], errors), 2, rtol=0, atol=0.1)


def test_a_torus_turned_about_its_axis_turns_with_order_two() -> None:
    errors = []
    for n in (24, 48, 96):
        mesh = torus(n, n // 2)
        points = flow_map(mesh, rotation_field(mesh, [0, 0, 1]), 1.0)
        exact = mesh.vertices @ Rotation.from_rotvec([0, 0, 1.0]).as_matrix().T
        errors.append(mean_distance(points.positions, exact))
    assert observed_orders([4, 2, 1], errors).min() > 1.8


def test_a_constant_field_moves_the_plane_exactly_and_stops_at_its_sides() -> None:
    """Boundary vertices and faces with two boundary edges included: the field is constant there too."""
    mesh = square(7)
    field = np.tile([0.31, -0.17, 5.0], (len(mesh.faces), 1))  # the normal part is dropped
    points = flow_map(mesh, field, 1.0)
    exact = np.clip(mesh.vertices + np.array([0.31, -0.17, 0]), 0, 1)
    assert_allclose(points.positions, exact * [1, 1, 0], rtol=0, atol=1e-10)


def test_a_disc_turns_along_its_boundary() -> None:
    errors = []
    for n in (8, 16, 32):
        mesh = disc(n)
        points = flow_map(mesh, rotation_field(mesh, [0, 0, 1]), 1.5)
        exact = mesh.vertices @ Rotation.from_rotvec([0, 0, 1.5]).as_matrix().T
        errors.append(mean_distance(points.positions, exact))
    assert errors[-1] < 0.001
    assert observed_orders([4, 2, 1], errors).min() > 1.5  # one less on the boundary itself, which is a line


def test_there_and_back_is_the_identity_in_the_limit() -> None:
    errors = []
    for n in (24, 48, 96):
        mesh = torus(n, n // 2)
        field = np.stack([wavy_field(mesh, 2), wavy_field(mesh, 5)])
        there = flow_map(mesh, field, 0.2)
        errors.append(mean_distance(flow_map(mesh, field, 0.2, backwards=True, start=there).positions, mesh.vertices))
    assert errors[-1] < 1e-3
    assert observed_orders([4, 2, 1], errors).min() > 1.5


def test_several_fields_follow_each_other() -> None:
    """Two quarter turns that do not commute, in this order; backwards the last is undone first."""
    mesh = icosphere(4)
    fields = np.stack([rotation_field(mesh, [np.pi / 2, 0, 0]), rotation_field(mesh, [0, 0, np.pi / 2])])
    turn = Rotation.from_rotvec([0, 0, np.pi / 2]) * Rotation.from_rotvec([np.pi / 2, 0, 0])
    assert_allclose(flow_map(mesh, fields, 2.0).positions, mesh.vertices @ turn.as_matrix().T, rtol=0, atol=0.02)
    back = flow_map(mesh, fields, 2.0, backwards=True)
    assert_allclose(back.positions, mesh.vertices @ turn.as_matrix(), rtol=0, atol=0.02)


def test_equal_fields_in_a_row_are_one() -> None:
    mesh = torus(48, 24)
    field = wavy_field(mesh, 2)
    once, thrice = flow_map(mesh, field, 0.3), flow_map(mesh, np.stack([field] * 3), 0.3)
    assert_allclose(once.positions, thrice.positions, rtol=0, atol=2e-3)


@pytest.mark.parametrize("scale", [1e-55, 1e-3, 1e55])
def test_units_do_not_matter(scale: float) -> None:
    mesh = torus(14, 9)
    field = wavy_field(mesh, 2)
    scaled = TriangleMesh(scale * mesh.vertices, mesh.faces)
    points, others = flow_map(mesh, field, 0.3), flow_map(scaled, scale * 20 * field, 0.3 / 20)
    assert_allclose(others.positions / scale, points.positions, rtol=0, atol=1e-9)


@pytest.mark.parametrize("mesh", SURFACES.values(), ids=SURFACES)
def test_points_stay_on_the_surface_on_any_mesh(mesh: TriangleMesh) -> None:
    points = flow_map(mesh, 3 * wavy_field(mesh, 4), 1.0)
    assert (points.barycentric >= 0).all()
    assert_allclose(points.barycentric.sum(axis=1), 1, rtol=1e-12)
    assert_allclose(project_onto_surface(mesh, points.positions).distances, 0, atol=1e-12)


def test_the_same_input_gives_the_same_bits_in_any_company() -> None:
    mesh = torus(80, 60)  # more than one chunk
    field = wavy_field(mesh, 2)
    points = flow_map(mesh, field, 0.3)
    some = SurfacePoints(
        *(getattr(points, name)[4000:4200] for name in ("faces", "barycentric", "positions", "distances"))
    )
    again = flow_map(mesh, field, 0.2, start=points)
    assert_array_equal(flow_map(mesh, field, 0.3).positions, points.positions)
    assert_array_equal(flow_map(mesh, field, 0.2, start=some).positions, again.positions[4000:4200])


def test_no_field_and_no_time_move_nothing() -> None:
    mesh = icosphere(2)
    for points in (flow_map(mesh, 0 * mesh.vertices[mesh.faces[:, 0]], 1.0), flow_map(mesh, wavy_field(mesh, 1), 0)):
        assert_allclose(points.positions, mesh.vertices, rtol=0, atol=1e-10)


def test_points_do_not_jump_away_from_a_source() -> None:
    """Near a zero of the field a step is short although the field is slow; growth is exponential."""
    mesh = disc(6)
    field = 3 * mesh.vertices[mesh.faces].mean(axis=1)
    near = project_onto_surface(mesh, mesh.vertices[:1] + np.array([1e-4, 2e-4, 0]))
    end = flow_map(mesh, field, 2.0, start=near).positions[0]
    assert_allclose(end, near.positions[0] * np.exp(6), rtol=0.2)


def test_the_caller_may_end_the_work_between_chunks() -> None:
    class EnoughError(Exception):
        pass

    calls = []

    def between() -> None:
        calls.append(1)
        if len(calls) == 2:
            raise EnoughError

    mesh = torus(80, 60)
    with pytest.raises(EnoughError):
        flow_map(mesh, wavy_field(mesh, 2), 0.3, between=between)


@pytest.mark.parametrize("factor", [1e6, 1e200, 1e307])
def test_fields_that_would_take_very_long_are_refused(factor: float) -> None:
    mesh = icosphere(2)
    with pytest.raises(ParameterError, match=r"leads points over .* faces .* scale it down"):
        flow_map(mesh, factor * wavy_field(mesh, 1), 1.0)


def test_what_does_not_fit_is_refused() -> None:
    mesh = icosphere(1)
    field = wavy_field(mesh, 1)
    with pytest.raises(ParameterError, match="velocity has shape"):
        flow_map(mesh, field[1:], 1.0)
    with pytest.raises(ParameterError, match="not finite"):
        flow_map(mesh, np.full_like(field, np.nan), 1.0)
    for tau in (-1.0, np.inf, np.nan, np.ones(2)):
        with pytest.raises(ParameterError, match="tau is"):
            flow_map(mesh, field, tau)  # type: ignore[arg-type]
