"""Folds: none where faces are only stretched, all where a map reflects, collapsed is not folded."""

from collections.abc import Callable

import numpy as np
import pytest

from abfm.flow.continuous_flow import ContinuousFlow
from abfm.maps.distortion import MOST, folds, turned_parts
from abfm.maps.surface_points import SurfacePoints, project_onto_surface, vertex_points
from tests.core.fields import rotation_field, wavy_field
from tests.shapes import icosphere, square

Map = Callable[[SurfacePoints], SurfacePoints]


def by_positions(mesh, move):
    """A map of the surface from one of space."""
    return lambda points: project_onto_surface(mesh, move(points.positions))


def shares(mesh, carried, most=MOST):
    places = carried(vertex_points(mesh)).positions
    return folds(mesh, carried, np.arange(len(mesh.faces)), places[mesh.faces], most)


def test_a_reflection_folds_every_face():
    mesh = square(6)
    assert shares(mesh, by_positions(mesh, lambda x: x * [-1, 1, 1] + [1, 0, 0])) == (1, 1)
    ball = icosphere(3)
    assert shares(ball, by_positions(ball, lambda x: x * [-1, 1, 1])) == (1, 1)


def test_a_map_that_folds_half_of_the_plane_over_folds_that_half():
    mesh = square(40)
    folded, overturned = shares(
        mesh, by_positions(mesh, lambda x: np.abs(x * [2, 1, 1] - [1, 0, 0]))
    )
    left = (mesh.vertices[mesh.faces].mean(axis=1)[:, 0] < 0.5).mean()
    assert abs(folded - left) < 0.02
    assert folded <= overturned


def test_a_collapsed_surface_is_not_folded():
    mesh = square(6)
    assert shares(mesh, by_positions(mesh, lambda x: x * [0, 1, 1] + [0.3, 0, 0]))[0] == 0


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_smooth_flows_fold_nothing_even_where_they_overturn_stretched_faces(seed):
    mesh = icosphere(3)
    turn, field = rotation_field(mesh, [1, 0, 0]), 5 * wavy_field(mesh, seed)
    assert shares(mesh, ContinuousFlow(mesh, turn, 1.0).destinations) == (0, 0)
    folded, overturned = shares(mesh, ContinuousFlow(mesh, field, 0.2).destinations)
    assert overturned > 0.02
    assert folded < 0.05 * overturned


def test_of_very_many_faces_some_stand_for_all():
    mesh = square(30)
    carried = by_positions(mesh, lambda x: np.abs(x * [2, 1, 1] - [1, 0, 0]))
    exact, _ = shares(mesh, carried)
    asked = []

    def counted(start):
        asked.append(len(start.faces))
        return carried(start)

    folded, _ = shares(mesh, counted, 50)
    assert asked == [len(mesh.vertices), 50 * 45]
    assert abs(folded - exact) < 0.05


def test_parts_cover_a_face():
    mesh = square(3)
    half = by_positions(mesh, lambda x: np.abs(x - [0.5, 0, 0]) + np.array([0.25, 0, 0]))
    turned = turned_parts(mesh, half, np.arange(len(mesh.faces)))
    left = mesh.vertices[mesh.faces][..., 0] < 0.5
    assert (turned[left.all(axis=1)] == 1).all()
    assert (turned[~left.any(axis=1)] == 0).all()
    mixed = turned[left.any(axis=1) & ~left.all(axis=1)]
    assert ((mixed > 0) & (mixed < 1)).all()
