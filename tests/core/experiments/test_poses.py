"""Small versions of figures 11 to 13: maps between two poses, improved by flows."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.calculus.operators import cotangent_laplacian, l2_norm
from abfm.errors import MeshError
from abfm.experiments import FigureSetup, findings_of
from abfm.experiments import figure_11 as maps
from abfm.maps.functional_maps import spectral_coefficients
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import map_accuracy
from abfm.matching.match import match
from abfm.mesh import TriangleMesh
from abfm.parameters import TABLE_1
from tests.core.experiments.small import assert_maps_are_measured, ran, run, stated, values
from tests.messages import raises
from tests.shapes import ellipsoid, open_cylinder, tetrahedron, torus

SMALL = FigureSetup(small=True)


def compared(poses, problem):
    """Return the comparison of all methods; solve the matches that a figure requests."""
    script = maps.compare(poses, problem, SMALL)
    return findings_of(script, SMALL.match(next(script)))


@pytest.fixture(scope="module")
def poses():
    return maps.Poses.of(SMALL)


@pytest.fixture(scope="module")
def comparison(poses):
    return compared(poses, ran(12)[0].problem)


@pytest.mark.parametrize("figure", [11, 12, 13])
def test_default_meshes_have_maps_and_coordinates(figure):
    example, found = ran(figure)
    json.dumps([measure.to_dict() for measure in found.measures])
    assert_maps_are_measured(found)
    problem = example.problem
    shape = (len(problem.mesh.vertices), 2 if figure == 11 else 3)
    assert problem.source.shape == problem.target.shape == shape


def test_matching_reduces_the_mismatch(comparison):
    problem = ran(12)[0].problem
    mesh, error = problem.mesh, problem.source - problem.target
    assert l2_norm(mesh, comparison.three.advected - problem.target) < l2_norm(mesh, error)
    longest = maps.by_extent(mesh)[0]
    one = l2_norm(mesh, comparison.one.advected[:, 0] - problem.target[:, longest])
    assert one < 0.7 * l2_norm(mesh, error[:, longest])
    assert comparison.reduced.mismatch < comparison.reduced.start_mismatch


def test_targets_are_smoother_than_sources():
    problem = ran(11)[0].problem
    stiffness = cotangent_laplacian(problem.mesh)
    functions = problem.source, problem.target
    source, target = (np.einsum("vc,vc->c", f, stiffness @ f) for f in functions)
    assert (target < 0.8 * source).all()


def test_exact_coordinates_give_the_identity(poses):
    still = maps.with_flow_lines(poses.start, np.zeros((2, len(poses.b.faces), 3)), 1.0)
    assert_allclose(still.positions, poses.start.positions, atol=1e-9)
    found = maps.closest_points(poses, maps.coordinates(poses.a))
    assert_allclose(found.positions, poses.a.vertices, atol=1e-9)
    found = maps.closest_truncated(poses, maps.truncated_coordinates(poses.a, len(poses.true_map)))
    assert_allclose(found.positions, poses.a.vertices, atol=1e-7)
    assert_allclose(found.distances, 0, atol=1e-9)


def test_truncated_coordinates_are_projections():
    mesh = ellipsoid(3, 1, 1.2, 2)
    moved = TriangleMesh(7 * mesh.vertices + [1, 2, 3], mesh.faces)
    assert_allclose(maps.coordinates(moved), maps.coordinates(mesh), atol=1e-12)
    cut = maps.truncated_coordinates(mesh, 20)
    expected = spectral_coefficients(mesh, maps.coordinates(mesh), 20)
    assert_allclose(spectral_coefficients(mesh, cut, 20), expected, atol=1e-9)
    assert_allclose(spectral_coefficients(mesh, cut, 30)[20:], 0, atol=1e-9)


def test_truncated_true_map_has_a_small_mismatch():
    poses = maps.Poses.of(FigureSetup())
    target = poses.example(TABLE_1[12], [0, 1, 2], False).problem.target
    truth = PointMap.of_vertices(poses.b, poses.a)
    cut = truth.pull_back(maps.truncated_coordinates(poses.a, len(poses.true_map)))
    sources = cut, maps.coordinates(poses.a)
    truncated, complete = (l2_norm(poses.b, source - target) for source in sources)
    assert truncated < 0.4 * complete


def test_maps_without_flow_use_targets_and_start(poses):
    target = ran(13)[0].problem.target
    read = maps.maps_without_flow(poses, target)
    assert_array_equal(read[maps.TARGETS].positions, maps.closest_points(poses, target).positions)
    assert read[maps.START] is poses.start
    errors = {name: map_accuracy(points, count_max=200).mean for name, points in read.items()}
    assert errors[maps.START] > 0.01  # large enough to improve
    assert errors[maps.ZOOM_OUT] < 0.7 * errors[maps.START]
    assert errors[maps.TARGETS + maps.TRUNCATED_SUFFIX] < errors[maps.TARGETS]


def test_zero_flow_gives_the_maps_without_flow(poses):
    problem = ran(13)[0].problem
    parameters = problem.parameters.with_values(iterations=0)
    still = np.zeros((parameters.solver.segments, len(poses.b.faces), 3))
    found = match(poses.b, problem.source, problem.target, parameters, start=still)
    read = maps.by_flow(poses.start, len(poses.true_map), "still", found)
    expected = maps.maps_without_flow(poses, problem.target)[maps.NO_FLOW + maps.BY_NEIGHBOURS]
    assert_array_equal(read["still" + maps.BY_NEIGHBOURS].positions, expected.positions)
    assert_allclose(read["still" + maps.BY_LINES].positions, poses.start.positions, atol=1e-9)


def test_figure_13_measures_the_effect_of_the_flow(comparison):
    """The effect is the difference of mean errors; curves rise, within 0 to 100% of vertices."""
    findings = ran(13)[1]
    measured = values(findings)
    targets = map_accuracy(comparison.maps[maps.TARGETS], count_max=1500).mean
    assert measured[f"{maps.TARGETS}: mean error, sqrt(area)"] == targets
    effect = "effect of the flow: mean error of"
    added = {name: value for name, value in measured.items() if name.startswith(effect)}
    assert len(added) == 8
    name = f"{effect} '3 functions' minus that of '{maps.TARGETS}', sqrt(area)"
    assert added[name] == measured["3 functions: mean error, sqrt(area)"] - targets
    [plot] = findings.sheet.rows[0]
    assert maps.TARGETS in [curve.name for curve in plot.curves]
    for curve in plot.curves:
        assert (np.diff(curve.y) >= 0).all()
        assert 0 <= curve.y.min() <= curve.y.max() <= 100


def test_figures_12_and_13_share_matches(poses):
    first, second = (stated(figure).problem for figure in (12, 13))
    assert compared(poses, first) is compared(maps.Poses.of(SMALL), second)


@pytest.mark.parametrize("mesh", [torus(24, 12), open_cylinder(16, 12), ellipsoid(3, 1, 1.2, 2)])
def test_other_meshes_are_bent(mesh):
    for figure in (11, 12, 13):
        assert "bent" in run(figure, mesh)[1].setting


def test_bending_preserves_lengths():
    tube = open_cylinder(16, 40, radius=0.05)
    curved = maps.bend_mesh(tube)
    i, j = tube.edges.T
    before, after = (np.linalg.norm(m.vertices[i] - m.vertices[j], axis=1) for m in (tube, curved))
    radius = 2 / (np.pi / 3)
    assert_allclose(after / before, 1, atol=0.05 / radius + 1e-3)
    assert np.ptp(curved.vertices[:, 2]) < np.ptp(tube.vertices[:, 2])


def test_coarse_mesh_is_refused():
    with raises(MeshError, 60):
        stated(12, tetrahedron())
