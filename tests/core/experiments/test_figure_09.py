"""Figure 9: a rotation is reached by a flow, a mirror is not."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import MeshError
from abfm.experiments.figure_09 import detected, geodesics, symmetric_example
from abfm.experiments.vocabulary import bundled
from abfm.functions import function
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.mesh.shapes import sphere
from abfm.parameters import Parameters
from tests.core.experiments.small import ran, run, stated, values
from tests.shapes import ellipsoid, icosphere, open_cylinder

BALL = icosphere(2)
X, Y, Z = BALL.vertices.T
EGG = TriangleMesh(
    np.stack([X, (0.8 + 0.2 * Z) * Y + 0.3 * Z * Z, 0.7 * Z + 0.2 * Y * Z], axis=1), BALL.faces
)


def test_targets_are_the_sources_after_the_symmetry():
    turned, (human, mirror) = ran(9)[0], (bundled("human_A.off"), detected(bundled("human_A.off")))
    mirrored = symmetric_example(human, "", mirror, Parameters())
    for example in (turned, mirrored):
        mesh = example.problem.mesh
        for channel, (_, target) in enumerate(example.specs):
            assert_array_equal(example.problem.target[:, channel], function(mesh, target))
    x = turned.problem.mesh.vertices / turned.problem.mesh.length_scale
    f = turned.problem.source
    assert_allclose(f - f.mean(axis=0), x - x.mean(axis=0), atol=1e-5)


def test_the_flow_reaches_the_rotation_and_comes_back():
    found = values(ran(9)[1])
    assert found["map error at τ, mean, geodesic / √area"] < 0.02
    assert found["map error at τ by exact flow lines, mean"] < 0.02
    assert found["drift at 2 τ, mean, geodesic / √area"] < 0.05
    assert found["advected points from the ends of exact flow lines, mean"] < 0.03


def test_one_function_and_missing_cooling_do_worse():
    found = values(ran(9)[1])
    reached = found["map error at τ, mean, geodesic / √area"]
    assert found["map error with one Gaussian only, mean"] > 5 * reached
    assert found["map error without cooling, mean"] > reached
    assert found["energy without cooling over the energy here"] > 1


def test_the_mirror_is_not_reached_as_a_map():
    found = values(ran(9)[1])
    assert found["mirror: vertices where the detected map is not the file's"] == 0
    assert found["mirror: map error with the three coordinates, mean"] > 0.03
    assert found["mirror: map error, mean"] > 0.1


def test_measures_are_finite_and_plain():
    _, findings = ran(9)
    rows = [measure.to_dict() for measure in findings.measures]
    json.dumps(rows)
    assert [len(row) for row in findings.sheet.rows] == [5, 4, 6]


@pytest.mark.parametrize(("mesh", "kind"), [(open_cylinder(12, 6), "rotation"), (EGG, "mirror")])
def test_another_mesh_gives_its_own_symmetry(mesh: TriangleMesh, kind: str) -> None:
    example, findings = run(9, mesh)
    assert all(target.startswith(f"permuted:{kind}(") for _, target in example.specs)
    assert [len(row) for row in findings.sheet.rows] == [5, 4]
    assert kind in findings.setting


def test_a_mesh_without_symmetry_is_refused():
    with pytest.raises(
        MeshError, match=r"no symmetry: .* carry a vertex 0\.\d+ and 0\.\d+ sqrt\(area\)"
    ):
        stated(9, bundled("human_B.off"))


def test_geodesics_on_a_sphere_are_angles():
    mesh = sphere(3)
    vertices = np.array([0, 5, 7, 9])
    angles = np.array([0.0, 0.01, 0.5, 2.0])
    x = mesh.vertices[vertices]
    across = np.cross(x, [0.1, 0.2, 0.9])
    across /= np.linalg.norm(across, axis=1)[:, None]
    points = project_onto_surface(
        mesh, np.cos(angles)[:, None] * x + np.sin(angles)[:, None] * across
    )
    assert_allclose(geodesics(mesh, vertices, points)[0] * mesh.length_scale, angles, atol=0.02)


def test_geodesics_are_no_shorter_than_straight_lines():
    mesh = ellipsoid(3, 1, 0.5, 0.3)
    vertices = np.arange(0, 200, 20)
    points = project_onto_surface(mesh, mesh.vertices[vertices + 13] * 1.01)
    straight = (
        np.linalg.norm(points.positions - mesh.vertices[vertices], axis=1) / mesh.length_scale
    )
    assert (geodesics(mesh, vertices, points)[0] >= straight - 1e-12).all()
