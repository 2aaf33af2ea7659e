"""Homeomorphisms from discontinuous maps, without flipped faces."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import KDTree

from abfm.assets import asset_path
from abfm.errors import MeshError
from abfm.maps import PointMap, continuous_map, functional_map, point_map, zoom_out
from abfm.maps.spherical import SphereLayout, map_through_sphere
from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.shapes import torus, two_armed
from abfm.registration import Correspondence
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere


def layouts(points):
    sphere_a, sphere_b = continuous_map(points)
    return SphereLayout(points.codomain, sphere_a), SphereLayout(points.domain, sphere_b)


def noisy_map(domain, codomain, edges, seed=0):
    """Return the map by vertex numbers with each image moved to a random nearby vertex."""
    length = np.linalg.norm(np.diff(codomain.vertices[codomain.edges], axis=1), axis=2).mean()
    near = KDTree(codomain.vertices).query_ball_point(codomain.vertices, edges * length)
    rng = np.random.default_rng(seed)
    return PointMap.of_vertices(domain, codomain, [int(rng.choice(some)) for some in near])


def errors(points):
    """Return distances in space to the images by vertex numbers, in sqrt(area)."""
    gaps = points.positions - points.codomain.vertices
    return np.linalg.norm(gaps, axis=1) / points.codomain.length_scale


@pytest.fixture(scope="module")
def bent():
    """Return two surfaces with the same faces, one of them bent and thicker."""
    a = two_armed(2)
    x, y, z = a.vertices.T
    return a, TriangleMesh(np.stack([x, y + 0.15 * x**2, 1.2 * z], axis=1), a.faces)


@pytest.fixture(scope="module")
def repaired(bent):
    """Return a noisy map between them, and the layouts of A and of B that repair it."""
    a, b = bent
    start = noisy_map(b, a, edges=1.6)
    return start, *layouts(start)


def test_noisy_map_becomes_a_homeomorphism(repaired):
    start, on_a, on_b = repaired
    found = map_through_sphere(on_b, on_a)
    assert start.distortion().flipped.mean() > 0.2
    assert len(on_a.folded) == len(on_b.folded) == 0
    assert found.distortion().flipped.mean() == 0
    assert errors(found).mean() < 0.6 * errors(start).mean()


def test_round_trip_is_the_identity(repaired):
    _, on_a, on_b = repaired
    to_a, to_b = map_through_sphere(on_b, on_a), map_through_sphere(on_a, on_b)
    assert_allclose(to_b.at(to_a.points).positions, on_b.mesh.vertices, atol=1e-9)


def test_units_have_no_influence(repaired):
    start, on_a, on_b = repaired
    a, b = (
        TriangleMesh(factor * mesh.vertices, mesh.faces)
        for factor, mesh in ((8, start.codomain), (0.25, start.domain))
    )
    sphere_a, sphere_b = continuous_map(PointMap.of_vertices(b, a, start.nearest_vertices()))
    assert_allclose(sphere_a, on_a.directions, atol=1e-6)
    assert_allclose(sphere_b, on_b.directions, atol=1e-6)


def test_continuous_maps_hardly_change(bent):
    a, b = bent
    on_a, on_b = layouts(PointMap.of_vertices(b, a))
    found = map_through_sphere(on_b, on_a)
    assert errors(found).mean() < 0.01
    assert found.distortion().log2_area.mean < 0.3


def test_map_by_eigenfunctions_becomes_continuous():
    a, b = (load_mesh(asset_path(f"human_{pose}.off")) for pose in "AB")
    C = zoom_out(a, b, functional_map(PointMap.of_vertices(b, a), 20), 32, step=4)
    start = point_map(a, b, C)
    on_a, on_b = layouts(start)
    found = map_through_sphere(on_b, on_a)
    assert start.distortion().flipped.mean() > 0.03
    assert len(on_b.folded) == 0
    assert found.distortion().flipped.mean() < 0.005
    assert errors(found).mean() < 0.015


def test_map_without_front_and_back_becomes_continuous(bent):
    """A map by few eigenfunctions, which may not cover both sides, becomes continuous."""
    a, b = bent
    flat = KDTree(a.vertices[:, :2]).query(b.vertices[:, :2] + 1e-9)[1]
    on_a, on_b = layouts(PointMap.of_vertices(b, a, flat))
    assert len(on_a.folded) == len(on_b.folded) == 0
    assert map_through_sphere(on_b, on_a).distortion().flipped.mean() == 0


def test_holes_are_preserved():
    ball, egg = icosphere(2), ellipsoid(2, 1, 1.2, 1.1)
    remaining = ball.vertices[ball.faces].mean(axis=1)[:, 0] < 0.85
    a, b = (TriangleMesh(mesh.vertices, mesh.faces[remaining]) for mesh in (ball, egg))
    start = noisy_map(b, a, edges=1.2)
    sphere_a, sphere_b = continuous_map(start)
    off = start.pull_back(sphere_a) - sphere_a
    assert len(a.boundary_loops) == 1
    assert np.linalg.det(sphere_a[a.faces]).min() > 0
    assert np.linalg.det(sphere_b[b.faces]).min() > 0
    assert ((sphere_b - sphere_a) ** 2).sum() < 0.5 * (off**2).sum()


def test_map_onto_the_mirror_image_becomes_continuous(bent):
    """A mirrored map preserves the orientation as a map onto the mirrored surface."""
    a, _ = bent
    mirrored = TriangleMesh(a.vertices * [1, 1, -1], a.faces[:, ::-1])
    same = PointMap.of_vertices(mirrored, a)
    spheres = continuous_map(same.onto_mirror())
    found = map_through_sphere(SphereLayout(mirrored, spheres[1]), SphereLayout(a, spheres[0]))
    gaps = np.linalg.norm(found.positions - a.vertices, axis=1)
    assert gaps.mean() < 0.01 * a.length_scale
    assert Correspondence(found).is_mirrored
    assert Correspondence(found).distortion().folded == 0


def test_handles_are_refused():
    ring = torus(12, 8)
    with raises(MeshError, 1):
        continuous_map(PointMap.of_vertices(ring, ring))
