"""Maps of flow lines: times, inverses and distortion."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from abfm.calculus.operators import face_areas
from abfm.errors import ParameterError
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.flow.flow import Flow
from abfm.maps.distortion import chord_distortion, folded_shares
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import round_trip
from abfm.mesh.subdivision import subdivided
from abfm.workers.control import CancelledError, Control, controlled
from tests.core.fields import rotation_field, wavy_field
from tests.core.verification import near
from tests.messages import raises
from tests.shapes import disc, icosphere, square, torus

BALL = icosphere(3)
ROW = np.stack([0.3 * wavy_field(BALL, seed) for seed in (1, 2, 3)])
TURN = rotation_field(BALL, [0.3, -0.5, 0.8])


def centres(mesh):
    return mesh.vertices[mesh.faces].mean(axis=1)


def twist(mesh, speed):
    """Return a rotation about z that grows with height: it shears, and preserves areas."""
    x, y, z = centres(mesh).T
    return speed * np.stack([-z * y, z * x, 0 * z], axis=1)


def largest_distance(one, other):
    return np.linalg.norm(one.positions - other.positions, axis=1).max()


@pytest.mark.parametrize("fields", [TURN, ROW])
@pytest.mark.parametrize("inverse", [False, True])
def test_negative_times_give_the_inverse_map(fields, inverse):
    flow, lines = Flow(BALL, fields, 0.6), ContinuousFlow(BALL, fields, 0.6)
    moved = lines.destinations if inverse else lines.origins
    assert largest_distance(flow.point_map(inverse=inverse), moved()) == 0
    for t in (0.0, 0.1, 0.5, 0.9):
        found = flow.point_map(t, inverse)
        assert largest_distance(found, flow.point_map(-t, not inverse)) == 0
        there = flow.push(BALL.vertices, -t if inverse else t)
        assert np.linalg.norm(found.positions - there, axis=1).mean() < 0.02


@pytest.mark.parametrize("fields", [TURN, ROW])
@pytest.mark.parametrize("inverse", [False, True])
def test_maps_of_several_times_agree_with_single_maps(fields, inverse):
    flow, times = Flow(BALL, fields, 0.6), [0.0, 0.05, 0.3, 0.3, 0.8, 0.2, -0.1, -0.4]
    for t, found in zip(times, flow.point_maps(times, inverse), strict=True):
        assert largest_distance(found, flow.point_map(t, inverse)) < 0.01
    with raises(ParameterError):
        flow.point_maps([0.0, np.nan])
    with raises(ParameterError):
        flow.point_map(1e9)


@pytest.mark.parametrize("inverse", [False, True])
def test_finer_fields_map_the_mesh_itself(inverse):
    fine = subdivided(BALL)
    field = 0.3 * wavy_field(fine, 2)
    on_mesh, on_fine = (Flow(mesh, field).point_map(0.8, inverse) for mesh in (BALL, fine))
    assert on_mesh.codomain is BALL
    near(on_mesh.positions, on_fine.positions[: len(BALL.vertices)], 1e-9)
    found, finer = on_mesh.distortion(), on_fine.distortion()
    assert found.log2_area.mean == pytest.approx(finer.log2_area.mean, abs=0.02)
    assert found.folded == 0


def test_point_map_can_be_cancelled():
    control = Control()
    control.cancel()
    with controlled(control), pytest.raises(CancelledError):
        Flow(BALL, TURN).point_map()


MATRICES = [[[-1, 0], [0, -1]], [[-1, 0], [0, -2]], [[-1, 0.8], [0, -1]], [[-0.5, 1], [-1, -0.5]]]


@pytest.mark.parametrize("matrix", MATRICES)
def test_distortion_of_linear_flows_is_exact(matrix):
    """Distortion of linear flows is exact; they lead inwards, so that lines stay inside."""
    largest, smallest = np.linalg.svd(expm(np.array(matrix)), compute_uv=False)
    exact, errors = np.log2([largest * smallest, largest / smallest]), []
    for n in (10, 20, 40):
        mesh = disc(n)
        field = np.pad(centres(mesh)[:, :2] @ np.transpose(matrix), ((0, 0), (0, 1)))
        found = Flow(mesh, field).distortion()
        logs = np.log2(np.stack([found.area, found.conformal], axis=1))
        errors.append(np.average(abs(logs - exact), axis=0, weights=face_areas(mesh)))
        summaries = np.array([found.log2_area, found.log2_shape])
        assert (abs(summaries - np.abs(exact)[:, None])[:, :3] < 0.06).all()
        assert found.folded == 0
    assert (np.array(errors[:-1]) > 1.6 * np.array(errors[1:])).all()
    assert errors[2].max() < 0.003


def test_twist_shears_and_preserves_areas():
    """A shear by k has the shape change R, the square of (k + sqrt(k^2 + 4)) / 2."""
    errors = []
    for level in (3, 4, 5):
        mesh, speed = icosphere(level), 1.5
        flow = Flow(mesh, twist(mesh, speed))
        k = speed * (1 - (centres(mesh)[:, 2] / np.linalg.norm(centres(mesh), axis=1)) ** 2)
        exact = 2 * np.log2((k + np.sqrt(k**2 + 4)) / 2)
        found, areas = flow.distortion(), face_areas(mesh)
        errors.append([np.average(abs(np.log2(found.conformal) - exact), weights=areas)])
        errors[-1] += [found.log2_area.mean]
        assert found.log2_shape.mean == pytest.approx(np.average(exact, weights=areas), abs=0.05)
    assert (np.array(errors[:-1]) > 1.8 * np.array(errors[1:])).all()


def test_rigid_motions_have_no_distortion():
    found = Flow(BALL, np.zeros_like(TURN)).distortion()
    for summary in (found.log2_area, found.log2_shape):
        near(summary, 0, 1e-6)
    mesh = torus(48, 24)
    found = Flow(mesh, rotation_field(mesh, [0, 0, 1]), 2 * np.pi / 24).distortion()
    for summary in (found.log2_area, found.log2_shape):
        near(summary, 0, 0.03)


def test_distortion_is_measured_inside_faces():
    """Distortion is that inside faces; triangles between mapped corners would count many folds."""
    mesh = icosphere(2)
    there = Flow(mesh, twist(mesh, 6.0)).point_map(inverse=True)
    chords, parts = chord_distortion(mesh, there.positions), there.distortion()
    assert parts.log2_area.mean < 0.2 * chords.log2_area.mean
    assert chords.folded > 0.2 * len(mesh.faces)
    assert parts.folded == 0


@pytest.mark.parametrize("seed", range(7))
@pytest.mark.parametrize("t", [0.6, 1.2])
def test_smooth_flows_fold_no_face(seed, t):
    flow = Flow(BALL, wavy_field(BALL, seed) if seed else twist(BALL, 6.0))
    there, back = flow.point_map(t, inverse=True), flow.point_map(t)
    for found in (there, back):
        faces = np.arange(len(BALL.faces))
        folded, flipped = folded_shares(
            BALL, found.interior_map, faces, found.positions[BALL.faces], len(faces)
        )
        assert found.distortion().folded == round(folded * len(faces))
        assert chord_distortion(BALL, found.positions).folded == round(flipped * len(faces))
        assert folded == 0
        assert flipped > 0 or seed == 1 or t < 1
    assert round_trip(there, back.at).median < 0.1


def test_round_trip_is_measured_in_edges():
    mesh = square(8)
    still = PointMap.of_vertices(mesh, mesh)
    assert round_trip(still, still.at) == (0, 0)
    moved = PointMap.project(mesh, mesh, mesh.vertices * 0.9)
    found = round_trip(still, moved.at)
    lengths = np.linalg.norm(np.diff(mesh.vertices[mesh.edges], axis=1), axis=2).ravel()
    local = [lengths[(mesh.edges == v).any(axis=1)].mean() for v in range(len(mesh.vertices))]
    expected = np.linalg.norm(0.1 * mesh.vertices, axis=1) / local
    assert_allclose(found, np.percentile(expected, (50, 95)), rtol=1e-9)
    assert round_trip(moved, still.at).median == pytest.approx(found.median)
    assert Flow(BALL, ROW, 0.5).round_trip().median < 0.1
