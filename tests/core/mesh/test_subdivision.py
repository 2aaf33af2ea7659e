"""Midpoint subdivision: the same surface, four faces where there was one, functions that stay
what they are.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.calculus.operators import cotangent_laplacian, face_areas, face_normals
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import interpolated, subdivided
from tests.core.surfaces import SURFACES

EACH_SURFACE = pytest.mark.parametrize("mesh", SURFACES.values(), ids=SURFACES)


@EACH_SURFACE
def test_four_children_cover_their_parent(mesh: TriangleMesh) -> None:
    fine = subdivided(mesh)
    assert_allclose(
        face_areas(fine).reshape(-1, 4), np.repeat(face_areas(mesh)[:, None] / 4, 4, axis=1)
    )
    assert_allclose(
        face_normals(fine), np.repeat(face_normals(mesh), 4, axis=0), rtol=0, atol=1e-12
    )
    corners = fine.vertices[fine.faces].reshape(-1, 4, 3, 3)
    parents = mesh.vertices[mesh.faces]
    for c in range(3):
        assert_array_equal(corners[:, c, c], parents[:, c])
        assert_allclose(
            corners[:, 3, c],
            (parents[:, (c + 1) % 3] + parents[:, (c + 2) % 3]) / 2,
            rtol=0,
            atol=1e-15,
        )
    # children at corners are the parent, half as large
    halves = (parents[:, None] + parents[:, :, None]) / 2
    assert_allclose(corners[:, :3], halves, rtol=0, atol=1e-15)


@EACH_SURFACE
def test_the_topology_stays(mesh: TriangleMesh) -> None:
    fine = subdivided(mesh)
    assert len(fine.vertices) == len(mesh.vertices) + len(mesh.edges)
    assert len(fine.faces) == 4 * len(mesh.faces)
    assert fine.messages == ()
    for name in ("euler_characteristic", "genus", "boundary_loop_count", "is_closed"):
        assert getattr(fine, name) == getattr(mesh, name)
    on_boundary = np.flatnonzero(mesh.is_boundary_edge) + len(mesh.vertices)
    assert_array_equal(
        fine.is_boundary_vertex[len(mesh.vertices) :].nonzero()[0] + len(mesh.vertices), on_boundary
    )
    assert_array_equal(fine.is_boundary_vertex[: len(mesh.vertices)], mesh.is_boundary_vertex)


@EACH_SURFACE
def test_functions_stay_what_they_are(mesh: TriangleMesh) -> None:
    fine, f = subdivided(mesh), np.random.default_rng(0).normal(size=(len(mesh.vertices), 2))
    g = interpolated(mesh, f)
    assert_allclose(project_onto_surface(mesh, fine.vertices).pull_back(f), g, rtol=0, atol=1e-9)
    energies = [
        np.einsum("vi,vj->ij", h, cotangent_laplacian(m) @ h) for m, h in ((mesh, f), (fine, g))
    ]
    assert_allclose(*energies, rtol=1e-9)
