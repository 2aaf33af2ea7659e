import numpy as np
import pytest
from scipy.spatial.distance import cdist

from abfm import TriangleMesh
from abfm.calculus import face_normals
from abfm.maps import spread_points
from abfm.maps.spread_points import SPACING_MIN
from abfm.maps.surface_points import points_by_area
from abfm.mesh.shapes import five_limbs
from tests.shapes import icosphere, square

LIMBS = five_limbs(2000)


def spread(mesh, spacing):
    """Return the positions of points with a spacing, in sqrt(area)."""
    return spread_points(mesh).with_spacing(spacing).positions / mesh.length_scale


def sheet(thickness):
    """Return a box with two large sides and few, uneven triangles."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return TriangleMesh(corners * [1, 1, thickness], np.array(faces))


@pytest.mark.parametrize("spacing", [0.03, 0.06, 0.13])
@pytest.mark.parametrize("mesh", [LIMBS, icosphere(3), square(6)], ids=["limbs", "ball", "square"])
def test_points_keep_their_spacing_and_cover_the_surface(mesh, spacing):
    places = spread(mesh, spacing)
    normals = face_normals(mesh)[spread_points(mesh).with_spacing(spacing).faces]
    distances = cdist(places, places) + 9 * np.eye(len(places))
    distances[normals @ normals.T < 0] = 9  # points on both sides of thin parts
    assert distances.min() >= spacing
    everywhere = points_by_area(mesh, 3001)
    nearest = cdist(everywhere.positions / mesh.length_scale, places)
    nearest[face_normals(mesh)[everywhere.faces] @ normals.T < -0.7] = 9
    assert nearest.min(axis=1).max() < 1.5 * spacing


def test_number_does_not_depend_on_the_triangulation():
    counts = [len(spread(mesh, 0.05)) for mesh in (icosphere(1), icosphere(4), sheet(1.0))]
    discs = 4 / (np.pi * 0.05**2)  # the number whose total area is that of the surface
    assert all(0.42 * discs < count < 0.91 * discs for count in counts)


def test_larger_spacing_gives_a_subset():
    found = spread_points(LIMBS)
    assert (found.gaps[1:] <= found.gaps[:-1]).all()
    assert found.gaps[-1] >= SPACING_MIN
    few, many = found.with_spacing(0.1), found.with_spacing(0.03)
    assert 0 < len(few.faces) < len(many.faces)
    np.testing.assert_array_equal(few.positions, many.positions[: len(few.faces)])


def test_points_are_deterministic_and_move_with_the_mesh():
    again = TriangleMesh(LIMBS.vertices.copy(), LIMBS.faces.copy())
    np.testing.assert_array_equal(spread(again, 0.05), spread(LIMBS, 0.05))
    rotation = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    moved = TriangleMesh(1e-3 * LIMBS.vertices @ rotation.T + 0.1, LIMBS.faces)
    there = spread_points(moved).with_spacing(0.05).positions
    here = spread_points(LIMBS).with_spacing(0.05).positions
    np.testing.assert_allclose(there, 1e-3 * here @ rotation.T + 0.1, atol=1e-9)


def test_both_sides_of_a_thin_sheet_have_points():
    heights = spread_points(sheet(0.001)).with_spacing(0.06).positions[:, 2]
    below, above = (heights < 1e-6).sum(), (heights > 0.001 - 1e-6).sum()
    assert min(below, above) >= 100
    assert abs(below - above) < 0.1 * (below + above)
