"""Edges, boundaries, Euler characteristic and genus against what geometry says."""

import numpy as np
import pytest

from abfm.assets import asset_path
from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.topology import edges_of_faces
from tests.shapes import (
    disc,
    ellipsoid,
    hemisphere,
    icosphere,
    open_cylinder,
    square,
    tetrahedron,
    torus,
)

SHAPES = {  # mesh, genus, boundary loops, boundary edges
    "sphere": (icosphere(2), 0, 0, 0),
    "ellipsoid": (ellipsoid(1, 1, 2, 3), 0, 0, 0),
    "tetrahedron": (tetrahedron(), 0, 0, 0),
    "torus": (torus(7, 5), 1, 0, 0),
    "square": (square(5), 0, 1, 20),
    "disc": (disc(3), 0, 1, 18),
    "hemisphere": (hemisphere(4), 0, 1, 24),
    "cylinder": (open_cylinder(9, 4), 0, 2, 18),
    "triangle": (TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), 0, 1, 3),
    "eight": (load_mesh(asset_path("eight.off")), 2, 0, 0),
    "human": (load_mesh(asset_path("human_A.off")), 0, 0, 0),
    "fandisk": (load_mesh(asset_path("fandisk.off")), 0, 0, 0),
}


@pytest.mark.parametrize(("mesh", "genus", "loops", "edges"), SHAPES.values(), ids=SHAPES)
def test_genus_boundary_and_euler_characteristic(mesh, genus, loops, edges):
    assert mesh.messages == ()
    assert mesh.genus == genus
    assert mesh.boundary_loop_count == loops
    assert mesh.is_boundary_edge.sum() == mesh.is_boundary_vertex.sum() == edges
    assert mesh.is_closed == (edges == 0)
    assert mesh.euler_characteristic == 2 - 2 * genus - loops


def test_two_tori_joined_at_a_vertex_have_genus_two():
    one = torus(6, 5)
    again = np.where(one.faces == 0, 0, one.faces + len(one.vertices) - 1)
    vertices = np.concatenate([one.vertices, one.vertices[1:] + np.array([0, 0, 3])])
    assert TriangleMesh(vertices, np.concatenate([one.faces, again])).genus == 2


SMALL = [mesh for mesh, *_ in SHAPES.values() if mesh.file_vertex_count < 500]


@pytest.mark.parametrize("mesh", SMALL, ids=str)
def test_edges_lie_opposite_their_corners_and_between_their_faces(mesh):
    found, opposite = edges_of_faces(mesh.faces, 2**31)  # too many to be sorted with their places
    np.testing.assert_array_equal(found, mesh.edges)
    np.testing.assert_array_equal(opposite, mesh.face_edges)
    assert np.all(mesh.edges[:, 0] < mesh.edges[:, 1])
    for corner in range(3):
        others = np.sort(np.delete(mesh.faces, corner, axis=1), axis=1)
        np.testing.assert_array_equal(others, mesh.edges[mesh.face_edges[:, corner]])
    for edge, faces in enumerate(mesh.edge_faces):
        owners = np.flatnonzero((mesh.face_edges == edge).any(axis=1)).tolist()
        assert faces.tolist() == [*owners, -1][:2]


def test_area_of_shapes_tends_to_the_exact_one():
    assert square(7).length_scale == pytest.approx(1, rel=1e-14)
    errors = [abs(hemisphere(n).length_scale ** 2 / (2 * np.pi) - 1) for n in (8, 16)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
    errors = [abs(torus(2 * n, n).length_scale ** 2 / (4 * np.pi**2 * 0.4) - 1) for n in (16, 32)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
