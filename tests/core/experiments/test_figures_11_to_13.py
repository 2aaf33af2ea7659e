"""Figures 11 to 13, small: maps between two poses, improved by flows."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.calculus.operators import cotangent_laplacian, l2_norm
from abfm.errors import MeshError
from abfm.experiments import Stage
from abfm.experiments.figure_11 import Poses, bent, by_extent, coordinates
from abfm.experiments.figure_12 import (
    CUT_OFF,
    LINES,
    NEIGHBOURS,
    NO_FLOW,
    START,
    TARGETS,
    ZOOM_OUT,
    Comparison,
    by_flow,
    closest,
    closest_cut_off,
    compare,
    cut_off,
    followed,
    without_flow,
)
from abfm.maps.functional_maps import spectral_coefficients
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import FOLDED, LARGEST_DISTANCE, RMS_DISTANCE, map_accuracy
from abfm.matching.match import match
from abfm.mesh import TriangleMesh
from abfm.paper import TABLE_1
from abfm.sheets import Plot
from tests.core.experiments.small import ran, run, stated, values
from tests.shapes import ellipsoid, open_cylinder, tetrahedron, torus

SMALL = Stage(small=True)


@pytest.fixture(scope="module")
def poses() -> Poses:
    """The bundled humans."""
    return Poses.of(SMALL)


def comparison() -> Comparison:
    """What figures 12 and 13 have found."""
    return compare(Poses.of(SMALL), ran(12)[0].problem, SMALL)


@pytest.mark.parametrize("figure", [11, 12, 13])
def test_own_mesh(figure: int) -> None:
    example, found = ran(figure)
    json.dumps([measure.to_dict() for measure in found.measures])
    problem = example.problem
    shape = (len(problem.mesh.vertices), 2 if figure == 11 else 3)
    assert problem.source.shape == problem.target.shape == shape


def test_matching_comes_nearer_the_targets() -> None:
    problem, found = ran(12)[0].problem, comparison()
    mesh, error = problem.mesh, problem.source - problem.target
    assert l2_norm(mesh, found.three.advected - problem.target) < l2_norm(mesh, error)
    longest = by_extent(mesh)[0]
    one = l2_norm(mesh, found.one.advected[:, 0] - problem.target[:, longest])
    assert one < 0.7 * l2_norm(mesh, error[:, longest])
    assert found.reduced.mismatch < found.reduced.start_mismatch


def test_targets_are_smoother_than_the_start() -> None:
    problem = ran(11)[0].problem
    stiffness = cotangent_laplacian(problem.mesh)
    source, target = (
        np.einsum("vc,vc->c", f, stiffness @ f) for f in (problem.source, problem.target)
    )
    assert (target < 0.8 * source).all()


def test_without_a_flow_the_map_stays(poses: Poses) -> None:
    still = followed(poses.start, np.zeros((2, len(poses.b.faces), 3)), 1.0)
    assert_allclose(still.positions, poses.start.positions, atol=1e-9)


def test_coordinates_where_they_belong_are_the_identity(poses: Poses) -> None:
    found = closest(poses, coordinates(poses.a))
    assert_allclose(found.positions, poses.a.vertices, atol=1e-9)


def test_coordinates_cut_off_alike_are_the_identity(poses: Poses) -> None:
    found = closest_cut_off(poses, cut_off(poses.a, len(poses.wanted)))
    assert_allclose(found.positions, poses.a.vertices, atol=1e-7)
    assert_allclose(found.distances, 0, atol=1e-9)


def test_cut_off_coordinates_are_their_own_projection() -> None:
    mesh = ellipsoid(3, 1, 1.2, 2)
    cut = cut_off(mesh, 20)
    whole = spectral_coefficients(mesh, coordinates(mesh), 20)
    assert_allclose(spectral_coefficients(mesh, cut, 20), whole, atol=1e-9)
    assert_allclose(spectral_coefficients(mesh, cut, 30)[20:], 0, atol=1e-9)


def test_with_both_cut_off_a_true_start_has_much_less_to_correct() -> None:
    poses = Poses.of(Stage())
    target = poses.example(TABLE_1[12], [0, 1, 2], False).problem.target
    truth = PointMap.of_vertices(poses.b, poses.a)
    cut = truth.pull_back(cut_off(poses.a, len(poses.wanted)))
    left, whole = (l2_norm(poses.b, source - target) for source in (cut, coordinates(poses.a)))
    assert left < 0.4 * whole


def test_what_needs_no_flow_is_read_off_the_targets_and_the_start(poses: Poses) -> None:
    target = ran(13)[0].problem.target
    maps = without_flow(poses, target)
    assert_array_equal(maps[TARGETS].positions, closest(poses, target).positions)
    assert maps[START] is poses.start
    errors = {name: map_accuracy(points, most=200).mean for name, points in maps.items()}
    assert errors[ZOOM_OUT] < 0.7 * errors[START]
    assert errors[TARGETS + CUT_OFF] < errors[TARGETS]


def test_a_flow_that_stands_still_reads_as_no_flow(poses: Poses) -> None:
    problem = ran(13)[0].problem
    parameters = replace(problem.parameters, iterations=0)
    still = np.zeros((parameters.segments, len(poses.b.faces), 3))
    found = match(poses.b, problem.source, problem.target, parameters, start=still)
    maps = by_flow(poses.start, len(poses.wanted), "still", found)
    expected = without_flow(poses, problem.target)[NO_FLOW + NEIGHBOURS]
    assert_array_equal(maps["still" + NEIGHBOURS].positions, expected.positions)
    assert_allclose(maps["still" + LINES].positions, poses.start.positions, atol=1e-9)


def test_figure_13_says_what_the_flow_adds() -> None:
    findings = ran(13)[1]
    measured = values(findings)
    targets = map_accuracy(comparison().maps[TARGETS], most=1500).mean
    assert measured[f"{TARGETS}: mean error, sqrt(area)"] == targets
    added = {
        name: value for name, value in measured.items() if name.startswith("what the flow adds")
    }
    assert len(added) == 8
    name = f"what the flow adds: mean error of '3 functions' less that of '{TARGETS}', sqrt(area)"
    assert added[name] == measured["3 functions: mean error, sqrt(area)"] - targets
    (plot,) = findings.sheet.rows[0]
    assert isinstance(plot, Plot)
    assert TARGETS in [curve.name for curve in plot.curves]


@pytest.mark.parametrize("figure", [9, 10, 11, 12, 13])
def test_figures_with_maps_measure_them_as_maps(figure: int) -> None:
    _, found = ran(figure)
    measured = values(found)
    names = [
        name.split(": off_surface, largest")[0]
        for name in measured
        if ": off_surface, largest" in name
    ]
    assert names
    for name in names:
        largest, rms = (
            measured[f"{name}: off_surface, {which}, sqrt(area)"] for which in ("largest", "RMS")
        )
        folded = measured[f"{name}: folded, % of the faces"]
        assert 0 <= rms <= largest
        assert 0 <= folded <= 100
        faulty = largest > LARGEST_DISTANCE or rms > RMS_DISTANCE or folded > 100 * FOLDED
        assert (
            any(f": {name} (" in note or f"; {name} (" in note for note in found.sheet.notes)
            == faulty
        )


def test_curves_are_shares_that_only_rise() -> None:
    (plot,) = ran(13)[1].sheet.rows[0]
    assert isinstance(plot, Plot)
    for curve in plot.curves:
        assert (np.diff(curve.y) >= 0).all()
        assert curve.y.min() >= 0
        assert curve.y.max() <= 100


def test_second_figure_has_the_first_ones_matches() -> None:
    first, second = (stated(figure).problem for figure in (12, 13))
    poses = Poses.of(SMALL)
    assert compare(poses, first, SMALL) is compare(poses, second, SMALL)


@pytest.mark.parametrize("mesh", [torus(24, 12), open_cylinder(16, 12), ellipsoid(3, 1, 1.2, 2)])
def test_other_meshes_are_bent(mesh: TriangleMesh) -> None:
    for figure in (11, 12, 13):
        assert "bent" in run(figure, mesh)[1].setting


def test_bending_keeps_lengths_along_the_middle() -> None:
    tube = open_cylinder(16, 40, radius=0.05)
    curved = bent(tube)
    i, j = tube.edges.T
    before, after = (np.linalg.norm(m.vertices[i] - m.vertices[j], axis=1) for m in (tube, curved))
    radius = 2 / (np.pi / 3)
    assert_allclose(after / before, 1, atol=0.05 / radius + 1e-3)
    assert np.ptp(curved.vertices[:, 2]) < np.ptp(tube.vertices[:, 2])


def test_coordinates_have_no_unit() -> None:
    mesh = ellipsoid(2, 1, 1.5, 2)
    moved = TriangleMesh(7 * mesh.vertices + [1, 2, 3], mesh.faces)
    assert_allclose(coordinates(moved), coordinates(mesh), atol=1e-12)


def test_a_coarse_mesh_is_refused() -> None:
    with pytest.raises(MeshError, match="at least 60"):
        stated(12, tetrahedron())


def test_start_map_is_wrong_enough_to_correct(poses: Poses) -> None:
    assert map_accuracy(poses.start, most=200).mean > 0.01
