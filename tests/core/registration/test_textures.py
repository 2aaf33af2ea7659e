"""Textures go along correspondences: by known images, maps and seams."""

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
    """A smooth image of four channels, from 25 to 230, which repeats smoothly."""
    x, y = (np.arange(width) + 0.5) / width, (np.arange(height)[:, None] + 0.5) / height
    x, y = 2 * np.pi * count * x, 2 * np.pi * count * y
    levels = [np.sin(x + k) * np.cos(y - k * k) for k in range(4)]
    return np.round(127.5 + 102 * np.stack(levels, axis=2)).astype(np.uint8)


def unwrapped(u, v):
    """Texture coordinates (F, 3, 2) of corners at angles u in turns, whole where a seam is met."""
    ahead = np.where((np.ptp(u, axis=1) > 0.5)[:, None] & (u < 0.5), u + 1, u)
    return np.stack([ahead, v], axis=2)


def by_longitude(mesh):
    """Longitude and latitude: a seam at the longitude 0, and poles where corners have none."""
    x, y, z = np.moveaxis(mesh.vertices[mesh.faces], 2, 0)
    u = np.arctan2(y, x) / (2 * np.pi) % 1
    return unwrapped(u, 0.5 + np.arcsin(z / np.linalg.norm([x, y, z], axis=0)) / np.pi)


@pytest.mark.parametrize("mesh", [tetrahedron(), icosphere(1), square(3)])
def test_the_same_surface_shows_the_same_and_errors_fall_with_the_square_of_texels(mesh):
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
    assert errors[-1].max() < 2  # of 255
    assert errors[-1].mean() < 0.3  # rounding


def test_a_turned_and_renumbered_sphere_shows_what_is_in_the_same_direction():
    a = icosphere(2)
    other, _, _ = renumbered(a, 3)
    b = TriangleMesh(TURN.apply(other.vertices.copy()), other.faces)
    found = Correspondence.through_sphere(a, b, a.vertices, TURN.inv().apply(b.vertices.copy()))
    texture = Texture(a, by_longitude(a), [waves(256, 128)])
    carried = transfer_texture(found, texture, 512)
    points = points_by_area(b, 3000)
    there = project_onto_surface(a, TURN.inv().apply(points.positions))
    clear = np.abs(there.positions[:, 2]) < 0.8  # of the poles, around which the texture is torn
    errors = np.abs(carried.at(points) - texture.at(there))[clear]
    assert errors.max() < 8
    assert errors.mean() < 0.5


def test_there_and_back_is_nearly_what_it_was():
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


def test_no_colours_are_smeared_along_a_seam():
    """Half of a cylinder is black, half white; a face over the seam, if its coordinates went all
    the way back, would show the other half.
    """
    a, b = open_cylinder(12, 2), open_cylinder(30, 5)
    angles = np.arctan2(a.vertices[:, 1], a.vertices[:, 0]) / (2 * np.pi) % 1
    seam = unwrapped(angles[a.faces], a.vertices[a.faces][..., 2] / 2)
    assert (np.ptp(angles[a.faces], axis=1) > 0.5).sum() == 4  # faces over it
    is_white = np.abs((np.arange(200) + 0.5) / 200 - 0.5) < 0.25
    image = np.broadcast_to(255 * is_white[:, None], (8, 200, 3)).astype(np.uint8)
    found = Correspondence(PointMap.project(b, a, b.vertices))
    carried = transfer_texture(found, Texture(a, seam, [image]), 512)
    points = points_by_area(b, 5000)
    turns = np.arctan2(points.positions[:, 1], points.positions[:, 0]) / (2 * np.pi) % 1
    clear = np.abs(np.abs(turns - 0.5) - 0.25) > 0.02
    expected = np.where(np.abs(turns - 0.5) < 0.25, 255.0, 0.0)[clear, None]
    assert clear.mean() > 0.9
    assert_allclose(carried.at(points[clear]), np.broadcast_to(expected, (clear.sum(), 3)))


@given(
    places=st.lists(st.tuples(*[st.floats(-3, 3)] * 2), min_size=1, max_size=20),
    width=st.integers(1, 7),
    height=st.integers(1, 7),
    way=st.sampled_from([("repeat", "grid-wrap"), ("clamp", "nearest"), ("mirror", "reflect")]),
)
@settings(max_examples=100, deadline=None)
def test_images_are_sampled_as_by_scipy(places, width, height, way):
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    image = np.random.default_rng(width + 10 * height).integers(0, 256, (height, width, 3))
    ours, theirs = way
    for u, v in places:
        texture = Texture(
            mesh, np.full((1, 3, 2), [u, v]), [image.astype(np.uint8)], wraps=[(ours, ours)]
        )
        found = texture.at(SurfacePoints(mesh, np.zeros(1, int), np.array([[0.2, 0.3, 0.5]])))
        at = [[(1 - v) * height - 0.5], [u * width - 0.5]]
        expected = [
            ndimage.map_coordinates(image[..., k].astype(float), at, order=1, mode=theirs)
            for k in range(3)
        ]
        assert_allclose(found, np.transpose(expected), atol=1e-6)


def test_each_face_has_its_image_and_corners_their_tints():
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
    carried = transfer_texture(Correspondence.of_same_faces(mesh, mesh), texture, 256)
    assert_allclose(carried.at(points), levels, atol=0.6)
    assert len(carried.images) == 1


def test_colours_stay_between_those_of_the_image():
    """Also those of texels that show no face: what is filtered with them is not darkened."""
    mesh = icosphere(1)
    image = np.random.default_rng(0).integers(100, 140, (9, 11, 3)).astype(np.uint8)
    texture = Texture(mesh, by_longitude(mesh), [image])
    [found] = transfer_texture(Correspondence.of_same_faces(mesh, mesh), texture, 100).images
    assert found.min() >= 100
    assert found.max() < 140


@pytest.mark.parametrize(("many", "size"), [(80, 64), (79, 128)])
def test_images_of_many_faces_are_larger(monkeypatch, many, size):
    monkeypatch.setattr(textures, "_SIZE_DEFAULT", 64)
    monkeypatch.setattr(textures, "_DEFAULT_SIZE_FACES_MAX", many)
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
def test_what_is_no_texture_is_refused(change, named):
    given = {"coordinates": np.zeros((4, 3, 2)), "images": [np.zeros((2, 2, 3), np.uint8)]}
    with raises(ParameterError, *named):
        Texture(tetrahedron(), **(given | change))


def test_textures_of_other_surfaces_and_images_too_small_are_refused():
    mesh = icosphere(1)
    texture = Texture(mesh, by_longitude(mesh), [waves(8, 8)])
    other = Correspondence.of_same_faces(tetrahedron(), tetrahedron())
    with raises(AbfmError, 80, 4):
        transfer_texture(other, texture)
    with raises(ParameterError, 80, 28):
        transfer_texture(Correspondence.of_same_faces(mesh, mesh), texture, 27)
