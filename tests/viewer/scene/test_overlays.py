"""Which arrows are drawn, and how long they are."""

from __future__ import annotations

import numpy as np
import pytest

from abfm.calculus.operators import face_areas
from abfm_viewer.automation import Driver
from abfm_viewer.scene import marks
from abfm_viewer.scene.opengl import ps
from tests.shapes import icosphere

SPHERE = icosphere(3)


@pytest.fixture
def arrows(monkeypatch):
    """Draws a field's arrows with length 0.1; the starts and vectors of those that were drawn."""
    found = {}
    with Driver(icosphere(1), size=(400, 300)):

        def kept(starts, vectors, radius):
            found.update(starts=starts, vectors=vectors)
            return arrow_mesh(starts, vectors, radius)

        arrow_mesh = marks.arrow_mesh
        monkeypatch.setattr(marks, "arrow_mesh", kept)

        def draw(velocity, density=0.5):
            marks.draw_arrows("arrows", SPHERE, velocity, 0.1, density, lambda places: places, (0, 0, 0))
            return found["vectors"]

        yield draw
        ps.remove_all_structures()


def test_faces_are_spread_and_the_largest_of_their_places():
    faces = [marks.evenly_spread(SPHERE, density) for density in (0.0, 0.5, 1.0)]
    assert len(faces[0]) < len(faces[1]) < len(faces[2])
    for chosen in faces:
        assert len(np.unique(chosen)) == len(chosen)
        assert face_areas(SPHERE)[chosen].mean() >= face_areas(SPHERE).mean()


def test_arrows_are_along_the_field_and_one_outlier_leaves_them_their_length(arrows):
    velocity = np.cross(SPHERE.vertices[SPHERE.faces].mean(axis=1), [0, 0, 1.0])
    usual = np.linalg.norm(arrows(velocity), axis=1)
    assert usual.max() == pytest.approx(0.1, rel=0.05)
    velocity[marks.evenly_spread(SPHERE, 0.5)[3]] *= 1e6
    wild = np.linalg.norm(arrows(velocity), axis=1)
    assert np.sort(wild)[-2] == pytest.approx(0.1, rel=0.05)
    assert wild.max() == pytest.approx(0.125, rel=0.05)


def test_a_field_that_moves_nothing_but_one_face_has_one_arrow(arrows):
    velocity = np.zeros((len(SPHERE.faces), 3))
    hidden = np.setdiff1d(np.arange(len(SPHERE.faces)), marks.evenly_spread(SPHERE, 0.5))[0]
    velocity[hidden] = 1e-100 * (SPHERE.vertices[SPHERE.faces[hidden, 1]] - SPHERE.vertices[SPHERE.faces[hidden, 0]])
    assert np.linalg.norm(arrows(velocity), axis=1) == pytest.approx([0.1])
