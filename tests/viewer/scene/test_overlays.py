"""Which arrows are drawn, where they go, and how long they are."""

from __future__ import annotations

import numpy as np
import pytest

from abfm.calculus.operators import face_areas
from abfm_viewer.scene import ribbons
from tests.shapes import icosphere

SPHERE = icosphere(3)
UNIT = SPHERE.length_scale


def lengths(velocity):
    """Of the arrows of a field, where the fast ones are to be 0.1 long."""
    return np.array(
        [course.lengths[-1] for course in ribbons.arrow_courses(SPHERE, velocity, 0.1, 0.5)]
    )


def rotation():
    return np.cross([0, 0, 1.0], SPHERE.vertices[SPHERE.faces].mean(axis=1))


def test_faces_are_spread_and_the_largest_of_their_places():
    faces = [ribbons.evenly_spread(SPHERE, density) for density in (0.0, 0.5, 1.0)]
    assert len(faces[0]) < len(faces[1]) < len(faces[2])
    for chosen in faces:
        assert len(np.unique(chosen)) == len(chosen)
        assert face_areas(SPHERE)[chosen].mean() >= face_areas(SPHERE).mean()


def test_arrows_go_with_the_field_and_stay_on_the_surface():
    for course in ribbons.arrow_courses(SPHERE, rotation(), 0.1, 0.5):
        places = UNIT * course.places
        assert np.linalg.norm(places, axis=1).max() <= 1 + 1e-9
        assert np.linalg.norm(places, axis=1).min() > 0.98
        turned = np.unwrap(np.arctan2(places[:, 1], places[:, 0]))
        assert (np.diff(turned) >= -1e-9).all()
        np.testing.assert_allclose(places[:, 2], places[0, 2], atol=0.03)


def test_the_fast_ones_have_the_full_length_and_one_outlier_leaves_them_that():
    velocity = rotation()
    assert lengths(velocity).max() == pytest.approx(0.1, rel=0.05)
    velocity[ribbons.evenly_spread(SPHERE, 0.5)[3]] *= 1e6
    assert np.sort(lengths(velocity))[-2] == pytest.approx(0.1, rel=0.1)
    assert lengths(velocity).max() < 0.13
    np.testing.assert_allclose(lengths(1e-100 * velocity), lengths(velocity), rtol=1e-6)


def test_a_field_that_moves_nothing_but_one_face_has_one_arrow_in_it():
    velocity = np.zeros((len(SPHERE.faces), 3))
    hidden = np.setdiff1d(np.arange(len(SPHERE.faces)), ribbons.evenly_spread(SPHERE, 0.5))[0]
    velocity[hidden] = 1e-100 * (
        SPHERE.vertices[SPHERE.faces[hidden, 1]] - SPHERE.vertices[SPHERE.faces[hidden, 0]]
    )
    assert len(lengths(velocity)) == 1
    assert 0 < lengths(velocity)[0] <= 0.1
    assert len(lengths(0 * velocity)) == 0


def test_ribbons_face_outwards_so_that_none_on_the_far_side_peeps_over_an_edge():
    courses = ribbons.arrow_courses(SPHERE, rotation(), 0.1, 0.5)
    levels = np.linspace(-0.5, 0.5, 5)
    for vertices, faces in (
        ribbons.arrow_ribbons(courses, 0.005),
        ribbons.line_ribbons(courses, 0.005),
        ribbons.isoline_ribbons(SPHERE, SPHERE.vertices[:, 2], levels, 0.005),
    ):
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        outwards = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1)
        assert (outwards > 0).sum() > 0.8 * len(faces)  # tips and corners have no area
        assert (outwards >= -1e-15).all()
