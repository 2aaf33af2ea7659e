import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm.calculus.geodesics import exact_distances
from abfm.calculus.operators import face_frames
from abfm.flow.continuous_flow import Walker, smooth_flow, walk_straight
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.matching.terms.squared_distances import SquaredDistances
from abfm.mesh import TriangleMesh
from tests.core.surfaces import SURFACES, random_points
from tests.core.verification import near, observed_orders
from tests.shapes import ellipsoid, icosphere, square


def repeated(points, number, count):
    return points[np.full(count, number)]


def test_distances_on_a_plane_are_exact():
    mesh = square(7)
    to, points = random_points(mesh, 40, 0), random_points(mesh, 40, 1)
    distances, offsets = SquaredDistances(to), points.positions - to.positions
    near(distances.at(points), (offsets**2).sum(axis=1), 1e-13)
    frames = face_frames(mesh)[points.faces]
    near(distances.slopes(points), 2 * np.einsum("lkx,lx->lk", frames, offsets), 1e-11)


def test_distances_are_exact_near_the_point():
    for name in ("ellipsoid", "torus", "genus two", "hemisphere"):
        mesh = SURFACES[name]
        to = random_points(mesh, 10, 2)
        middles = SurfacePoints(mesh, to.faces, np.full((10, 3), 1 / 3))
        exact = np.linalg.norm(middles.positions - to.positions, axis=1)
        assert_allclose(SquaredDistances(to).at(middles), exact**2, rtol=1e-9)
        near(SquaredDistances(to).at(to), 0, 1e-14)
        near(SquaredDistances(to).slopes(to), 0, 1e-12)


@pytest.mark.parametrize("name", ["ellipsoid", "torus", "genus two", "hemisphere", "cylinder"])
def test_distances_approximate_geodesic_distances(name):
    mesh = SURFACES[name].normalized()
    every = np.arange(len(mesh.vertices))
    for source in (0, 17):
        to = repeated(vertex_points(mesh, [source]), 0, len(every))
        found = np.sqrt(SquaredDistances(to).at(vertex_points(mesh)))
        exact = exact_distances(mesh, source, every)
        assert np.abs(found - exact).mean() < 0.02 * exact.max()
        assert np.abs(found - exact).max() < 0.05 * exact.max()


def test_distances_on_a_sphere_converge_to_arcs():
    errors = []
    for subdivisions in (2, 3, 4):
        mesh = icosphere(subdivisions)
        to, points = random_points(mesh, 60, 3), random_points(mesh, 60, 4)
        units = (p.positions / np.linalg.norm(p.positions, axis=1)[:, None] for p in (to, points))
        arcs = np.arccos(np.clip(np.einsum("px,px->p", *units), -1, 1))
        errors.append(np.abs(np.sqrt(SquaredDistances(to).at(points)) - arcs).mean())
    assert observed_orders([4, 2, 1], errors).min() > 0.9
    assert errors[-1] < 0.01


def test_distances_are_continuous_with_exact_slopes():
    mesh = SURFACES["genus two"].normalized()
    slots = mesh.edge_slots[~mesh.is_boundary_edge][:40]
    weights = np.zeros((2, len(slots), 3))
    for side in range(2):
        faces, corners = np.divmod(slots[:, side], 3)
        first = mesh.faces[faces, (corners + 1) % 3] == mesh.edges[~mesh.is_boundary_edge][:40, 0]
        rows = np.arange(len(slots))
        weights[side, rows, (corners + 1) % 3] = np.where(first, 0.3, 0.7)
        weights[side, rows, (corners + 2) % 3] = np.where(first, 0.7, 0.3)
    distances = SquaredDistances(random_points(mesh, len(slots), 5))
    sides = [SurfacePoints(mesh, slots[:, side] // 3, weights[side]) for side in range(2)]
    here, there = map(distances.at, sides)
    near(here, there, 1e-13)
    points, step = random_points(mesh, 40, 6), 1e-4 * np.array([1.0, -2.0, 1.0])
    after = SurfacePoints(mesh, points.faces, points.barycentric + step)
    before = SurfacePoints(mesh, points.faces, points.barycentric - step)
    motion = after.positions - before.positions
    moved = np.einsum("lkx,lx->lk", face_frames(mesh)[points.faces], motion)
    slopes = (distances.slopes(points) * moved).sum(axis=1)
    assert_allclose(distances.at(after) - distances.at(before), slopes, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("name", ["sphere", "flat ellipsoid", "torus", "genus two", "cylinder"])
def test_descent_leads_to_the_point(name):
    mesh = (SURFACES | {"sphere": icosphere(3), "flat ellipsoid": ellipsoid(2, 1.0, 1.0, 0.1)})[
        name
    ].normalized()
    starts, size = random_points(mesh, 60, 7), 0.5 / np.sqrt(len(mesh.faces))
    to = repeated(random_points(mesh, 1, 8), 0, 60)
    distances, flow = SquaredDistances(to), smooth_flow(mesh, np.zeros((len(mesh.faces), 3)))
    points = starts
    for _ in range(int(2.5 / size)):
        vectors = -0.5 * distances.slopes(points)
        vectors *= np.minimum(1, size / np.maximum(np.linalg.norm(vectors, axis=1), 1e-30))[:, None]
        points = walked(mesh, flow, points, vectors)
    assert np.sqrt(distances.at(points).clip(0)).max() < 1e-6


def walked(mesh, flow, points, vectors):
    faces, weights = points.faces.copy(), points.barycentric.copy()
    corners = mesh.vertices[mesh.faces[faces]]
    places = np.einsum("px,pkx->pk", points.positions - corners[:, 0], face_frames(mesh)[faces])
    for i, ((x, y), (u, v)) in enumerate(zip(places, vectors, strict=True)):
        end = walk_straight(flow, Walker(faces[i], x, y, u, v), True)
        faces[i] = end.face
        inside = flow.gradients[end.face] @ [end.x, end.y] + [1, 0, 0]
        weights[i] = np.maximum(inside, 0) / np.maximum(inside, 0).sum()
    return SurfacePoints(mesh, faces, weights)


def test_distances_scale_with_the_unit():
    mesh = SURFACES["torus"]
    large = TriangleMesh(1e6 * mesh.vertices, mesh.faces)
    one, other = (
        SquaredDistances(random_points(each, 9, 1)).at(random_points(each, 9, 2))
        for each in (mesh, large)
    )
    assert_allclose(other, 1e12 * one, rtol=1e-9)
