"""Fields made continuous, and points moved along them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from abfm.calculus.operators import face_frames
from abfm.errors import ParameterError
from abfm.flow.continuous_flow import ContinuousFlow, Walker, smooth_flow, walk_straight
from abfm.flow.flow_lines import flow_lines
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.streaks.line_integral import direction
from abfm.workers.control import CancelledError, Control, controlled
from tests.core.fields import rotation_field, wavy_field
from tests.core.surfaces import SURFACES
from tests.core.verification import near, observed_orders
from tests.messages import raises
from tests.shapes import disc, icosphere, open_cylinder, square, torus

AXIS = np.array([0.3, -0.5, 0.8])


def in_space(mesh, field):
    """Return the vectors of the continuous field at corners (F, 3, 3)."""
    places = mesh.vertices[mesh.faces]
    corners = np.einsum("fcx,fkx->fck", places - places[:, :1], face_frames(mesh))
    weights = np.concatenate([np.ones((*corners.shape[:2], 1)), corners], axis=2)
    vectors = smooth_flow(mesh, field).vectors
    return np.einsum("fcj,fjk,fkx->fcx", weights, vectors, face_frames(mesh))


def walked(mesh, field, face, step, count, turns=1):
    """Return places (n, 3) after steps from a face's centre, and as many steps back."""
    frames, places, flow = face_frames(mesh), mesh.vertices[mesh.faces], smooth_flow(mesh, field)
    x, y = (frames[face] @ (places[face].mean(axis=0) - places[face, 0])).tolist()
    f, found = face, []
    for turn in range(turns):
        u, v = 0.0, 0.0
        for _ in range(count):
            walker = direction(flow, Walker(f, x, y, u, v), (-1) ** turn * step, 0.0)
            f, x, y, u, v = walk_straight(flow, walker)
            found.append(places[f, 0] + np.array([x, y]) @ frames[f])
            assert f >= 0
    return np.array(found)


def test_constant_fields_are_preserved():
    mesh = square(5)
    field = np.tile([0.3, -2.0, 0.0], (len(mesh.faces), 1))
    np.testing.assert_allclose(in_space(mesh, field), np.tile(field[:, None], (1, 3, 1)))


def test_linear_fields_are_reproduced_inside():
    mesh = square(8)
    matrix = np.array([[1.0, -2.0, 0], [0.5, 0.7, 0], [0, 0, 0]])
    corners = mesh.vertices[mesh.faces]
    found, exact = in_space(mesh, corners.mean(axis=1) @ matrix.T), corners @ matrix.T
    near(found, exact, 0.2)  # larger errors in a corner with one face
    inside = (np.abs(corners - 0.5)[..., :2] < 0.49).all(axis=2)
    near(found[inside], exact[inside], 0.01)


def test_creases_do_not_change_the_field():
    """A flat mesh folded along its lines has the same vectors in the frames of its faces."""
    uneven = square(6)
    x, y = (grid.ravel() / 6 for grid in np.meshgrid(np.arange(7), np.arange(7), indexing="ij"))
    flat = TriangleMesh(np.stack([x, y, 0 * x], axis=1), uneven.faces)
    zigzag = np.abs((6 * x + 1) % 2 - 1) / 6  # along lines of the mesh
    folded = TriangleMesh(np.stack([0.5 * x, y, np.sqrt(0.75) * zigzag], axis=1), flat.faces)
    field = wavy_field(flat, 3)
    coefficients = np.einsum("fkx,fx->fk", face_frames(flat), field)
    on_folded = np.einsum("fkx,fk->fx", face_frames(folded), coefficients)
    near(smooth_flow(folded, on_folded).vectors, smooth_flow(flat, field).vectors, 1e-12)


def test_error_falls_with_the_squared_edge_length():
    axis, errors = np.array([0.2, -0.3, 1.0]), []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        found = np.linalg.norm(in_space(mesh, rotation_field(mesh, axis)), axis=2)
        speeds = np.linalg.norm(np.cross(axis, mesh.vertices), axis=1)[mesh.faces]
        errors.append(np.sqrt(((found - speeds) ** 2).mean()))
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


@pytest.mark.parametrize("mesh", [icosphere(2), torus(14, 9), open_cylinder(9, 4)])
def test_both_sides_of_an_edge_agree(mesh):
    field = wavy_field(mesh, 2)
    vectors, jumps, before = in_space(mesh, field), [], []
    for edge in np.flatnonzero((mesh.edge_faces >= 0).all(axis=1)):
        ends = mesh.edges[edge]
        along = mesh.vertices[ends[1]] - mesh.vertices[ends[0]]
        along /= np.linalg.norm(along)
        f, g = mesh.edge_faces[edge]
        for end in ends:
            sides = [vectors[h, int(np.argmax(mesh.faces[h] == end))] for h in (f, g)]
            jumps.append(abs(sides[0] @ along - sides[1] @ along))
        before.append(abs((field[f] - field[g]) @ along))
    assert np.sqrt(np.mean(np.square(jumps))) < 0.35 * np.sqrt(np.mean(np.square(before)))


def test_flow_lines_follow_circles():
    mesh, centre = square(9), np.array([0.53, 0.46, 0.0])
    field = np.cross([0, 0, 1], mesh.vertices[mesh.faces].mean(axis=1) - centre)
    face = int(project_onto_surface(mesh, [[0.72, 0.6, 0.0]]).faces[0])
    first = mesh.vertices[mesh.faces[face]].mean(axis=0)
    radius = float(np.linalg.norm(first - centre))
    smooth = walked(mesh, field, face, radius / 100, 628)
    exact = flow_lines(mesh, field, project_onto_surface(mesh, first[None]), 2 * np.pi)[0].positions
    of_smooth, of_exact = (
        np.abs(np.linalg.norm(places - centre, axis=1) - radius).max() / radius
        for places in (smooth, exact)
    )
    assert of_smooth < 0.01
    assert of_smooth < 0.3 * of_exact


def test_reversed_flow_line_returns():
    mesh = torus(20, 14)
    end = walked(mesh, wavy_field(mesh, 2), 5, 0.01, 100, turns=2)[-1]
    near(end, mesh.vertices[mesh.faces[5]].mean(axis=0), 0.003)


def mean_distance(points, others):
    """Return the root mean square of distances between rows (P, 3)."""
    return float(np.sqrt(((points - others) ** 2).sum(axis=1).mean()))


def errors_of_turns(meshes, axis, time, backwards=False):
    """Return the distance of points from their rotated places, for each mesh."""
    errors, turn = [], Rotation.from_rotvec((-1 if backwards else 1) * time * np.asarray(axis))
    for mesh in meshes:
        flow = ContinuousFlow(mesh, rotation_field(mesh, axis), time)
        points = (flow.origins() if backwards else flow.destinations()).positions
        if mesh.genus == 0 and mesh.is_closed:
            points = points / np.linalg.norm(points, axis=1, keepdims=True)
        errors.append(mean_distance(points, mesh.vertices @ turn.as_matrix().T))
    return errors


@pytest.mark.parametrize("backwards", [False, True])
def test_rotation_of_a_sphere_has_order_two(backwards):
    errors = errors_of_turns([icosphere(level) for level in (3, 4, 5)], AXIS, 2.0, backwards)
    assert errors[-1] < 0.0005
    near(observed_orders([4, 2, 1], errors), 2, 0.1)


def test_rotations_of_torus_and_disc_converge():
    errors = errors_of_turns([torus(n, n // 2) for n in (24, 48, 96)], [0, 0, 1.0], 1.0)
    assert observed_orders([4, 2, 1], errors).min() > 1.8
    errors = errors_of_turns([disc(n) for n in (8, 16, 32)], [0, 0, 1.0], 1.5)
    assert errors[-1] < 0.001
    # order 1 on the boundary itself
    assert observed_orders([4, 2, 1], errors).min() > 1.5


def test_constant_field_moves_the_plane_up_to_its_sides():
    mesh = square(7)
    field = np.tile([0.31, -0.17, 5.0], (len(mesh.faces), 1))  # the normal part is dropped
    exact = np.clip(mesh.vertices + np.array([0.31, -0.17, 0]), 0, 1) * [1, 1, 0]
    near(ContinuousFlow(mesh, field, 1.0).destinations().positions, exact, 1e-10)


def test_round_trip_converges_to_the_identity():
    errors = []
    for n in (24, 48, 96):
        mesh = torus(n, n // 2)
        flow = ContinuousFlow(mesh, np.stack([wavy_field(mesh, 2), wavy_field(mesh, 5)]), 0.2)
        errors.append(mean_distance(flow.origins(flow.destinations()).positions, mesh.vertices))
    assert errors[-1] < 1e-3
    assert observed_orders([4, 2, 1], errors).min() > 1.5


def test_several_fields_are_applied_in_order():
    mesh, axes = icosphere(4), np.pi / 2 * np.array([[1.0, 0, 0], [0, 0, 1.0]])
    flow = ContinuousFlow(mesh, np.stack([rotation_field(mesh, axis) for axis in axes]), 2.0)
    first, second = (Rotation.from_rotvec(axis) for axis in axes)
    turn = (second * first).as_matrix()
    near(flow.destinations().positions, mesh.vertices @ turn.T, 0.02)
    near(flow.origins().positions, mesh.vertices @ turn, 0.02)
    mesh = torus(48, 24)
    field = wavy_field(mesh, 2)
    once, thrice = (ContinuousFlow(mesh, np.stack([field] * n), 0.3) for n in (1, 3))
    near(once.destinations().positions, thrice.destinations().positions, 2e-3)


@pytest.mark.parametrize("mesh", SURFACES.values(), ids=SURFACES)
def test_points_stay_on_any_surface(mesh):
    points = ContinuousFlow(mesh, 3 * wavy_field(mesh, 4), 1.0).destinations()
    assert (points.barycentric >= 0).all()
    np.testing.assert_allclose(points.barycentric.sum(axis=1), 1, rtol=1e-12)
    near(project_onto_surface(mesh, points.positions).distances_from(points.positions), 0, 1e-12)


def test_zero_field_or_time_moves_nothing():
    mesh = icosphere(2)
    for field, tau in ((np.zeros((len(mesh.faces), 3)), 1.0), (wavy_field(mesh, 1), 0)):
        near(ContinuousFlow(mesh, field, tau).destinations().positions, mesh.vertices, 1e-10)
    mesh = icosphere(1)
    field = rotation_field(mesh, [0, 0, 1])
    field[::3] = 0
    assert (smooth_flow(mesh, field).vectors[::3] == 0).all()


def test_points_do_not_jump_away_from_a_source():
    """Near a source, where the field is slow, distances grow exponentially, without jumps."""
    mesh = disc(6)
    start = project_onto_surface(mesh, mesh.vertices[:1] + np.array([1e-4, 2e-4, 0]))
    end = ContinuousFlow(mesh, 3 * mesh.vertices[mesh.faces].mean(axis=1), 2.0).destinations(start)
    np.testing.assert_allclose(end.positions, start.positions * np.exp(6), rtol=0.2)


def test_work_can_be_cancelled_between_chunks():
    control, calls = Control(), []

    def is_active():
        calls.append(1)
        return len(calls) == 2

    control.cancel()
    mesh = torus(80, 60)
    with pytest.raises(CancelledError), controlled(control, is_active):
        ContinuousFlow(mesh, wavy_field(mesh, 2), 0.3).destinations()


def test_invalid_or_very_long_flows_are_refused():
    mesh = icosphere(2)
    field = wavy_field(mesh, 1)
    wrong = [(field[1:], 1.0, "velocity"), (field * np.nan, 1.0, "")]
    wrong += [(field, tau, "tau") for tau in (-1.0, np.inf, np.nan, np.ones(2))]
    wrong += [(factor * field, 1.0, "") for factor in (1e6, 1e200, 1e307)]
    for velocity, tau, named in wrong:
        with raises(ParameterError, named):
            ContinuousFlow(mesh, velocity, tau)
