"""Coarse meshes preserve topology and orientation, and approximate the surface; subdivision."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm.assets import asset_path
from abfm.calculus.operators import cotangent_laplacian, face_areas, face_normals
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import coarsened
from abfm.mesh.subdivision import interpolated, subdivided
from tests.core.surfaces import SURFACES
from tests.core.verification import observed_orders
from tests.shapes import disc, hemisphere, icosphere, open_cylinder, square, torus

FINE = {
    "sphere": icosphere(4),
    "torus": torus(60, 30),
    "genus two": SURFACES["genus two"],
    "body": abfm.load_mesh(asset_path("human_A.off")),
    "square": square(30),
    "hemisphere": hemisphere(20),
    "cylinder": open_cylinder(40, 20),
}
EACH_FINE = pytest.mark.parametrize("fine", FINE.values(), ids=FINE)
EACH_SURFACE = pytest.mark.parametrize("mesh", SURFACES.values(), ids=SURFACES)


@pytest.mark.parametrize("share", [0.6, 0.25, 0.12])
@EACH_FINE
def test_coarsening_preserves_topology(fine, share):
    requested = int(share * len(fine.vertices))
    coarse = coarsened(fine, requested)
    assert requested * 0.95 <= len(coarse.vertices) <= 1.2 * requested
    for name in ("euler_characteristic", "genus"):
        assert getattr(coarse, name) == getattr(fine, name)
    assert len(coarse.boundary_loops) == len(fine.boundary_loops)
    assert coarse.messages == ()


@EACH_FINE
def test_coarse_mesh_approximates_the_surface(fine):
    coarse = coarsened(fine, len(fine.vertices) // 4)
    edge = fine.length_scale / np.sqrt(len(coarse.faces))
    middles = coarse.vertices[coarse.faces].mean(axis=1)
    near = project_onto_surface(fine, middles)
    assert near.distances_from(middles).max() < edge
    cosines = (face_normals(coarse) * face_normals(fine)[near.faces]).sum(axis=1)
    assert np.average(cosines, weights=face_areas(coarse)) > 0.85
    back = project_onto_surface(coarse, fine.vertices).distances_from(fine.vertices)
    assert back.max() < 3 * edge  # ends of limbs and corners are cut off


@pytest.mark.parametrize("make", [icosphere, lambda k: torus(15 * 2 ** (k - 2), 7 * 2 ** (k - 2))])
def test_area_converges_with_the_count(make):
    """The area that a quarter of the vertices misses is of order 2 in the edge length."""
    missing = []
    for k in (3, 4, 5):
        fine = make(k)
        coarse = coarsened(fine, len(fine.vertices) // 4)
        missing.append(1 - face_areas(coarse).sum() / face_areas(fine).sum())
    assert observed_orders([4, 2, 1], missing).min() > 1.6
    assert missing[-1] < 0.005


def median_over_smallest_height(mesh):
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    heights = 2 * face_areas(mesh) / longest
    return np.median(heights) / heights.min()


def test_slivers_collapse_first():
    """Two rings of vertices at a hundredth of the edge length collapse first."""
    even = open_cylinder(40, 20)
    height = even.vertices[:, 2]
    ring = np.isclose(height, np.unique(height.round(9))[10])
    fine = TriangleMesh(even.vertices - np.outer(ring, [0, 0, 0.099]), even.faces)
    coarse = coarsened(fine, int(0.7 * len(fine.vertices)))
    assert median_over_smallest_height(coarse) < 0.1 * median_over_smallest_height(fine)


def test_coarsening_is_reproducible_and_cached():
    mesh, one = FINE["body"], coarsened(FINE["body"], 300)
    for unit in (1.0, 2.0**20, 2.0**-20):
        other = coarsened(TriangleMesh(unit * mesh.vertices, mesh.faces), 300)
        assert_array_equal(one.vertices, other.vertices / unit)
        assert_array_equal(one.faces, other.faces)
    mesh = torus(40, 20)
    assert coarsened(mesh, 200) is coarsened(mesh, 200)
    assert coarsened(mesh, 100) is not coarsened(mesh, 200)


@pytest.mark.parametrize(
    ("mesh", "count"),
    [
        *((SURFACES[name], 4) for name in ("tetrahedron", "triangle", "no inner vertices")),
        *((SURFACES["genus two"], 9), (open_cylinder(30, 1), 4), (disc(8), 4)),
        *((icosphere(2), count) for count in (1, 3, 162, 1000)),
    ],
)
def test_impossible_coarsening_returns_none(mesh, count):
    assert coarsened(mesh, count) is None


@EACH_SURFACE
def test_children_cover_their_parent(mesh):
    fine = subdivided(mesh)
    assert_allclose(face_areas(fine), np.repeat(face_areas(mesh) / 4, 4))
    normals = np.repeat(face_normals(mesh), 4, axis=0)
    assert_allclose(face_normals(fine), normals, rtol=0, atol=1e-12)
    corners = fine.vertices[fine.faces].reshape(-1, 4, 3, 3)
    parents = mesh.vertices[mesh.faces]
    for c in range(3):
        assert_array_equal(corners[:, c, c], parents[:, c])
        middle = (parents[:, (c + 1) % 3] + parents[:, (c + 2) % 3]) / 2
        assert_allclose(corners[:, 3, c], middle, rtol=0, atol=1e-15)
    # the children at corners are scaled copies of the parent
    halves = (parents[:, None] + parents[:, :, None]) / 2
    assert_allclose(corners[:, :3], halves, rtol=0, atol=1e-15)
    count = len(mesh.vertices)
    assert len(fine.vertices) == count + len(mesh.edges)
    assert len(fine.faces) == 4 * len(mesh.faces)
    assert fine.messages == ()
    for name in ("euler_characteristic", "genus", "is_closed"):
        assert getattr(fine, name) == getattr(mesh, name)
    assert len(fine.boundary_loops) == len(mesh.boundary_loops)
    assert_array_equal(fine.is_boundary_vertex[count:], mesh.is_boundary_edge)
    assert_array_equal(fine.is_boundary_vertex[:count], mesh.is_boundary_vertex)


@EACH_SURFACE
def test_subdivision_preserves_functions(mesh):
    fine, f = subdivided(mesh), np.random.default_rng(0).normal(size=(len(mesh.vertices), 2))
    g = interpolated(mesh, f)
    assert_allclose(project_onto_surface(mesh, fine.vertices).pull_back(f), g, rtol=0, atol=1e-9)
    energies = [h.T @ (cotangent_laplacian(m) @ h) for m, h in ((mesh, f), (fine, g))]
    assert_allclose(*energies, rtol=1e-9)
