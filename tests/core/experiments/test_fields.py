"""Smooth fields on any mesh, and their flow lines."""

from __future__ import annotations

import numpy as np
import pytest

from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.operators import face_frames
from abfm.errors import MeshError
from abfm.experiments.fields import carried, feet, root_mean_square, stream_field
from abfm.experiments.vocabulary import smoothed
from abfm.mesh import TriangleMesh
from abfm.mesh.shapes import five_limbs
from tests.core.surfaces import edge_divergence
from tests.shapes import ellipsoid, open_cylinder, torus

MODES = {2: 1.0, 3: -0.5}


@pytest.mark.parametrize("mesh", [ellipsoid(2, 1, 0.7, 0.5), torus(24, 12), open_cylinder(20, 10)])
def test_field_has_the_speed_and_no_divergence(mesh: TriangleMesh) -> None:
    field = stream_field(mesh, MODES, 0.3)
    assert root_mean_square(mesh, field) == pytest.approx(0.3 * mesh.length_scale)
    coefficients = np.einsum("fx,fkx->fk", field, face_frames(mesh))
    divergence = edge_divergence(mesh) @ coefficients.ravel()
    assert np.abs(divergence).max() < 1e-9 * np.abs(field).max() / mesh.length_scale


def test_field_is_tangent_to_the_boundary() -> None:
    mesh = open_cylinder(20, 10)
    field = stream_field(mesh, MODES, 0.3)
    faces = mesh.edge_faces[mesh.is_boundary_edge, 0]
    assert np.abs(field[faces, 2]).max() < 1e-9  # its ends are circles about z


def test_flow_lines_are_the_level_lines_of_the_stream_function() -> None:
    mesh = ellipsoid(2, 1, 0.7, 0.5)
    stream = eigenbasis(mesh.normalized(), 4)[1][:, [2, 3]] @ [1.0, -0.5]
    times = np.array([0.3, 1.0])
    places = feet(mesh, stream_field(mesh, MODES, 0.3), times)
    assert np.linalg.norm(places[1] - mesh.vertices, axis=1).mean() > 0.1 * mesh.length_scale
    np.testing.assert_allclose(carried(mesh, places, stream), np.stack([stream, stream]), atol=1e-9)


def test_meshes_are_closed_and_even() -> None:
    body, eight = five_limbs(500), smoothed("eight.off", 1)
    assert (len(body.vertices), body.genus, body.is_closed) == (500, 0, True)
    assert (len(eight.faces), eight.genus, eight.is_closed) == (4 * 634, 2, True)
    lengths = np.linalg.norm(
        body.vertices[body.edges[:, 0]] - body.vertices[body.edges[:, 1]], axis=1
    )
    assert lengths.max() < 6 * lengths.min()


def test_a_mesh_with_nothing_inside_its_boundary_has_no_flow():
    with pytest.raises(
        MeshError, match="no smooth field without divergence flows inside this mesh"
    ):
        stream_field(
            TriangleMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]),
            {2: 1.0},
            0.1,
        )
