"""Transfer of textures, compared with known images, maps and seams."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import ndimage
from scipy.spatial.transform import Rotation

from abfm import Correspondence, PointMap, TriangleMesh
from abfm.errors import AbfmError, ParameterError
from abfm.maps import project_onto_surface
from abfm.maps.surface_points import SurfacePoints, points_by_area
from abfm.mesh.shapes import even_sphere
from abfm.registration import Texture, textures, transfer_texture
from tests.core.surfaces import last_order, renumbered
from tests.messages import raises
from tests.shapes import icosphere, open_cylinder, square, tetrahedron

TURN = Rotation.from_rotvec([0.3, -0.8, 0.5])


def waves(width, height, count=3):
    """Return a smooth periodic image with four channels and values from 25 to 230."""
    x, y = (np.arange(width) + 0.5) / width, (np.arange(height)[:, None] + 0.5) / height
    x, y = 2 * np.pi * count * x, 2 * np.pi * count * y
    levels = [np.sin(x + k) * np.cos(y - k * k) for k in range(4)]
    return np.round(127.5 + 102 * np.stack(levels, axis=2)).astype(np.uint8)


def unwrapped(u, v):
    """Return texture coordinates (F, 3, 2) for angles u in turns, continuous across the seam."""
    ahead = np.where((np.ptp(u, axis=1) > 0.5)[:, None] & (u < 0.5), u + 1, u)
    return np.stack([ahead, v], axis=2)


def by_longitude(mesh):
    """Return coordinates by longitude and latitude, with a seam at longitude 0 and two poles."""
    x, y, z = np.moveaxis(mesh.vertices[mesh.faces], 2, 0)
    u = np.arctan2(y, x) / (2 * np.pi) % 1
    return unwrapped(u, 0.5 + np.arcsin(z / np.linalg.norm([x, y, z], axis=0)) / np.pi)


@pytest.mark.parametrize("mesh", [tetrahedron(), icosphere(1), square(3)])
def test_identity_converges_with_texture_size(mesh):
    x, y, z = mesh.vertices.T / mesh.length_scale
    places = 2 * np.stack([x, y + z / 2], axis=1)[mesh.faces]
    texture = Texture(mesh, places, [waves(1024, 1024, 8)])
    same, points = Correspondence.of_same_faces(mesh, mesh), points_by_area(mesh, 4000)
    expected, errors = texture.at(points), []
    for size in (64, 128, 256, 1024):
        found = transfer_texture(same, texture, size)
        assert found.images[0].shape == (size, size, 4)
        errors.append(np.abs(found.at(points) - expected))
    assert last_order([each.mean() for each in errors[:3]]) > 1.8
    assert errors[-1].max() < 2  # grey levels of 255
    assert errors[-1].mean() < 0.3  # grey levels, by rounding


def test_texture_is_transferred_to_a_rotated_sphere():
    a = icosphere(2)
    other, _, _ = renumbered(a, 3)
    b = TriangleMesh(TURN.apply(other.vertices.copy()), other.faces)
    found = Correspondence.through_sphere(a, b, a.vertices, TURN.inv().apply(b.vertices.copy()))
    texture = Texture(a, by_longitude(a), [waves(256, 128)])
    transferred = transfer_texture(found, texture, 512)
    points = points_by_area(b, 3000)
    images = project_onto_surface(a, TURN.inv().apply(points.positions))
    clear = np.abs(images.positions[:, 2]) < 0.8  # the texture is discontinuous at the poles
    errors = np.abs(transferred.at(points) - texture.at(images))[clear]
    assert errors.max() < 8
    assert errors.mean() < 0.5


def test_round_trip_converges():
    a, b = icosphere(2), even_sphere(500)
    found = Correspondence.through_sphere(a, b, a.vertices, TURN.apply(b.vertices.copy()))
    texture = Texture(a, by_longitude(a), [waves(256, 128)])
    points = points_by_area(a, 3000)
    errors = []
    for size in (128, 256, 512):
        there = transfer_texture(found, texture, size)
        back = transfer_texture(found.inverse(), there, size)
        errors.append(np.abs(back.at(points) - texture.at(points)).mean())
    assert errors[-1] < 1
    assert errors[0] > 4 * errors[-1]


def test_seams_leave_no_trace():
    """No face at the seam of a half black, half white cylinder has texels of the other half."""
    a, b = open_cylinder(12, 2), open_cylinder(30, 5)
    angles = np.arctan2(a.vertices[:, 1], a.vertices[:, 0]) / (2 * np.pi) % 1
    seam = unwrapped(angles[a.faces], a.vertices[a.faces][..., 2] / 2)
    assert (np.ptp(angles[a.faces], axis=1) > 0.5).sum() == 4
    is_white = np.abs((np.arange(200) + 0.5) / 200 - 0.5) < 0.25
    image = np.broadcast_to(255 * is_white[:, None], (8, 200, 3)).astype(np.uint8)
    found = Correspondence(PointMap.project(b, a, b.vertices))
    transferred = transfer_texture(found, Texture(a, seam, [image]), 512)
    points = points_by_area(b, 5000)
    turns = np.arctan2(points.positions[:, 1], points.positions[:, 0]) / (2 * np.pi) % 1
    clear = np.abs(np.abs(turns - 0.5) - 0.25) > 0.02
    expected = np.where(np.abs(turns - 0.5) < 0.25, 255.0, 0.0)[clear, None]
    assert clear.mean() > 0.9
    assert_allclose(transferred.at(points[clear]), np.broadcast_to(expected, (clear.sum(), 3)))


@given(
    places=st.lists(st.tuples(*[st.floats(-3, 3)] * 2), min_size=1, max_size=20),
    width=st.integers(1, 7),
    height=st.integers(1, 7),
    modes=st.sampled_from([("repeat", "grid-wrap"), ("clamp", "nearest"), ("mirror", "reflect")]),
)
@settings(max_examples=100)
def test_sampling_agrees_with_scipy(places, width, height, modes):
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    image = np.random.default_rng(width + 10 * height).integers(0, 256, (height, width, 3))
    ours, theirs = modes
    for u, v in places:
        corners, images = np.full((1, 3, 2), [u, v]), [image.astype(np.uint8)]
        texture = Texture(mesh, corners, images, wraps=[(ours, ours)])
        found = texture.at(SurfacePoints(mesh, np.zeros(1, int), np.array([[0.2, 0.3, 0.5]])))
        at = [[(1 - v) * height - 0.5], [u * width - 0.5]]
        expected = [
            ndimage.map_coordinates(image[..., k].astype(float), at, order=1, mode=theirs)
            for k in range(3)
        ]
        assert_allclose(found, np.transpose(expected), atol=1e-6)


def test_faces_have_their_own_images_and_tints():
    mesh = tetrahedron()
    images = [np.full((2, 3, 4), level, dtype=np.uint8) for level in (40, 80, 160)]
    tints = np.ones((4, 3, 4))
    tints[3, :, 0], tints[3, :, 3] = [0, 0.5, 1], 0.25
    owners = np.array([2, 0, 1, 2])
    texture = Texture(mesh, np.zeros((4, 3, 2)), images, owners, tints=tints)
    points = SurfacePoints(mesh, np.arange(4), np.full((4, 3), 1 / 3))
    levels = np.repeat([[160.0], [40.0], [80.0], [160.0]], 4, axis=1)
    levels[3] *= [0.5, 1, 1, 0.25]
    assert_allclose(texture.at(points), levels)
    transferred = transfer_texture(Correspondence.of_same_faces(mesh, mesh), texture, 256)
    assert_allclose(transferred.at(points), levels, atol=0.6)
    assert len(transferred.images) == 1


def test_colors_stay_in_the_range_of_the_image():
    """Texels without a face do not darken colours that are filtered."""
    mesh = icosphere(1)
    image = np.random.default_rng(0).integers(100, 140, (9, 11, 3)).astype(np.uint8)
    texture = Texture(mesh, by_longitude(mesh), [image])
    [found] = transfer_texture(Correspondence.of_same_faces(mesh, mesh), texture, 100).images
    assert found.min() >= 100
    assert found.max() < 140


@pytest.mark.parametrize(("limit", "size"), [(80, 64), (79, 128)])
def test_large_meshes_have_larger_images(monkeypatch, limit, size):
    monkeypatch.setattr(textures, "_SIZE_DEFAULT", 64)
    monkeypatch.setattr(textures, "_DEFAULT_SIZE_FACES_MAX", limit)
    mesh = icosphere(1)
    texture = Texture(mesh, by_longitude(mesh), [waves(8, 8)])
    found = transfer_texture(Correspondence.of_same_faces(mesh, mesh), texture)
    assert found.images[0].shape == (size, size, 4)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"images": []}, ("images",)),
        ({"images": [np.zeros((2, 2, 3))]}, ("float64",)),
        ({"images": [np.zeros((2, 2), np.uint8)]}, ("(2, 2)", "uint8")),
        ({"images": [np.zeros((0, 2, 3), np.uint8)]}, ("(0, 2, 3)",)),
        ({"images": [np.zeros((2, 2, k), np.uint8) for k in (3, 4)]}, ()),
        ({"owners": np.array([0, 1, 0, 0])}, (0,)),
        ({"owners": np.zeros(3, int)}, ("owners", "(3,)")),
        ({"wraps": [("repeat", "never")]}, ("repeat",)),
        ({"coordinates": np.zeros((3, 3, 2))}, ("(4, 3, 2)",)),
        ({"coordinates": np.full((4, 3, 2), np.nan)}, ("-1e+06", "1e+06")),
        ({"coordinates": np.full((4, 3, 2), 1e300)}, ("-1e+06", "1e+06")),
        ({"tints": np.full((4, 3, 3), 1.5)}, (0, 1)),
    ],
)
def test_invalid_textures_are_refused(change, named):
    given = {"coordinates": np.zeros((4, 3, 2)), "images": [np.zeros((2, 2, 3), np.uint8)]}
    with raises(ParameterError, *named):
        Texture(tetrahedron(), **(given | change))


def test_other_surfaces_and_small_images_are_refused():
    mesh = icosphere(1)
    texture = Texture(mesh, by_longitude(mesh), [waves(8, 8)])
    other = Correspondence.of_same_faces(tetrahedron(), tetrahedron())
    with raises(AbfmError, 80, 4):
        transfer_texture(other, texture)
    with raises(ParameterError, 80, 28):
        transfer_texture(Correspondence.of_same_faces(mesh, mesh), texture, 27)
