"""Texture atlases: every triangle has texels to itself, and linear filtering reads no others."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from abfm.calculus.operators import face_areas
from abfm.errors import FunctionError, ParameterError
from abfm.mesh import TriangleMesh
from abfm.streaks.texture_atlas import texture_atlas
from tests.core.texel_weights import filtered, texel_weights
from tests.core.verification import near
from tests.shapes import disc, ellipsoid, icosphere, square, tetrahedron, torus

NEEDLES = TriangleMesh(torus(9, 7).vertices * [1, 1e-5, 0.3], torus(9, 7).faces)
MESHES = {
    "tetrahedron": (tetrahedron(), 64),
    "one triangle": (TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), 16),
    "uneven": (ellipsoid(3, 5, 1, 0.1), 512),
    "needles": (NEEDLES, 256),
    "no room to spare": (icosphere(2), 52),
    "boundary": (disc(7), 300),
}
cases = pytest.mark.parametrize(("mesh", "size"), MESHES.values(), ids=MESHES.keys())


def random_places(atlas, count):
    """Faces, barycentric weights and places in texels; some of them on edges and corners."""
    rng = np.random.default_rng(0)
    faces = np.tile(np.arange(len(atlas.corners)), count)
    barycentric = rng.dirichlet([0.5, 0.5, 0.5], len(faces))
    barycentric[::3, 0] = 0
    barycentric[::7, 1] = 0
    barycentric[(barycentric == 0).all(axis=1)] = [0, 0, 1]
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    return faces, barycentric, np.einsum("nc,ncx->nx", barycentric, atlas.corners[faces])


@cases
def test_filtering_reads_only_texels_of_the_face(mesh, size):
    atlas = texture_atlas(mesh, size)
    faces, _, places = random_places(atlas, 30)
    for face in range(0, len(mesh.faces), max(len(mesh.faces) // 20, 1)):
        mine = faces == face
        near(filtered((atlas.texel_faces == face).astype(float), places[mine]), 1, 1e-6)


@cases
def test_filtering_a_linear_function_gives_it_back(mesh, size):
    atlas = texture_atlas(mesh, size)
    h = np.random.default_rng(1).normal(size=len(mesh.vertices))
    faces, barycentric, places = random_places(atlas, 30)
    expected = (barycentric * h[mesh.faces[faces]]).sum(axis=1)
    y, x = np.indices(atlas.texel_faces.shape) + 0.5
    a, b, c = np.moveaxis(atlas.affine(h)[atlas.texel_faces], 2, 0)
    near(filtered(a + b * x + c * y, places), expected, 1e-4)


@cases
def test_texels_map_back_to_their_place_and_corners_lie_in_the_texture(mesh, size):
    atlas = texture_atlas(mesh, size)
    rows, columns = np.nonzero(atlas.texel_faces >= 0)
    barycentric = texel_weights(atlas, rows, columns)
    places = np.einsum("nc,ncx->nx", barycentric, atlas.corners[atlas.texel_faces[rows, columns]])
    near(places, np.stack([columns, rows], axis=1) + 0.5, 1e-9)
    inside = (barycentric >= -1e-9).all(axis=1)
    served = np.unique(atlas.texel_faces[rows, columns][inside])
    assert_array_equal(served, np.arange(len(mesh.faces)))
    coordinates = atlas.corner_coordinates
    assert coordinates.shape == (3 * len(mesh.faces), 2)
    assert coordinates.min() >= 0
    assert coordinates.max() <= 1


def test_texels_are_shared_out_by_area():
    """Edges are about as long in texels as on the surface, never below three quarters of it."""
    mesh = ellipsoid(3, 3, 1, 1)
    atlas = texture_atlas(mesh, 1024)
    ends = np.roll(atlas.corners, 1, axis=1) - atlas.corners
    edges = np.roll(mesh.vertices[mesh.faces], 1, axis=1) - mesh.vertices[mesh.faces]
    ratio = np.linalg.norm(ends, axis=2) * atlas.texel_length / np.linalg.norm(edges, axis=2)
    assert ratio.min() > 0.75
    u, v = atlas.corners[:, 1] - atlas.corners[:, 0], atlas.corners[:, 2] - atlas.corners[:, 0]
    texels = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    share = texels * atlas.texel_length**2 / face_areas(mesh)
    assert share.min() >= 1
    assert share.max() < 2.5
    assert texels.sum() > 0.6 * 1024**2


def test_does_not_depend_on_the_unit():
    mesh = torus(12, 9)
    scaled = TriangleMesh(1e-3 * mesh.vertices, mesh.faces)
    one, other = texture_atlas(mesh, 256), texture_atlas(scaled, 256)
    assert_allclose(other.texel_length, 1e-3 * one.texel_length, rtol=1e-3)
    near(other.corners, one.corners, 3)


def test_is_made_once():
    mesh = icosphere(1)
    assert texture_atlas(mesh, 128) is texture_atlas(mesh, 128)
    assert texture_atlas(mesh, 128) is not texture_atlas(mesh, 129)


def test_half_a_million_faces():
    mesh = square(500)
    atlas = texture_atlas(mesh, 2000)
    assert len(np.unique(atlas.texel_faces)) == 500_000


def test_too_small_a_texture_is_refused_with_the_least_size():
    mesh = icosphere(2)
    with pytest.raises(ParameterError, match="320 faces: take 52 or more"):
        texture_atlas(mesh, 51)
    assert len(np.unique(texture_atlas(mesh, 52).texel_faces)) >= 320


@pytest.mark.parametrize("size", [0, -5, 3, 2.5, 100_000])
def test_sizes_out_of_range_are_refused(size):
    with pytest.raises(ParameterError, match="expected a whole number of texels from 4 to 16384"):
        texture_atlas(tetrahedron(), size)


def test_functions_of_other_meshes_are_refused():
    with pytest.raises(FunctionError, match="11 values"):
        texture_atlas(icosphere(0), 64).affine(np.zeros(11))
