"""Repair of faces that disagree on a side."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm.errors import MeshError
from abfm.mesh import TriangleMesh
from tests.shapes import disc, icosphere, moebius_arrays, open_cylinder, square, torus

CLOSED = {"sphere": icosphere(1), "torus": torus(6, 5)}
OPEN = {"disc": disc(3), "square": square(4), "cylinder": open_cylinder(6, 3)}


def turned(faces, which):
    return np.where(np.asarray(which)[:, None], faces[:, ::-1], faces)


def same_up_to_rotation(faces, others):
    """Whether corresponding faces have the same cyclic order of vertices."""
    return all(
        any(np.array_equal(np.roll(a, k), b) for k in range(3))
        for a, b in zip(faces, others, strict=True)
    )


def volume(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return np.einsum("fx,fx->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize("shape", CLOSED.values(), ids=CLOSED)
@given(data=st.data())
def test_closed_surfaces_end_outward(shape, data):
    flips = data.draw(st.lists(st.booleans(), min_size=len(shape.faces), max_size=len(shape.faces)))
    mesh = TriangleMesh(shape.vertices, turned(shape.faces, flips))
    if all(flips):
        assert mesh.messages == ()
        assert same_up_to_rotation(mesh.faces, shape.faces[:, ::-1])
    else:
        assert same_up_to_rotation(mesh.faces, shape.faces)
        assert len(mesh.messages) == any(flips)


@pytest.mark.parametrize("shape", OPEN.values(), ids=OPEN)
@given(data=st.data())
def test_open_surfaces_keep_the_side_of_most_faces(shape, data):
    flips = np.array(
        data.draw(st.lists(st.booleans(), min_size=len(shape.faces), max_size=len(shape.faces)))
    )
    mesh = TriangleMesh(shape.vertices, turned(shape.faces, flips))
    if 2 * flips.sum() != len(flips):
        majority = shape.faces if 2 * flips.sum() < len(flips) else shape.faces[:, ::-1]
        assert same_up_to_rotation(mesh.faces, majority)
        count = min(flips.sum(), len(flips) - flips.sum())
    else:
        count = flips.sum()
    assert len(mesh.messages) == (count > 0)
    assert all(message.startswith(f"{count} face") for message in mesh.messages)


def test_inward_but_consistent_is_left_as_it_is():
    sphere = icosphere(1)
    mesh = TriangleMesh(sphere.vertices, sphere.faces[:, ::-1])
    assert mesh.messages == ()
    assert volume(mesh) < 0


def test_inward_and_inconsistent_ends_outward():
    sphere = icosphere(1)
    mesh = TriangleMesh(sphere.vertices + 100, turned(sphere.faces, np.arange(80) != 3))
    assert mesh.messages == (
        "79 faces were turned over so that all agree on a side (for example face 0)",
    )
    assert volume(mesh) > 0


def test_pieces_joined_at_a_vertex_are_settled_one_by_one():
    """A sphere pinched to a disc: the sphere goes outward, the disc keeps its own majority."""
    sphere, flat = icosphere(1), disc(2)
    vertices = np.concatenate(
        [sphere.vertices, flat.vertices[1:] - flat.vertices[0] + sphere.vertices[0]]
    )
    flat_faces = np.where(flat.faces == 0, 0, flat.faces + len(sphere.vertices) - 1)
    faces = np.concatenate(
        [turned(sphere.faces, np.arange(80) > 2), turned(flat_faces, np.arange(24) == 5)]
    )
    mesh = TriangleMesh(vertices, faces)
    assert same_up_to_rotation(mesh.faces, np.concatenate([sphere.faces, flat_faces]))
    assert mesh.messages[0].startswith("78 faces were turned over")
    assert "pinched" in mesh.messages[1]


@given(flips=st.lists(st.booleans(), min_size=30, max_size=30))
def test_moebius_strip_is_refused_however_its_faces_are_turned(flips):
    vertices, faces = moebius_arrays(15)
    with pytest.raises(MeshError, match="not orientable"):
        TriangleMesh(vertices, turned(faces, flips))


def test_what_encloses_space_may_be_inside_out_and_what_is_flat_is_not():
    for mesh in (icosphere(2), torus(12, 8), open_cylinder(12, 4)):
        vertices = mesh.vertices + np.array([7.0, -3.0, 2.0])
        sides = [TriangleMesh(vertices, faces) for faces in (mesh.faces, mesh.faces[:, ::-1])]
        assert sides[0].is_inside_out != sides[1].is_inside_out
    assert not icosphere(2).is_inside_out
    for mesh in (disc(3), square(4)):
        assert not mesh.is_inside_out
        assert not TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]).is_inside_out
