import igl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.assets import asset_path
from abfm.errors import AbfmError
from abfm.experiments.fields import departure_points, stream_field
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.flow.flow import Flow
from abfm.maps import quality
from abfm.maps.distortion import CUT_FACES_MAX, chord_distortion, folded_shares, stretches_by_parts
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import FOLDED_SHARE_MAX, MapAccuracy, MapQuality, map_accuracy, map_quality
from abfm.maps.surface_points import project_onto_surface, vertex_points
from abfm.mesh import TriangleMesh, load_mesh
from tests.core.fields import rotation_field, wavy_field
from tests.messages import check_message, raises
from tests.shapes import icosphere, square, torus

LARGEST, RMS = quality.DISTANCE_MAX, quality.RMS_DISTANCE_MAX
RING = torus(24, 12)


def errors_of(mesh, target=None, *truth, **options):
    return map_accuracy(PointMap.of_vertices(mesh, mesh, target), *truth, **options).errors


def test_errors_in_the_plane_are_euclidean():
    mesh = square(8)
    target = np.random.default_rng(0).permutation(len(mesh.vertices))
    expected = np.linalg.norm(mesh.vertices[target] - mesh.vertices, axis=1)
    assert_allclose(errors_of(mesh, target), expected, atol=1e-12)
    assert_array_equal(errors_of(mesh), 0)
    assert_array_equal(errors_of(mesh, target, target), 0)


def test_errors_of_points_inside_faces_are_distances():
    mesh = square(8)
    places = np.random.default_rng(1).uniform(0, 1, (len(mesh.vertices), 3)) * [1, 1, 0]
    points = PointMap.project(mesh, mesh, places)
    off = map_accuracy(points).errors - np.linalg.norm(points.positions - mesh.vertices, axis=1)
    assert off.min() >= -1e-12
    assert off.max() < 0.2 / 8
    assert off.mean() < 0.03 / 8


def test_errors_of_a_rotated_sphere_are_arcs():
    sphere, c, s = icosphere(4), np.cos(0.5), np.sin(0.5)
    turned = sphere.vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    found = map_accuracy(PointMap.project(sphere, sphere, turned), count_max=200)
    arcs = np.arccos((turned * sphere.vertices).sum(axis=1).clip(-1, 1))[found.vertices]
    assert_allclose(found.errors, arcs / np.sqrt(4 * np.pi), atol=0.003)


def test_errors_agree_with_exact_geodesics():
    human = load_mesh(asset_path("human_A.off")).normalized()
    count, none = len(human.vertices), np.array([], dtype=np.int64)
    to = np.arange(count)
    exact = igl.exact_geodesic(human.vertices, human.faces, np.array([100]), none, to, none)
    close = np.flatnonzero(exact < 0.3)
    off = errors_of(human, None, np.full(count, 100), count_max=count)[close] - exact[close]
    assert off.min() >= -1e-9
    assert off.max() < 0.02
    assert off.mean() < 0.002


def test_sampled_vertices_are_deterministic():
    identity = PointMap.of_vertices(RING, RING)
    first, again = (map_accuracy(identity, count_max=30).vertices for _ in range(2))
    assert_array_equal(first, again)
    assert len(np.unique(first)) == 30


@given(
    st.lists(st.floats(0, 2), min_size=1, max_size=30),
    st.lists(st.floats(-1, 3), min_size=1, max_size=9),
)
def test_share_under_a_bound_counts_errors(errors, bounds):
    accuracy = MapAccuracy(np.arange(len(errors)), np.array(errors))
    expected = [np.mean(np.array(errors) <= bound) for bound in bounds]
    assert_array_equal(accuracy.share_under(bounds), expected)
    assert accuracy.share_under(accuracy.maximum) == 1
    assert accuracy.median <= accuracy.maximum


def test_quality_beyond_a_bound_is_a_fault():
    accuracy = MapAccuracy(np.arange(4), np.array([0.0, 0.01, 0.06, 0.3]))
    errors, bounds = ("0.0925", "0.0350", "0.3000"), ("0.05", "0.1", "0.25")
    check_message(accuracy.report(), *errors, "50.0", "75.0", *bounds)
    check_message(MapQuality(0.25, 0.0125, 0.031).report(), "0.25", "0.0125", "3.1")
    for over in np.diag([1.01 * LARGEST, 1.01 * RMS, 1.01 * FOLDED_SHARE_MAX]):
        assert MapQuality(*over).faults
    assert not MapQuality(LARGEST, RMS, FOLDED_SHARE_MAX).faults


def test_invalid_arguments_are_refused():
    count = len(RING.vertices)
    for truth, options, named in (
        (np.arange(3), {}, "truth"),
        (np.arange(count) + 1, {}, 0),
        (None, {"count_max": 0}, 1),
    ):
        with raises(AbfmError, named):
            errors_of(RING, None, truth, **options)
    with raises(AbfmError):
        PointMap.of_vertices(RING, RING, np.arange(5))


def test_isometries_have_no_faults():
    for codomain in (RING, TriangleMesh(7 * RING.vertices[:, [1, 2, 0]], RING.faces)):
        found = map_quality(PointMap.of_vertices(RING, codomain))
        assert (found, found.faults) == (MapQuality(0.0, 0.0, 0.0), "")


@pytest.mark.parametrize("unit", [1e-3, 1.0, 50.0])
def test_distances_from_the_surface_do_not_depend_on_unit(unit):
    flat = square(8)
    mesh, off = TriangleMesh(2 * unit * flat.vertices, flat.faces), np.linspace(0, 0.3, 81)
    moved = mesh.vertices + 2 * unit * np.outer(off, [0, 0, 1])
    found = map_quality(PointMap.project(mesh, mesh, moved))
    assert found.largest_distance == pytest.approx(0.3)
    assert found.rms_distance == pytest.approx(np.sqrt(np.mean(off**2)))
    assert found.folded == 0
    check_message(found.faults, "0.3")
    assert "folded" not in found.faults


def test_reflection_folds_all_faces_and_a_moved_vertex_few():
    mirrored = map_quality(PointMap.project(RING, RING, RING.vertices * [1, 1, -1]))
    assert mirrored.folded == 1
    assert mirrored.largest_distance < 1e-12
    check_message(mirrored.faults, "100%")
    flat = square(6)
    dragged = flat.vertices.copy()
    dragged[np.argmin(np.linalg.norm(flat.vertices - [0.5, 0.5, 0], axis=1))] += [0.3, 0, 0]
    few = map_quality(PointMap.project(flat, flat, dragged))
    assert few.folded == chord_distortion(flat, dragged).flipped.sum() / len(flat.faces)
    assert 0 < few.folded < FOLDED_SHARE_MAX
    assert not few.faults


def test_folds_refer_to_normals_of_the_codomain():
    """A rotation has no folds, although it reverses half of the normals in space."""
    mesh = icosphere(2)
    turned = TriangleMesh(mesh.vertices * [-1, -1, 1], mesh.faces)
    assert map_quality(PointMap.of_vertices(mesh, turned)).folded == 0
    inside_out = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    assert chord_distortion(mesh, mesh.vertices, inside_out).flipped.all()


SURFACES = {
    "eight": load_mesh(asset_path("eight.off")),
    "torus": torus(40, 20),
    "sphere": icosphere(3),
}


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("modes", [{1: 1.0, 2: 1.0}, {5: 1.0, 8: 1.0}])
@pytest.mark.parametrize("speed", [0.1, 0.3, 0.6])
def test_maps_without_faults_agree_with_flow_lines(name, modes, speed):
    mesh = SURFACES[name]
    field = stream_field(mesh, modes, speed)
    points = Flow(mesh, field).coordinate_map()
    found = map_quality(points)
    off = points.positions - departure_points(mesh, field, np.ones(1))[0]
    errors = np.linalg.norm(off, axis=1) / mesh.length_scale
    assert found.faults or errors.mean() < 0.025
    assert found.largest_distance <= LARGEST or errors.max() > 0.15
    assert found.rms_distance <= RMS or errors.mean() > 0.028


def by_positions(mesh, move):
    """Return a map of the surface from a map of space."""
    return lambda points: project_onto_surface(mesh, move(points.positions))


def shares(mesh, point_map, most=CUT_FACES_MAX):
    images = point_map(vertex_points(mesh)).positions
    return folded_shares(mesh, point_map, np.arange(len(mesh.faces)), images[mesh.faces], most)


def folded_over(x):
    """Fold half of the unit square onto the other half."""
    return np.abs(x * [2, 1, 1] - [1, 0, 0])


def test_folded_shares_of_known_maps_are_exact():
    mesh, ball = square(6), icosphere(3)
    assert shares(mesh, by_positions(mesh, lambda x: x * [-1, 1, 1] + [1, 0, 0])) == (1, 1)
    assert shares(ball, by_positions(ball, lambda x: x * [-1, 1, 1])) == (1, 1)
    assert shares(mesh, by_positions(mesh, lambda x: x * [0, 1, 1] + [0.3, 0, 0]))[0] == 0
    mesh = square(40)
    folded, flipped = shares(mesh, by_positions(mesh, folded_over))
    left = (mesh.vertices[mesh.faces].mean(axis=1)[:, 0] < 0.5).mean()
    assert abs(folded - left) < 0.02
    assert folded <= flipped


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_smooth_flows_fold_nothing(seed):
    """At most 5% of the faces that seem flipped, because they are stretched, are folded."""
    mesh = icosphere(3)
    turn, field = rotation_field(mesh, [1, 0, 0]), 5 * wavy_field(mesh, seed)
    assert shares(mesh, ContinuousFlow(mesh, turn, 1.0).destinations) == (0, 0)
    folded, flipped = shares(mesh, ContinuousFlow(mesh, field, 0.2).destinations)
    assert flipped > 0.02
    assert folded < 0.05 * flipped


def test_folded_share_of_sampled_faces_is_accurate():
    mesh, sizes = square(30), []
    point_map = by_positions(mesh, folded_over)

    def counted(start):
        sizes.append(len(start.faces))
        return point_map(start)

    assert abs(shares(mesh, counted, 50)[0] - shares(mesh, point_map)[0]) < 0.05
    assert sizes == [len(mesh.vertices), 50 * 45]


def test_parts_cover_a_face():
    mesh = square(3)
    half = by_positions(mesh, lambda x: np.abs(x - [0.5, 0, 0]) + np.array([0.25, 0, 0]))
    flipped, _ = stretches_by_parts(mesh, half, np.arange(len(mesh.faces)))
    left = (mesh.vertices[mesh.faces][..., 0] < 0.5).sum(axis=1)
    assert (flipped[left == 3] == 1).all()
    assert (flipped[left == 0] == 0).all()
    mixed = flipped[(left > 0) & (left < 3)]
    assert ((mixed > 0) & (mixed < 1)).all()
