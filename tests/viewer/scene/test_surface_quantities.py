"""How surfaces are drawn: edges of a wireframe."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm import TriangleMesh
from abfm_viewer.scene.surfaces import back_faces, edge_width
from tests.shapes import disc, icosphere


@given(faces=st.integers(4, 10**7), scale=st.floats(1, 10_000), more=st.floats(1, 100))
def test_a_wireframe_is_never_wider_from_farther_or_where_faces_are_smaller(faces, scale, more):
    assert 0 < edge_width(faces, scale) <= edge_width(faces, more * scale) <= 1
    assert edge_width(round(more * faces), scale) <= edge_width(faces, scale)


def test_the_same_edges_in_pixels_have_the_same_width():
    assert edge_width(4 * 500, 200.0) == pytest.approx(edge_width(500, 100.0))
    assert edge_width(500, 5000.0) == 1


def test_what_is_in_front_is_drawn_also_where_a_closed_surface_is_inside_out():
    sphere = icosphere(2)
    assert back_faces(sphere) == "cull"
    assert back_faces(TriangleMesh(sphere.vertices, sphere.faces[:, ::-1])) == "identical"
    assert back_faces(disc(3)) == "identical"
