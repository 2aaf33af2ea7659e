"""Ribbons lie on the surface, say which way a line goes, and follow a function's values."""

from __future__ import annotations

import numpy as np
import pytest

from abfm import TriangleMesh
from abfm.flow import flow_lines
from abfm.maps import SurfacePoints
from abfm_viewer.scene import ribbons
from tests.shapes import icosphere, square

SPHERE = icosphere(4)
UNIT = SPHERE.length_scale
HALF = 0.004


def around(duration=1.0):
    """A flow line of a rotation about the z axis."""
    velocity = np.cross([0, 0, 1.0], SPHERE.vertices[SPHERE.faces].mean(axis=1))
    face = int(
        np.argmin(np.abs(SPHERE.vertices[SPHERE.faces].mean(axis=1) - [1, 0, 0]).sum(axis=1))
    )
    start = SurfacePoints(SPHERE, np.array([face]), np.full((1, 3), 1 / 3))
    return flow_lines(SPHERE, velocity, start, duration)[0]


def angles(places):
    return np.unwrap(np.arctan2(places[:, 1], places[:, 0]))


@pytest.mark.parametrize("duration", [1.0, -1.0])
def test_a_course_goes_with_the_flow_also_where_it_was_walked_against_it(duration):
    course = ribbons.course_of(SPHERE, around(duration))
    assert angles(course.places)[-1] > angles(course.places)[0]
    np.testing.assert_allclose(np.linalg.norm(course.normals, axis=1), 1)
    np.testing.assert_allclose(course.normals, UNIT * course.places, atol=0.05)
    through = ribbons.course_through(SPHERE, UNIT * course.places)
    np.testing.assert_allclose(through.normals, course.normals, atol=1e-6)
    np.testing.assert_allclose(through.lengths, course.lengths)


def test_an_arrow_lies_on_the_surface_from_its_start_to_its_tip():
    course = ribbons.course_of(SPHERE, around())
    vertices, faces = ribbons.arrow_ribbons([course, course], HALF)
    heights = np.linalg.norm(UNIT * vertices, axis=1) - 1
    assert heights.min() > -1e-3  # the sphere of triangles lies below the round one
    assert heights.max() < 0.01
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    outwards = (np.cross(b - a, c - a) * a).sum(axis=1)
    assert (outwards >= -1e-12).all()
    assert (outwards > 0).sum() > 0.8 * len(faces)
    turned = angles(vertices)
    widest = np.abs(vertices[:, 2] - course.places[0, 2])
    assert np.ptp(turned) == pytest.approx(np.ptp(angles(course.places)), rel=0.02)
    assert turned[widest.argmax()] > np.quantile(turned, 0.6)  # the head is at the end


def test_a_short_arrow_is_thin_and_there_may_be_none():
    course = ribbons.course_of(SPHERE, around(0.01))
    vertices, _ = ribbons.arrow_ribbons([course], HALF)
    assert np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max() < 0.01
    for of_nothing in (ribbons.arrow_ribbons([], HALF), ribbons.line_ribbons([], HALF)):
        assert [part.shape for part in of_nothing] == [(0, 3), (0, 3)]


def test_a_line_has_heads_along_it():
    course = ribbons.course_of(SPHERE, around(3.0))
    vertices, faces = ribbons.line_ribbons([course], HALF)
    assert faces.max() == len(vertices) - 1
    off = np.abs(
        vertices[:, 2] - np.interp(angles(vertices), angles(course.places), course.places[:, 2])
    )
    wide = np.sort(angles(vertices[off > 1.5 * HALF]))
    heads = 1 + (np.diff(wide) > 0.1).sum()
    assert heads == pytest.approx(course.lengths[-1] / 0.16, abs=1)


def test_isolines_are_where_the_function_has_their_values():
    mesh = square(20)
    x = mesh.vertices[:, 0]
    vertices, faces = ribbons.isoline_ribbons(mesh, x, [0.25, 0.6], HALF)
    off = np.abs(mesh.length_scale * vertices[:, :1] - [0.25, 0.6]).min(axis=1)
    assert off.max() < 2 * HALF * mesh.length_scale
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    assert np.ptp(vertices[:, 1]) * mesh.length_scale >= 1


def test_a_constant_function_has_no_isolines():
    mesh = square(6)
    flat = np.where(mesh.vertices[:, 0] > 0.5, 1.0, 0.5)
    _, faces = ribbons.isoline_ribbons(mesh, flat, [0.5, 1.0], HALF)
    in_flat_parts = np.ptp(flat[mesh.faces], axis=1) == 0
    assert 0 < len(faces) <= 4 * (~in_flat_parts).sum()
    assert len(ribbons.isoline_ribbons(mesh, np.ones(len(flat)), [1.0], HALF)[1]) == 0


def test_lines_lie_outside_a_surface_that_is_inside_out():
    inside_out = TriangleMesh(SPHERE.vertices, SPHERE.faces[:, ::-1])
    course = ribbons.course_through(inside_out, SPHERE.vertices[[0, 20, 40]])
    assert (course.normals * course.places).sum(axis=1).min() > 0
    levels = [0.0, 0.5]
    found, expected = (
        ribbons.isoline_ribbons(mesh, mesh.vertices[:, 2], levels, HALF)[0]
        for mesh in (inside_out, SPHERE)
    )
    assert np.linalg.norm(found, axis=1).min() == pytest.approx(
        np.linalg.norm(expected, axis=1).min()
    )
