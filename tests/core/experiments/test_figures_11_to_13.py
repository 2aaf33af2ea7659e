"""Figures 11 to 13, small: maps between two poses, improved by flows."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.calculus.operators import cotangent_laplacian, l2_norm
from abfm.errors import MeshError
from abfm.experiments import experiment_of
from abfm.experiments.map_comparison import compare
from abfm.experiments.pair import bent, closest, coordinates, followed
from abfm.experiments.read_outs import (
    CUT_OFF,
    LINES,
    NEIGHBOURS,
    NO_FLOW,
    START,
    TARGETS,
    ZOOM_OUT,
    by_flow,
    closest_cut_off,
    cut_off,
    without_flow,
)
from abfm.experiments.sheet import Plot
from abfm.maps.accuracy import map_accuracy
from abfm.maps.functional_maps import spectral_coefficients
from abfm.maps.quality import FOLDED, LARGEST_DISTANCE, RMS_DISTANCE
from abfm.maps.surface_points import pull_back, vertex_points
from abfm.matching.match import match
from abfm.mesh import TriangleMesh
from tests.core.experiments.small import quiet, ran, values
from tests.shapes import ellipsoid, open_cylinder, tetrahedron, torus


@pytest.mark.parametrize("figure", [11, 12, 13])
def test_own_mesh(figure: int) -> None:
    setup, found = ran(figure)
    assert all(np.isfinite(measure.value) for measure in found.measures)
    json.dumps([measure.to_dict() for measure in found.measures])
    assert setup.source.shape == setup.target.shape == (len(setup.mesh.vertices), 2 if figure == 11 else 3)


def test_matching_comes_nearer_the_targets() -> None:
    setup, _ = ran(12)
    found = compare(setup, quiet)
    before = l2_norm(setup.mesh, setup.source - setup.target)
    assert l2_norm(setup.mesh, found.three.advected - setup.target) < before
    longest = setup.longest[0]
    one = l2_norm(setup.mesh, found.one.advected[:, 0] - setup.target[:, longest])
    assert one < 0.7 * l2_norm(setup.mesh, (setup.source - setup.target)[:, longest])
    assert found.reduced.mismatch < found.reduced.start_mismatch


def test_targets_are_smoother_than_the_start() -> None:
    setup, _ = ran(11)
    stiffness = cotangent_laplacian(setup.mesh)
    source, target = (np.einsum("vc,vc->c", f, stiffness @ f) for f in (setup.source, setup.target))
    assert (target < 0.8 * source).all()


def test_without_a_flow_the_map_stays() -> None:
    setup, _ = ran(12)
    still = followed(setup, np.zeros((2, len(setup.mesh.faces), 3)))
    assert_allclose(still.positions, setup.start.positions, atol=1e-9)


def test_coordinates_where_they_belong_are_the_identity() -> None:
    setup, _ = ran(12)
    found = closest(setup, coordinates(setup.other))
    assert_allclose(found.positions, setup.other.vertices, atol=1e-9)


def test_coordinates_cut_off_alike_are_the_identity() -> None:
    setup, _ = ran(12)
    found = closest_cut_off(setup, cut_off(setup.other, len(setup.wanted)))
    assert_allclose(found.positions, setup.other.vertices, atol=1e-7)
    assert_allclose(found.distances, 0, atol=1e-9)


def test_cut_off_coordinates_are_their_own_projection() -> None:
    mesh = ellipsoid(3, 1, 1.2, 2)
    cut = cut_off(mesh, 20)
    whole = spectral_coefficients(mesh, coordinates(mesh), 20)
    assert_allclose(spectral_coefficients(mesh, cut, 20), whole, atol=1e-9)
    assert_allclose(spectral_coefficients(mesh, cut, 30)[20:], 0, atol=1e-9)


def test_with_both_cut_off_a_true_start_has_much_less_to_correct() -> None:
    setup = experiment_of(12).set_up(None, False)
    truth = vertex_points(setup.other, np.arange(len(setup.mesh.vertices)))
    cut = pull_back(setup.other, truth, cut_off(setup.other, len(setup.wanted)))
    raw = coordinates(setup.other)
    left, whole = (l2_norm(setup.mesh, source - setup.target) for source in (cut, raw))
    assert left < 0.4 * whole


def test_what_needs_no_flow_is_read_off_the_targets_and_the_start() -> None:
    setup, _ = ran(13)
    maps = without_flow(setup)
    assert_array_equal(maps[TARGETS].positions, closest(setup, setup.target).positions)
    assert maps[START] is setup.start
    errors = {name: map_accuracy(setup.other, points, most=200).mean for name, points in maps.items()}
    assert errors[ZOOM_OUT] < 0.7 * errors[START]
    assert errors[TARGETS + CUT_OFF] < errors[TARGETS]


def test_a_flow_that_stands_still_reads_as_no_flow() -> None:
    setup, _ = ran(13)
    still = np.zeros((setup.parameters.segments, len(setup.mesh.faces), 3))
    found = match(setup.mesh, setup.source, setup.target, replace(setup.parameters, iterations=0), start=still)
    maps = by_flow(setup, "still", found)
    expected = without_flow(setup)[NO_FLOW + NEIGHBOURS]
    assert_array_equal(maps["still" + NEIGHBOURS].positions, expected.positions)
    assert_allclose(maps["still" + LINES].positions, setup.start.positions, atol=1e-9)


def test_figure_13_says_what_the_flow_adds() -> None:
    setup, findings = ran(13)
    measured = values(findings)
    accuracies = compare(setup, quiet).accuracies
    assert measured[f"{TARGETS}: mean error, sqrt(area)"] == accuracies[TARGETS].mean
    added = {name: value for name, value in measured.items() if name.startswith("what the flow adds")}
    assert len(added) == 8
    name = f"what the flow adds: mean error of '3 functions' less that of '{TARGETS}', sqrt(area)"
    assert added[name] == accuracies["3 functions"].mean - accuracies[TARGETS].mean
    (plot,) = findings.sheet.rows[0]
    assert isinstance(plot, Plot)
    assert TARGETS in [curve.name for curve in plot.curves]


@pytest.mark.parametrize("figure", [9, 10, 11, 12, 13])
def test_figures_with_maps_measure_them_as_maps(figure: int) -> None:
    _, found = ran(figure)
    measured = values(found)
    names = [name.split(": off_surface, largest")[0] for name in measured if ": off_surface, largest" in name]
    assert names
    for name in names:
        largest, rms = (measured[f"{name}: off_surface, {which}, sqrt(area)"] for which in ("largest", "RMS"))
        folded = measured[f"{name}: folded, % of the faces"]
        assert 0 <= rms <= largest
        assert 0 <= folded <= 100
        faulty = largest > LARGEST_DISTANCE or rms > RMS_DISTANCE or folded > 100 * FOLDED
        assert any(f": {name} (" in note or f"; {name} (" in note for note in found.sheet.notes) == faulty


def test_curves_are_shares_that_only_rise() -> None:
    (plot,) = ran(13)[1].sheet.rows[0]
    assert isinstance(plot, Plot)
    for curve in plot.curves:
        assert (np.diff(curve.y) >= 0).all()
        assert curve.y.min() >= 0
        assert curve.y.max() <= 100


def test_second_figure_has_the_first_ones_matches() -> None:
    first, second = (experiment_of(figure).set_up(None, True) for figure in (12, 13))
    assert compare(first, quiet) is compare(second, quiet)


@pytest.mark.parametrize("mesh", [torus(24, 12), open_cylinder(16, 12), ellipsoid(3, 1, 1.2, 2)])
def test_other_meshes_are_bent(mesh: TriangleMesh) -> None:
    for figure in (11, 12, 13):
        chosen = experiment_of(figure)
        setup = chosen.set_up(mesh, True)
        assert "bent" in setup.setting
        found = chosen.run(setup, quiet)
        assert all(np.isfinite(measure.value) for measure in found.measures)


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
        experiment_of(12).set_up(tetrahedron(), True)


def test_start_map_is_wrong_enough_to_correct() -> None:
    setup, _ = ran(12)
    assert map_accuracy(setup.other, setup.start, most=200).mean > 0.01
