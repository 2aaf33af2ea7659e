"""Vertices on creases are drawn once for every smooth side."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from abfm import TriangleMesh, load_mesh
from abfm.assets import asset_path
from abfm_viewer.scene.surfaces import drawn_mesh
from tests.shapes import icosphere, open_cylinder


def box():
    """A cube with even triangles."""
    shape = trimesh.creation.box().subdivide().subdivide()
    return TriangleMesh(shape.vertices, shape.faces)


@pytest.mark.parametrize("mesh", [icosphere(3), open_cylinder(40, 6)])
def test_a_smooth_mesh_is_drawn_as_it_is(mesh):
    drawn = drawn_mesh(mesh)
    np.testing.assert_array_equal(drawn.origin, np.arange(len(mesh.vertices)))
    np.testing.assert_array_equal(drawn.faces, mesh.faces)
    assert drawn_mesh(mesh) is drawn


def test_a_cube_has_six_sides():
    mesh = box()
    drawn = drawn_mesh(mesh)
    np.testing.assert_array_equal(drawn.origin[drawn.faces], mesh.faces)
    sides = np.bincount(drawn.origin)
    # 3 at corners, 2 on edges, 1 inside sides
    edges = (np.abs(np.abs(mesh.vertices) - 0.5) < 1e-9).sum(axis=1)
    np.testing.assert_array_equal(sides, edges)
    normals = np.cross(
        *(mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[:, 0]] for k in (1, 2))
    )
    for vertex in range(len(drawn.origin)):
        around = normals[(drawn.faces == vertex).any(axis=1)]
        assert np.linalg.matrix_rank(around, tol=1e-6) == 1
    np.testing.assert_array_equal(drawn.values(mesh.vertices), mesh.vertices[drawn.origin])
    np.testing.assert_array_equal(drawn_mesh(icosphere(1)).values(np.arange(42)), np.arange(42))


def test_the_bends_of_a_coarse_body_are_no_creases():
    body = load_mesh(asset_path("human_A.off"))
    assert len(drawn_mesh(body).origin) == len(body.vertices)
    part = load_mesh(asset_path("fandisk.off"))
    assert len(part.vertices) < len(drawn_mesh(part).origin) < 1.2 * len(part.vertices)


def test_a_crease_that_ends_on_a_smooth_surface_splits_nothing_at_its_end():
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21), indexing="ij")
    z = np.maximum(x, 0) ** 2 * np.abs(y) * 2  # a valley that begins in the middle
    i, j = np.meshgrid(np.arange(20), np.arange(20), indexing="ij")
    a, b, c, d = i * 21 + j, (i + 1) * 21 + j, (i + 1) * 21 + j + 1, i * 21 + j + 1
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    mesh = TriangleMesh(np.stack([x, y, z], -1).reshape(-1, 3), faces)
    drawn = drawn_mesh(mesh)
    twice = np.flatnonzero(np.bincount(drawn.origin) > 1)
    assert len(twice) > 3
    np.testing.assert_allclose(mesh.vertices[twice, 1], 0, atol=1e-12)
    assert mesh.vertices[twice, 0].min() > 0


@pytest.mark.parametrize("degrees", [15, 30, 60])
def test_on_a_part_that_is_made_of_planes_half_sharp_edges_are_creases_too(degrees):
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9), indexing="ij")
    z = np.tan(np.radians(degrees)) * np.maximum(x, 0)
    i, j = np.meshgrid(np.arange(8), np.arange(8), indexing="ij")
    a, b, c, d = i * 9 + j, (i + 1) * 9 + j, (i + 1) * 9 + j + 1, i * 9 + j + 1
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    mesh = TriangleMesh(np.stack([x, y, z], -1).reshape(-1, 3), faces)
    split = np.flatnonzero(np.bincount(drawn_mesh(mesh).origin) > 1)
    np.testing.assert_array_equal(
        split, np.flatnonzero(mesh.vertices[:, 0] == 0) if degrees > 20 else []
    )
