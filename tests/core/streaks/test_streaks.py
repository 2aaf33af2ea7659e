"""Texture atlases, in which filtering reads only texels of one face, and streaks along the flow."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import gaussian_filter

from abfm.calculus.operators import face_areas, face_normals
from abfm.errors import FunctionError, ParameterError
from abfm.flow.flow_lines import flow_lines
from abfm.maps.surface_points import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.mesh.shapes import sphere
from abfm.streaks.line_integral import line_integral_convolution
from abfm.streaks.texture_atlas import texture_atlas
from tests.core.fields import rotation_field, tangent, wavy_field
from tests.core.streaks.texel_weights import filtered, texel_weights
from tests.core.verification import near
from tests.messages import raises
from tests.shapes import disc, ellipsoid, hemisphere, open_cylinder, square, tetrahedron, torus

SLIVERS = TriangleMesh(torus(9, 7).vertices * [1, 1e-5, 0.3], torus(9, 7).faces)
MESHES = {
    "tetrahedron": (tetrahedron(), 64),
    "one triangle": (TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), 16),
    "uneven": (ellipsoid(3, 5, 1, 0.1), 512),
    "slivers": (SLIVERS, 256),
    "no spare texels": (sphere(2), 52),
    "boundary": (disc(7), 300),
}
cases = pytest.mark.parametrize(("mesh", "size"), MESHES.values(), ids=MESHES.keys())


def random_places(atlas, count):
    """Return faces, barycentric weights and places in texels, some on edges and corners."""
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
def test_filtering_reproduces_linear_functions(mesh, size):
    atlas = texture_atlas(mesh, size)
    h = np.random.default_rng(1).normal(size=len(mesh.vertices))
    faces, barycentric, places = random_places(atlas, 30)
    expected = (barycentric * h[mesh.faces[faces]]).sum(axis=1)
    y, x = np.indices(atlas.texel_faces.shape) + 0.5
    a, b, c = np.moveaxis(atlas.affine(h)[atlas.texel_faces], 2, 0)
    near(filtered(a + b * x + c * y, places), expected, 1e-4)


@cases
def test_texels_map_back_to_their_places(mesh, size):
    atlas = texture_atlas(mesh, size)
    rows, columns = np.nonzero(atlas.texel_faces >= 0)
    barycentric = texel_weights(atlas, rows, columns)
    places = np.einsum("nc,ncx->nx", barycentric, atlas.corners[atlas.texel_faces[rows, columns]])
    near(places, np.stack([columns, rows], axis=1) + 0.5, 1e-9)
    inside = (barycentric >= -1e-9).all(axis=1)
    shown = atlas.points(rows, columns)
    assert_array_equal(shown.faces, atlas.texel_faces[rows, columns])
    near(shown.barycentric[inside], barycentric[inside], 1e-9)
    assert (shown.barycentric[~inside].min(axis=1) == 0).all()
    served = np.unique(atlas.texel_faces[rows, columns][inside])
    assert_array_equal(served, np.arange(len(mesh.faces)))
    coordinates = atlas.corner_coordinates
    assert coordinates.shape == (3 * len(mesh.faces), 2)
    assert coordinates.min() >= 0
    assert coordinates.max() <= 1


def test_texels_are_proportional_to_area():
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


def test_atlas_is_independent_of_units_and_cached():
    mesh = torus(12, 9)
    scaled = TriangleMesh(1e-3 * mesh.vertices, mesh.faces)
    one, other = texture_atlas(mesh, 256), texture_atlas(scaled, 256)
    assert_allclose(other.texel_length, 1e-3 * one.texel_length, rtol=1e-3)
    near(other.corners, one.corners, 3)
    mesh = sphere(1)
    assert texture_atlas(mesh, 128) is texture_atlas(mesh, 128)
    assert texture_atlas(mesh, 128) is not texture_atlas(mesh, 129)


def test_half_a_million_faces_have_their_own_texels():
    mesh = square(500)
    atlas = texture_atlas(mesh, 2000)
    assert len(np.unique(atlas.texel_faces)) == 500_000


def test_too_small_textures_are_refused():
    mesh = sphere(2)
    with raises(ParameterError, 320, 52):
        texture_atlas(mesh, 51)
    assert len(np.unique(texture_atlas(mesh, 52).texel_faces)) >= 320
    with raises(FunctionError, 11):
        texture_atlas(sphere(0), 64).affine(np.zeros(11))


@pytest.mark.parametrize("size", [0, -5, 3, 2.5, 100_000])
def test_sizes_out_of_range_are_refused(size):
    with raises(ParameterError, 4, 16384):
        texture_atlas(tetrahedron(), size)


def looked_up(atlas, image, points):
    found = project_onto_surface(atlas.mesh, points)
    corners = atlas.corners[found.faces]
    return filtered(image, np.einsum("pc,pcx->px", found.barycentric, corners))


def correlation(atlas, image, start, end):
    return float(np.corrcoef(looked_up(atlas, image, start), looked_up(atlas, image, end))[0, 1])


def rotated(points, axis, distance):
    """Return points (P, 3) moved by a distance along their circles about an axis."""
    sideways = np.cross(axis, points)
    angle = distance / np.linalg.norm(sideways, axis=1, keepdims=True)
    return points + np.sin(angle) * sideways + (1 - np.cos(angle)) * np.cross(axis, sideways)


def on_sphere(count, seed=3):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def used(atlas, image):
    """Return the grey levels of the texels of triangles, and their faces."""
    chosen = atlas.texel_faces >= 0
    return image[chosen], atlas.texel_faces[chosen]


@pytest.mark.parametrize("level", [2, 3, 4, 5])
def test_streaks_lie_along_the_flow_on_any_mesh(level):
    mesh, axis = sphere(level), np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])
    atlas, image = line_integral_convolution(mesh, rotation_field(mesh, axis), size=1024)
    points = on_sphere(4000)
    points = points[np.linalg.norm(np.cross(axis, points), axis=1) > 0.3]
    width, grain = mesh.length_scale / 400, 1.5 * atlas.texel_length
    of_texels, of_widths = (
        ((3 * grain, 0.85), (6 * grain, 0.6)),
        ((4 * width, 0.8), (8 * width, 0.5)),
    )
    for distance, minimum in (*of_texels, *of_widths):
        assert correlation(atlas, image, points, rotated(points, axis, distance)) > minimum
    across = np.cross(points, np.cross(axis, points))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    assert abs(correlation(atlas, image, points, points + 4 * width * across)) < 0.15


def test_streaks_lie_along_exact_flow_lines():
    mesh = sphere(5)
    field = wavy_field(mesh, 2)
    atlas, image = line_integral_convolution(mesh, field, size=1024)
    start, distance = project_onto_surface(mesh, on_sphere(1500)), 4 * mesh.length_scale / 400
    unit, found = field / np.linalg.norm(field, axis=1, keepdims=True), []
    for directions in (unit, np.cross(face_normals(mesh), unit)):
        lines = flow_lines(mesh, directions, start, distance)
        complete = [line.ending == "time" for line in lines]
        ends = np.array([line.positions[-1] for line in lines])
        found.append(correlation(atlas, image, start.positions[complete], ends[complete]))
    assert found[0] > 0.75
    assert abs(found[1]) < 0.15


def test_streaks_of_smooth_fields_do_not_show_the_mesh():
    """Directions of streaks, by their structure tensor, vary smoothly inside faces."""
    mesh, centre, count = square(9), np.array([0.53, 0.46, 0.0]), 300
    field = np.cross([0, 0, 1], mesh.vertices[mesh.faces].mean(axis=1) - centre)
    atlas, image = line_integral_convolution(mesh, field, size=1024, width=1 / 150, length=0.2)
    x, y = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count)
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    picture = looked_up(atlas, image, points).reshape(count, count)
    gy, gx = np.gradient(gaussian_filter(picture, 1))
    xx, xy, yy = (gaussian_filter(product, 6) for product in (gx * gx, gx * gy, gy * gy))
    streaks = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2
    radius = np.hypot(x - centre[0], y - centre[1])
    faces = field[project_onto_surface(mesh, points).faces].reshape(count, count, 3)

    def error(angles):
        off = np.sin(angles - np.arctan2(x - centre[0], centre[1] - y))
        return float(np.sqrt((off[(radius > 0.15) & (radius < 0.4)] ** 2).mean()))

    assert error(streaks) < 0.06
    assert error(streaks) < 0.6 * error(np.arctan2(faces[..., 1], faces[..., 0]))


def test_width_of_streaks_is_independent_of_texels():
    mesh, found = square(10), {}
    field = np.tile([1.0, 0.3, 0.0], (len(mesh.faces), 1))
    side = np.cross([0, 0, 1], field[0]) / np.linalg.norm(field[0])
    points = np.random.default_rng(1).uniform([0.1, 0.1, 0], [0.9, 0.9, 0], (4000, 3))
    for size in (512, 1024):
        for width in (1 / 120, 1 / 60):
            seen = line_integral_convolution(mesh, field, size=size, width=width)
            ends = [points + side * width * away for away in (0, 0.25, 0.5, 0.75, 1, 1.25)]
            found[size, width] = np.corrcoef([looked_up(*seen, end) for end in ends])[0]
    for curve in found.values():
        near(curve, found[1024, 1 / 60], 0.12)
        assert curve[2] > 0.4
        assert curve[-1] < 0.25


def test_streaks_continue_across_edges():
    mesh = sphere(3)
    field, middles = rotation_field(mesh, [0, 0, 1]), []
    atlas, image = line_integral_convolution(mesh, field, size=1024, width=1 / 200)
    for face in mesh.edge_faces.T:
        corner = np.argmax(mesh.face_edges[face] == np.arange(len(mesh.edges))[:, None], axis=1)
        weights = (1 - np.eye(3)[corner]) / 2
        middles.append(filtered(image, np.einsum("ec,ecx->ex", weights, atlas.corners[face])))
    assert np.corrcoef(middles)[0, 1] > 0.9
    assert np.median(np.abs(middles[0] - middles[1])) < 0.05


def test_contrast_is_full_and_even():
    mesh = sphere(4)
    atlas, image = line_integral_convolution(mesh, rotation_field(mesh, [0, 0, 1]), size=1024)
    values, faces = used(atlas, image)
    height = np.abs(mesh.vertices[mesh.faces].mean(axis=1)[faces, 2])
    assert image.dtype == np.float32
    assert (image.min(), image.max()) == (0, 1)
    near(np.percentile(values, [2, 50, 98]), [0, 0.5, 1], 0.03)
    # 0.33 for a normal distribution
    assert np.percentile(values, 75) - np.percentile(values, 25) > 0.45
    for low, high in pairwise((0, 0.3, 0.6, 0.9, 1)):
        near(values[(height >= low) & (height < high)].std(), 0.3, 0.05)


@pytest.mark.parametrize(
    "mesh", [tetrahedron(), hemisphere(6), torus(20, 14), square(12), disc(5), open_cylinder(9, 4)]
)
def test_any_field_gives_an_image(mesh):
    field = tangent(mesh, np.random.default_rng(5).normal(size=(len(mesh.faces), 3)))
    field[::7] = 0
    _, image = line_integral_convolution(mesh, field, size=256)
    assert np.isfinite(image).all()
    assert image.std() > 0.1


def test_contrast_is_even_up_to_a_boundary():
    mesh = square(20)
    field = np.tile([1.0, 0.3, 0.0], (len(mesh.faces), 1))
    values, faces = used(*line_integral_convolution(mesh, field, size=512))
    x = mesh.vertices[mesh.faces].mean(axis=1)[faces, 0]
    assert_allclose(values[x < 0.05].std(), values[np.abs(x - 0.5) < 0.2].std(), rtol=0.15)


def test_zero_field_is_grey():
    mesh = sphere(2)
    _, image = line_integral_convolution(mesh, np.zeros((len(mesh.faces), 3)), size=128, fade=True)
    assert_array_equal(image, 0.5)
    half = rotation_field(mesh, [0, 0, 1])
    still = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 0.5
    half[still] = 0
    atlas, image = line_integral_convolution(mesh, half, size=256)
    values, faces = used(atlas, image)
    weights = texel_weights(atlas, *np.nonzero(atlas.texel_faces >= 0))
    assert_array_equal(values[(weights > 0.02).all(axis=1) & still[faces]], 0.5)


def test_contrast_fades_with_speed():
    mesh = sphere(4)
    field = rotation_field(mesh, [0, 0, 1])
    atlas, image = line_integral_convolution(mesh, field, size=1024, fade=True)
    values, faces = used(atlas, image)
    speeds = np.linalg.norm(field, axis=1)[faces]
    slow, fast = (values[(speeds > low) & (speeds < low + 0.1)].std() for low in (0.2, 0.9))
    assert_allclose(slow / fast, 0.25 / 0.95, rtol=0.2)
    angles = np.linspace(0, 2 * np.pi, 500)
    for radius in (0.02, 0.05, 0.1, 0.2):
        x, y = radius * np.cos(angles), radius * np.sin(angles)
        circle = np.stack([x, y, 0 * angles + np.sqrt(1 - radius**2)], axis=1)
        largest = np.abs(looked_up(atlas, image, circle) - 0.5).max()
        assert 0.2 * radius < largest < 0.6 * radius


def test_only_the_direction_of_the_field_matters():
    mesh = torus(16, 10)
    field = wavy_field(mesh, 2)
    fields = [x * field for x in (1, 1e-200, 1e200)]
    image, *scaled = (line_integral_convolution(mesh, each, size=256)[1] for each in fields)
    for each in scaled:
        near(each, image, 0.01)


BALL = sphere(3)
SPIN = rotation_field(BALL, [0, 0, 1])


def test_streaks_of_later_phases_move_along_the_flow():
    """The image of a later phase correlates best with the first image further downstream."""
    atlas, images = line_integral_convolution(BALL, SPIN, size=512, length=0.15, phase=[0.0, 0.25])
    points = on_sphere(4000, 0)
    points = points[np.linalg.norm(points[:, :2], axis=1) > 0.5]
    before, axis = looked_up(atlas, images[0], points), np.array([0.0, 0, 1])
    distances = np.linspace(-0.15, 0.15, 31) * 0.15 * BALL.length_scale
    moved = [looked_up(atlas, images[1], rotated(points, axis, distance)) for distance in distances]
    best = int(np.argmax([np.corrcoef(before, after)[0, 1] for after in moved]))
    assert distances[best] > 0.02 * 0.15 * BALL.length_scale


def test_phases_are_periodic_with_even_contrast():
    atlas, images = line_integral_convolution(BALL, SPIN, size=256, phase=np.linspace(0, 1, 9))
    assert images.shape == (9, 256, 256)
    near(images[-1], images[0], 1e-5)
    seen = [used(atlas, image)[0] for image in images]
    steps = [np.abs(after - before).mean() for before, after in pairwise(seen)]
    assert max(steps) < 1.3 * min(steps)
    assert_allclose([values.std() for values in seen], seen[0].std(), rtol=0.1)
    _, images = line_integral_convolution(BALL, SPIN, size=128, phase=[0.0, 0.3])
    _, separate = line_integral_convolution(BALL, SPIN, size=128, phase=0.0)
    assert_array_equal(images[0], separate)


@pytest.mark.parametrize(
    ("named", "field", "options"),
    [
        ("(12, 3)", np.ones((12, 3)), {}),
        ("", np.nan * SPIN, {}),
        *(("length", SPIN, {"length": length}) for length in (0, -1, 2, np.nan)),
        ("width", SPIN, {"width": 0}),
        ("phase", SPIN, {"phase": np.nan}),
        ("seed", SPIN, {"seed": 0.5}),
        ("size", SPIN, {"size": 0}),
    ],
)
def test_invalid_input_is_refused(named, field, options):
    with raises(ParameterError, named):
        line_integral_convolution(BALL, field, **options)
