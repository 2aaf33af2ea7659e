"""Arrows are closed solids from start to end."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from abfm_viewer.scene.arrow_mesh import arrow_mesh

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("length", [1e-6, 0.01, 1.0, 100.0])
def test_each_arrow_is_a_closed_solid_between_its_ends(length):
    starts = RNG.normal(size=(7, 3))
    vectors = RNG.normal(size=(7, 3))
    vectors *= length / np.linalg.norm(vectors, axis=1)[:, None]
    vertices, faces = arrow_mesh(np.zeros((7, 3)), vectors, 0.01)
    solid = trimesh.Trimesh(vertices, faces, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    for one, vector in zip(np.split(vertices, 7), vectors, strict=True):
        along = one @ vector / length
        assert along.min() == pytest.approx(0, abs=1e-9 * length)
        np.testing.assert_allclose(one[along.argmax()], vector)
        assert np.linalg.norm(one - along[:, None] * vector / length, axis=1).max() <= 0.024 + 1e-12
    pieces = [trimesh.Trimesh(v, faces[: len(faces) // 7], process=False) for v in np.split(vertices, 7)]
    assert all(piece.volume > 0 for piece in pieces)
    moved, same = arrow_mesh(starts, vectors, 0.01)
    np.testing.assert_allclose(moved, vertices + np.repeat(starts, len(vertices) // 7, axis=0), atol=1e-12)
    np.testing.assert_array_equal(same, faces)


def test_along_the_axes_and_without_any():
    vertices, faces = arrow_mesh(np.zeros((6, 3)), np.concatenate([np.eye(3), -np.eye(3)]), 0.01)
    assert np.isfinite(vertices).all()
    assert faces.max() == len(vertices) - 1
    vertices, faces = arrow_mesh(np.zeros((2, 3)), np.zeros((2, 3)), 0.01)
    assert (vertices.shape, faces.shape) == ((0, 3), (0, 3))
