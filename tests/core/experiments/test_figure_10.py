"""Figure 10: a rotation is reached by a flow over creases."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import MeshError
from abfm.experiments.figure_09 import detected
from abfm.experiments.vocabulary import bundled
from abfm.maps.symmetry import detect_symmetry
from abfm.mesh import TriangleMesh
from abfm.mesh.shapes import stepped_slab
from abfm.paper import TABLE_1
from tests.core.experiments.small import run, stated, values
from tests.shapes import torus


def test_a_coarse_slab_is_turned_in_most_parts():
    slab = stepped_slab(3)
    example, findings = run(10, slab)
    problem, found = example.problem, values(findings)
    assert TABLE_1[10].holds(problem.parameters)
    assert_array_equal(problem.target, problem.source[detected(slab).vertex_map])
    assert found["mismatch of the functions"] < 0.25
    assert found["map error at τ, mean, geodesic / √area"] < 0.1
    assert found["edges with an angle of more than 45 degrees, share"] > 0
    json.dumps([measure.to_dict() for measure in findings.measures])


def test_all_edges_of_the_slab_are_creases():
    slab = stepped_slab(2)
    corners = slab.vertices[slab.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    assert_array_equal(
        np.sort(np.abs(normals), axis=1), np.broadcast_to([0.0, 0.0, 1.0], normals.shape)
    )
    assert slab.length_scale**2 == pytest.approx(2 * (10 + 0) + 14 + 6)


def test_a_smooth_mesh_is_turned_as_well():
    findings = run(10, torus(24, 10))[1]
    assert "rotation by 180 degrees" in findings.setting


def test_a_mesh_without_symmetry_is_refused():
    with pytest.raises(MeshError, match="the mesh has no symmetry"):
        stated(10, bundled("fandisk.off"))


def test_a_rotation_that_turns_a_flat_surface_over_goes_after_its_mirror():
    kite = TriangleMesh(
        [[0, 0, 0], [2, 1, 0], [5, 0, 0], [2, -1, 0], [2, 0, 0]],
        [[0, 4, 1], [4, 2, 1], [0, 3, 4], [4, 3, 2]],
    )
    assert_allclose(np.abs(detect_symmetry(kite, "rotation").axis), [1, 0, 0], atol=1e-9)
    found = detected(kite)
    assert found.kind == "mirror"
    assert_allclose(np.abs(found.axis), [0, 1, 0], atol=1e-9)


def test_a_mesh_without_inner_edges_has_no_creases():
    alone = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    found = values(run(10, alone)[1])
    assert found["edges with an angle of more than 45 degrees, share"] == 0
