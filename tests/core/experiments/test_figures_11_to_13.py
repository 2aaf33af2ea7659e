"""Figures 11 to 13, small: maps between two poses, improved by flows."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm.errors import MeshError
from abfm.experiments import experiment_of
from abfm.experiments.map_comparison import compare
from abfm.experiments.pair import bent, closest, coordinates, followed
from abfm.experiments.sheet import Plot
from abfm.map_accuracy import map_accuracy
from abfm.mesh import TriangleMesh
from abfm.operators import cotangent_laplacian, l2_norm
from tests.shapes import ellipsoid, open_cylinder, tetrahedron, torus


def quiet(text: str, share: float) -> None:
    assert text
    assert 0 <= share <= 1


@pytest.mark.parametrize("figure", [11, 12, 13])
def test_own_mesh(figure: int) -> None:
    chosen = experiment_of(figure)
    setup = chosen.set_up(None, True)
    found = chosen.run(setup, quiet)
    assert all(np.isfinite(measure.value) for measure in found.measures)
    json.dumps([measure.to_dict() for measure in found.measures])
    assert setup.source.shape == setup.target.shape == (len(setup.mesh.vertices), 2 if figure == 11 else 3)


def test_matching_comes_nearer_the_targets() -> None:
    setup = experiment_of(12).set_up(None, True)
    found = compare(setup, quiet)
    before = l2_norm(setup.mesh, setup.source - setup.target)
    assert l2_norm(setup.mesh, found.three.advected - setup.target) < before
    longest = setup.longest[0]
    one = l2_norm(setup.mesh, found.one.advected[:, 0] - setup.target[:, longest])
    assert one < 0.7 * l2_norm(setup.mesh, (setup.source - setup.target)[:, longest])
    assert found.reduced.mismatch < found.reduced.start_mismatch


def test_targets_are_smoother_than_the_start() -> None:
    setup = experiment_of(11).set_up(None, True)
    stiffness = cotangent_laplacian(setup.mesh)
    source, target = (np.einsum("vc,vc->c", f, stiffness @ f) for f in (setup.source, setup.target))
    assert (target < 0.8 * source).all()


def test_without_a_flow_the_map_stays() -> None:
    setup = experiment_of(12).set_up(None, True)
    still = followed(setup, np.zeros((2, len(setup.mesh.faces), 3)))
    assert_allclose(still.positions, setup.start.positions, atol=1e-9)


def test_coordinates_where_they_belong_are_the_identity() -> None:
    setup = experiment_of(12).set_up(None, True)
    found = closest(setup, coordinates(setup.other))
    assert_allclose(found.positions, setup.other.vertices, atol=1e-9)


def test_curves_are_shares_that_only_rise() -> None:
    setup = experiment_of(13).set_up(None, True)
    (plot,) = experiment_of(13).run(setup, quiet).sheet.rows[0]
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
    setup = experiment_of(12).set_up(None, True)
    assert map_accuracy(setup.other, setup.start, most=200).mean > 0.01
