"""Fields made continuous: exact where linear, blind to creases, better on finer meshes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm.calculus.operators import face_frames
from abfm.flow.continuous_flow import Walker, smooth_flow, walk_straight
from abfm.flow.flow_lines import flow_lines
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.streaks.line_integral import direction
from tests.core.fields import rotation_field, wavy_field
from tests.shapes import icosphere, open_cylinder, square, torus


def in_space(mesh, flow):
    """Vectors at corners (F, 3, 3)."""
    places = mesh.vertices[mesh.faces]
    corners = np.einsum("fcx,fkx->fck", places - places[:, :1], face_frames(mesh))
    weights = np.concatenate([np.ones((*corners.shape[:2], 1)), corners], axis=2)
    return np.einsum("fcj,fjk,fkx->fcx", weights, flow.vectors, face_frames(mesh))


def walked(mesh, flow, face, step, count):
    """Places (n, 3) after steps from a face's centre."""
    frames, places = face_frames(mesh), mesh.vertices[mesh.faces]
    x, y = (frames[face] @ (places[face].mean(axis=0) - places[face, 0])).tolist()
    f, u, v, found = face, 0.0, 0.0, []
    for _ in range(count):
        walker = direction(flow, Walker(f, x, y, u, v), step, 0.0)
        f, x, y, u, v = walk_straight(flow, walker)
        if f < 0:
            break
        found.append(places[f, 0] + np.array([x, y]) @ frames[f])
    return np.array(found)


def test_a_constant_field_stays():
    mesh = square(5)
    field = np.tile([0.3, -2.0, 0.0], (len(mesh.faces), 1))
    assert_allclose(
        in_space(mesh, smooth_flow(mesh, field)), np.tile([0.3, -2.0, 0.0], (len(mesh.faces), 3, 1))
    )


def test_a_linear_field_is_found_again_up_to_the_boundary():
    mesh = square(8)
    matrix = np.array([[1.0, -2.0, 0], [0.5, 0.7, 0], [0, 0, 0]])
    field = mesh.vertices[mesh.faces].mean(axis=1) @ matrix.T
    exact = mesh.vertices[mesh.faces] @ matrix.T
    # in a corner with one face
    assert_allclose(in_space(mesh, smooth_flow(mesh, field)), exact, rtol=0, atol=0.2)
    inside = (np.abs(mesh.vertices[mesh.faces] - 0.5)[..., :2] < 0.49).all(axis=2)
    assert_allclose(
        in_space(mesh, smooth_flow(mesh, field))[inside], exact[inside], rtol=0, atol=0.01
    )


def test_creases_do_not_matter():
    """A flat mesh folded along its lines has the same vectors in its frames."""
    uneven = square(6)
    x, y = (grid.ravel() / 6 for grid in np.meshgrid(np.arange(7), np.arange(7), indexing="ij"))
    flat = TriangleMesh(np.stack([x, y, 0 * x], axis=1), uneven.faces)
    zigzag = np.abs((6 * x + 1) % 2 - 1) / 6  # along the mesh's own lines
    folded = TriangleMesh(np.stack([0.5 * x, y, np.sqrt(0.75) * zigzag], axis=1), flat.faces)
    field = wavy_field(flat, 3)
    coefficients = np.einsum("fkx,fx->fk", face_frames(flat), field)
    carried = np.einsum("fkx,fk->fx", face_frames(folded), coefficients)
    assert_allclose(
        smooth_flow(folded, carried).vectors, smooth_flow(flat, field).vectors, rtol=0, atol=1e-12
    )


def test_the_error_falls_with_the_square_of_the_edges():
    axis = np.array([0.2, -0.3, 1.0])
    errors = []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        found = in_space(mesh, smooth_flow(mesh, rotation_field(mesh, axis)))
        speeds = np.linalg.norm(np.cross(axis, mesh.vertices), axis=1)[mesh.faces]
        errors.append(np.sqrt(((np.linalg.norm(found, axis=2) - speeds) ** 2).mean()))
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


@pytest.mark.parametrize("mesh", [icosphere(2), torus(14, 9), open_cylinder(9, 4)])
def test_both_sides_of_an_edge_agree(mesh):
    """Corner vectors relative to the common edge; exactly where angles sum to a full turn."""
    flow, field = smooth_flow(mesh, wavy_field(mesh, 2)), wavy_field(mesh, 2)
    vectors, (jumps, before) = in_space(mesh, flow), ([], [])
    for edge in np.flatnonzero((mesh.edge_faces >= 0).all(axis=1)):
        ends = mesh.edges[edge]
        along = mesh.vertices[ends[1]] - mesh.vertices[ends[0]]
        along /= np.linalg.norm(along)
        f, g = mesh.edge_faces[edge]
        for end in ends:
            sides = [vectors[h, int(np.argmax(mesh.faces[h] == end))] for h in (f, g)]
            jumps.append(abs(sides[0] @ along - sides[1] @ along))
        before.append(abs((field[f] - field[g]) @ along))
    assert np.sqrt(np.mean(np.square(jumps))) < 0.35 * np.sqrt(np.mean(np.square(before)))


def test_walks_follow_circles_that_exact_lines_of_the_faces_miss():
    """The radius is kept around the centre of a rotation on a coarse mesh, a turn long."""
    mesh, centre = square(9), np.array([0.53, 0.46, 0.0])
    field = np.cross([0, 0, 1], mesh.vertices[mesh.faces].mean(axis=1) - centre)
    start = np.array([[0.72, 0.6, 0.0]])
    face = int(project_onto_surface(mesh, start).faces[0])
    first = mesh.vertices[mesh.faces[face]].mean(axis=0)
    radius = float(np.linalg.norm(first - centre))
    smooth = walked(mesh, smooth_flow(mesh, field), face, radius / 100, 628)
    assert len(smooth) == 628
    exact = flow_lines(mesh, field, project_onto_surface(mesh, first[None]), 2 * np.pi)[0].positions

    def error(places):
        return float(np.abs(np.linalg.norm(places - centre, axis=1) - radius).max()) / radius

    assert error(smooth) < 0.01
    assert error(smooth) < 0.3 * error(exact)


def test_a_walk_back_returns():
    mesh = torus(20, 14)
    flow = smooth_flow(mesh, wavy_field(mesh, 2))
    frames, places = face_frames(mesh), mesh.vertices[mesh.faces]
    x, y = (frames[5] @ (places[5].mean(axis=0) - places[5, 0])).tolist()
    f, u, v = 5, 0.0, 0.0
    for step in (0.01, -0.01):
        u, v = 0.0, 0.0
        for _ in range(100):
            walker = direction(flow, Walker(f, x, y, u, v), step, 0.0)
            f, x, y, u, v = walk_straight(flow, walker)
    end = places[f, 0] + np.array([x, y]) @ frames[f]
    assert_allclose(end, places[5].mean(axis=0), rtol=0, atol=0.003)


def test_faces_without_speed_have_none():
    mesh = icosphere(1)
    field = rotation_field(mesh, [0, 0, 1])
    field[::3] = 0
    assert (smooth_flow(mesh, field).vectors[::3] == 0).all()
