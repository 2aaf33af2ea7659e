import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from abfm.assets import asset_path
from abfm.calculus.operators import face_areas
from abfm.errors import MeshError
from abfm.maps import sphere_embedding
from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.shapes import five_limbs, geodesic_sphere, three_arms, torus, two_armed
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere, square, tetrahedron


def solid_angles(sphere, faces):
    """Return signed solid angles [Van Oosterom, Strackee 1983] of faces within a half-sphere."""
    a, b, c = np.moveaxis(sphere[faces], 1, 0)
    over = 1 + (a * b).sum(axis=1) + (b * c).sum(axis=1) + (c * a).sum(axis=1)
    return 2 * np.arctan2(np.linalg.det(sphere[faces]), over)


def assert_embedded(mesh, sphere):
    """Assert that no face is flipped and that the faces cover the sphere once."""
    angles = solid_angles(sphere, mesh.faces)
    assert_allclose(np.linalg.norm(sphere, axis=1), 1, atol=1e-14)
    assert angles.min() > 0
    assert_allclose(angles.sum(), 4 * np.pi, rtol=1e-9)
    return angles


def noisy():
    ball = icosphere(3)
    moves = np.random.default_rng(0).normal(scale=0.3, size=ball.vertices.shape)
    return TriangleMesh(ball.vertices + moves, ball.faces)


def spiked():
    ball = icosphere(3)
    radius = np.where(np.arange(len(ball.vertices)) % 3, 1.0, 0.001)
    return TriangleMesh(ball.vertices * radius[:, None], ball.faces)


def fans():
    """Return a cylinder whose ends are fans of 100 slivers."""
    solid = trimesh.creation.cylinder(radius=1, height=20, sections=100)
    return TriangleMesh(solid.vertices, solid.faces)


def nested(times):
    """Return a ball with nested faces in one face, each with 0.2 times the previous size."""
    vertices, faces = list(icosphere(2).vertices), icosphere(2).faces.tolist()
    for _ in range(times):
        a, b, c = faces[0]
        new = len(vertices)
        vertices.append(0.6 * vertices[a] + 0.2 * vertices[b] + 0.2 * vertices[c])
        faces[0] = [a, b, new]
        faces += [[b, c, new], [c, a, new]]
    return TriangleMesh(vertices, faces)


SHAPES = {
    "tetrahedron": tetrahedron,
    "icosahedron": lambda: geodesic_sphere(1),
    "five limbs": lambda: five_limbs(1000),
    "three arms": lambda: three_arms(4)[0],
    "two arms": lambda: two_armed(3),
    "human A": lambda: load_mesh(asset_path("human_A.off")),
    "human B": lambda: load_mesh(asset_path("human_B.off")),
    "needle": lambda: ellipsoid(3, 1, 1, 1000),
    "leaf": lambda: ellipsoid(3, 1, 1, 1e-4),
    "noise": noisy,
    "spikes": spiked,
    "fans": fans,
    "tiny faces": lambda: nested(10),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_no_face_is_flipped(shape):
    mesh = SHAPES[shape]()
    assert_embedded(mesh, sphere_embedding(mesh))


def test_spheres_are_preserved_up_to_a_rotation():
    ball = geodesic_sphere(12)
    sphere = sphere_embedding(ball)
    u, _, v = np.linalg.svd(sphere.T @ ball.vertices)
    assert np.linalg.det(u @ v) > 0
    assert_allclose(sphere @ (u @ v), ball.vertices, atol=0.02)


def test_areas_of_limbs_change_little():
    mesh = five_limbs(1000)
    angles = assert_embedded(mesh, sphere_embedding(mesh))
    ratios = angles / face_areas(mesh.normalized()) / (4 * np.pi)
    assert np.average(np.abs(np.log2(ratios)), weights=face_areas(mesh)) < 0.4
    assert np.abs(np.log2(ratios)).max() < 1.5


def gaps(mesh, first, second):
    """Return distances between two embeddings after the best rotation."""
    u, _, v = np.linalg.svd(first.T @ second)
    return np.linalg.norm(first @ u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v - second, axis=1)


def test_embedding_is_deterministic_and_nearly_invariant():
    mesh = two_armed(3)
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    other = TriangleMesh(70.0 * mesh.vertices @ turn.T + [1, 2, 3], mesh.faces)
    sphere = sphere_embedding(mesh)
    assert gaps(mesh, sphere, sphere_embedding(other)).mean() < 0.05
    assert (sphere_embedding(mesh) == sphere).all()


def test_renumbering_has_little_influence():
    mesh = five_limbs(1000)
    old = np.random.default_rng(5).permutation(len(mesh.vertices))
    other = TriangleMesh(mesh.vertices[old], np.argsort(old)[mesh.faces])
    sphere = sphere_embedding(other)
    assert_embedded(other, sphere)
    assert gaps(mesh, sphere_embedding(mesh)[old], sphere).mean() < 0.05


@pytest.mark.parametrize("holes", [1, 3])
def test_holes_stay_uncovered(holes):
    ball = icosphere(3)
    centroids = ball.vertices[ball.faces].mean(axis=1)
    outside = [centroids @ np.eye(3)[k] < 0.85 for k in range(holes)]
    mesh = TriangleMesh(ball.vertices, ball.faces[np.all(outside, axis=0)])
    angles = solid_angles(sphere_embedding(mesh), mesh.faces)
    assert len(mesh.boundary_loops) == holes
    assert angles.min() > 0
    assert_allclose(angles.sum(), 4 * np.pi - holes * 2 * np.pi * 0.15, rtol=0.05)


def test_a_disc_is_embedded():
    mesh = square(8)
    angles = solid_angles(sphere_embedding(mesh), mesh.faces)
    assert angles.min() > 0
    assert angles.sum() < 4 * np.pi


def test_handles_are_refused():
    with raises(MeshError, 1, 0):
        sphere_embedding(torus(12, 8))


def test_pinched_vertices_are_refused():
    ball = icosphere(1)
    first = ball.vertices[0]
    twice = np.concatenate([ball.vertices, 2 * first - ball.vertices[1:]])
    other = np.append(0, np.arange(len(ball.vertices), len(twice)))[ball.faces][:, ::-1]
    with raises(MeshError):
        sphere_embedding(TriangleMesh(twice, np.concatenate([ball.faces, other])))
