"""Line integral convolution: grey levels stay along the flow and change across it."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import gaussian_filter

from abfm.calculus.operators import face_normals
from abfm.errors import ParameterError
from abfm.flow.flow_lines import flow_lines
from abfm.maps.surface_points import project_onto_surface
from abfm.streaks.line_integral import line_integral_convolution
from tests.core.fields import rotation_field, tangent, wavy_field
from tests.core.texel_weights import texel_weights
from tests.shapes import disc, hemisphere, icosphere, open_cylinder, square, tetrahedron, torus


def looked_up(atlas, image, points):
    """Bilinear filtering of a texture at points (P, 3) of the surface."""
    found = project_onto_surface(atlas.mesh, points)
    places = np.einsum("pc,pcx->px", found.barycentric, atlas.corners[found.faces]) - 0.5
    low = np.minimum(np.floor(places).astype(int), atlas.size - 2)
    (x, y), (u, v) = low.T, (places - low).T
    rows = [(1 - u) * image[y + d, x] + u * image[y + d, x + 1] for d in (0, 1)]
    return (1 - v) * rows[0] + v * rows[1]


def correlation(atlas, image, start, end):
    """Of the grey levels at pairs of points."""
    return float(np.corrcoef(looked_up(atlas, image, start), looked_up(atlas, image, end))[0, 1])


def turned(points, axis, distance):
    """Points (P, 3) moved by a distance along their circles about an axis."""
    sideways = np.cross(axis, points)
    radius = np.linalg.norm(sideways, axis=1, keepdims=True)
    inwards = np.cross(axis, sideways)
    angle = distance / radius
    return points + np.sin(angle) * sideways + (1 - np.cos(angle)) * inwards


@pytest.mark.parametrize("level", [2, 3, 4, 5])
def test_streaks_lie_along_the_flow_on_any_mesh(level):
    """On finer and coarser spheres, against the circles of a rotation and across them."""
    mesh = icosphere(level)
    axis = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])
    atlas, image = line_integral_convolution(mesh, rotation_field(mesh, axis), size=1024)
    points = np.random.default_rng(3).normal(size=(4000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = points[np.linalg.norm(np.cross(axis, points), axis=1) > 0.3]
    width = mesh.length_scale / 400
    across = np.cross(points, np.cross(axis, points))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    grain = 1.5 * atlas.texel_length
    assert correlation(atlas, image, points, turned(points, axis, 3 * grain)) > 0.85
    assert correlation(atlas, image, points, turned(points, axis, 6 * grain)) > 0.6
    assert correlation(atlas, image, points, turned(points, axis, 4 * width)) > 0.8
    assert correlation(atlas, image, points, turned(points, axis, 8 * width)) > 0.5
    assert abs(correlation(atlas, image, points, points + 4 * width * across)) < 0.15


def test_streaks_lie_along_exact_flow_lines():
    mesh = icosphere(5)
    field = wavy_field(mesh, 2)
    atlas, image = line_integral_convolution(mesh, field, size=1024)
    points = np.random.default_rng(3).normal(size=(1500, 3))
    start = project_onto_surface(mesh, points / np.linalg.norm(points, axis=1, keepdims=True))
    distance = 4 * mesh.length_scale / 400
    unit = field / np.linalg.norm(field, axis=1, keepdims=True)
    found = []
    for directions in (unit, np.cross(face_normals(mesh), unit)):
        lines = flow_lines(mesh, directions, start, distance)
        whole = [line.ended == "time" for line in lines]
        ends = np.array([line.positions[-1] for line in lines])
        found.append(correlation(atlas, image, start.positions[whole], ends[whole]))
    assert found[0] > 0.75
    assert abs(found[1]) < 0.15


def test_lines_of_a_smooth_field_do_not_show_the_mesh():
    """On a coarse flat mesh streaks of a rotation turn with it inside each face, where the face's
    own vector does not.

    Their direction is that of the structure tensor.
    """
    mesh = square(9)
    centre = np.array([0.53, 0.46, 0.0])
    field = np.cross([0, 0, 1], mesh.vertices[mesh.faces].mean(axis=1) - centre)
    atlas, image = line_integral_convolution(mesh, field, size=1024, width=1 / 150, length=0.2)
    count = 300
    x, y = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count)
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    picture = looked_up(atlas, image, points).reshape(count, count)
    gy, gx = np.gradient(gaussian_filter(picture, 1))
    xx, xy, yy = (gaussian_filter(product, 6) for product in (gx * gx, gx * gy, gy * gy))
    streaks = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2
    radius = np.hypot(x - centre[0], y - centre[1])
    chosen = (radius > 0.15) & (radius < 0.4)
    faces = field[project_onto_surface(mesh, points).faces].reshape(count, count, 3)

    def error(angles):
        circles = np.arctan2(x - centre[0], centre[1] - y)
        return float(np.sqrt((np.sin(angles - circles)[chosen] ** 2).mean()))

    assert error(streaks) < 0.06
    assert error(streaks) < 0.6 * error(np.arctan2(faces[..., 1], faces[..., 0]))


def test_streaks_are_as_wide_on_any_texture():
    """How far grey levels across the flow are alike depends on the width, not on texels."""
    mesh = square(10)
    field = np.tile([1.0, 0.3, 0.0], (len(mesh.faces), 1))
    side = np.cross([0, 0, 1], field[0]) / np.linalg.norm(field[0])
    points = np.random.default_rng(1).uniform([0.1, 0.1, 0], [0.9, 0.9, 0], (4000, 3))
    found = {}
    for size in (512, 1024):
        for width in (1 / 120, 1 / 60):
            atlas, image = line_integral_convolution(mesh, field, size=size, width=width)
            values = [
                looked_up(atlas, image, points + side * width * away)
                for away in (0, 0.25, 0.5, 0.75, 1, 1.25)
            ]
            found[size, width] = [np.corrcoef(values[0], value)[0, 1] for value in values]
    for curve in found.values():
        assert_allclose(curve, found[1024, 1 / 60], rtol=0, atol=0.12)
        assert curve[2] > 0.4
        assert curve[-1] < 0.25


def test_streaks_go_on_across_the_edges_of_faces():
    """What two faces show along their common edge is the same."""
    mesh = icosphere(3)
    atlas, image = line_integral_convolution(
        mesh, rotation_field(mesh, [0, 0, 1]), size=1024, width=1 / 200
    )
    middles = []
    for side in (0, 1):
        face = mesh.edge_faces[:, side]
        corner = np.argmax(mesh.face_edges[face] == np.arange(len(mesh.edges))[:, None], axis=1)
        weights = (1 - np.eye(3)[corner]) / 2
        places = np.einsum("ec,ecx->ex", weights, atlas.corners[face]) - 0.5
        low = np.floor(places).astype(int)
        (x, y), (u, v) = low.T, (places - low).T
        rows = [(1 - u) * image[y + d, x] + u * image[y + d, x + 1] for d in (0, 1)]
        middles.append((1 - v) * rows[0] + v * rows[1])
    assert np.corrcoef(middles)[0, 1] > 0.9
    assert np.median(np.abs(middles[0] - middles[1])) < 0.05


def test_contrast_is_full_and_even():
    mesh = icosphere(4)
    atlas, image = line_integral_convolution(mesh, rotation_field(mesh, [0, 0, 1]), size=1024)
    rows, columns = np.nonzero(atlas.texel_faces >= 0)
    centres = np.abs(mesh.vertices[mesh.faces].mean(axis=1)[atlas.texel_faces[rows, columns], 2])
    values = image[rows, columns]
    assert image.dtype == np.float32
    assert (image.min(), image.max()) == (0, 1)
    assert_allclose(np.percentile(values, [2, 50, 98]), [0, 0.5, 1], rtol=0, atol=0.03)
    # of a normal distribution: 0.33
    assert np.percentile(values, 75) - np.percentile(values, 25) > 0.45
    for low, high in ((0, 0.3), (0.3, 0.6), (0.6, 0.9), (0.9, 1)):
        assert_allclose(values[(centres >= low) & (centres < high)].std(), 0.3, rtol=0, atol=0.05)


@pytest.mark.parametrize(
    "mesh", [tetrahedron(), hemisphere(6), torus(20, 14), square(12), disc(5), open_cylinder(9, 4)]
)
def test_any_field_gives_a_picture(mesh):
    """With sinks, whirls and edges that two faces push into, down to single faces."""
    field = tangent(mesh, np.random.default_rng(5).normal(size=(len(mesh.faces), 3)))
    field[::7] = 0
    _, image = line_integral_convolution(mesh, field, size=256)
    assert np.isfinite(image).all()
    assert image.std() > 0.1


def test_streaks_run_evenly_up_to_a_boundary():
    mesh = square(20)
    field = np.tile([1.0, 0.3, 0.0], (len(mesh.faces), 1))
    atlas, image = line_integral_convolution(mesh, field, size=512)
    rows, columns = np.nonzero(atlas.texel_faces >= 0)
    x = mesh.vertices[mesh.faces].mean(axis=1)[atlas.texel_faces[rows, columns], 0]
    near, far = (image[rows, columns][chosen].std() for chosen in (x < 0.05, np.abs(x - 0.5) < 0.2))
    assert_allclose(near, far, rtol=0.15)


def test_no_field_is_plain_grey():
    mesh = icosphere(2)
    _, image = line_integral_convolution(mesh, np.zeros((len(mesh.faces), 3)), size=128, fade=True)
    assert_array_equal(image, 0.5)
    half = rotation_field(mesh, [0, 0, 1])
    still = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 0.5
    half[still] = 0
    atlas, image = line_integral_convolution(mesh, half, size=256)
    rows, columns = np.nonzero(atlas.texel_faces >= 0)
    inside = (texel_weights(atlas, rows, columns) > 0.02).all(axis=1) & still[
        atlas.texel_faces[rows, columns]
    ]
    assert_array_equal(image[rows[inside], columns[inside]], 0.5)


def test_contrast_fades_with_speed():
    mesh = icosphere(4)
    field = rotation_field(mesh, [0, 0, 1])
    atlas, image = line_integral_convolution(mesh, field, size=512, fade=True)
    rows, columns = np.nonzero(atlas.texel_faces >= 0)
    speeds = np.linalg.norm(field, axis=1)[atlas.texel_faces[rows, columns]]
    values = image[rows, columns]
    slow, fast = (values[(speeds > low) & (speeds < low + 0.1)].std() for low in (0.2, 0.9))
    assert_allclose(slow / fast, 0.25 / 0.95, rtol=0.2)


def test_only_the_direction_matters():
    mesh = torus(16, 10)
    field = wavy_field(mesh, 2)
    _, image = line_integral_convolution(mesh, field, size=256)
    for scale in (1e-200, 1e200):
        _, scaled = line_integral_convolution(mesh, scale * field, size=256)
        assert_allclose(scaled, image, rtol=0, atol=0.01)


def test_contrast_that_fades_ends_at_a_zero_of_the_field():
    """Around the pole of a rotation it grows in proportion to the distance."""
    mesh = icosphere(4)
    atlas, image = line_integral_convolution(
        mesh, rotation_field(mesh, [0, 0, 1]), size=1024, fade=True
    )
    for radius in (0.02, 0.05, 0.1, 0.2):
        angles = np.linspace(0, 2 * np.pi, 500)
        circle = np.stack(
            [radius * np.cos(angles), radius * np.sin(angles), 0 * angles + np.sqrt(1 - radius**2)],
            axis=1,
        )
        largest = np.abs(looked_up(atlas, image, circle) - 0.5).max()
        assert largest < 0.6 * radius
        assert largest > 0.2 * radius


class TestPhases:
    mesh = icosphere(3)
    field = rotation_field(mesh, [0, 0, 1])

    def test_streaks_move_along_the_flow(self):
        """The picture of a later phase correlates best with the one before further ahead."""
        atlas, images = line_integral_convolution(
            self.mesh, self.field, size=512, length=0.15, phase=[0.0, 0.25]
        )
        rng = np.random.default_rng(0)
        points = rng.normal(size=(4000, 3))
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        radius = np.linalg.norm(points[:, :2], axis=1)
        points, radius = points[radius > 0.5], radius[radius > 0.5]
        before = looked_up(atlas, images[0], points)
        shares = []
        distances = np.linspace(-0.15, 0.15, 31) * 0.15 * self.mesh.length_scale
        for distance in distances:
            angle = distance / radius
            c, s = np.cos(angle), np.sin(angle)
            x, y, z = points.T
            moved = np.stack([c * x - s * y, s * x + c * y, z], axis=1)
            shares.append(np.corrcoef(before, looked_up(atlas, images[1], moved))[0, 1])
        assert distances[int(np.argmax(shares))] > 0.02 * 0.15 * self.mesh.length_scale

    def test_are_periodic_and_of_even_contrast(self):
        atlas, images = line_integral_convolution(
            self.mesh, self.field, size=256, phase=np.linspace(0, 1, 9)
        )
        assert images.shape == (9, 256, 256)
        assert_allclose(images[-1], images[0], rtol=0, atol=1e-5)
        used = atlas.texel_faces >= 0
        steps = [np.abs(after[used] - before[used]).mean() for before, after in pairwise(images)]
        assert max(steps) < 1.3 * min(steps)
        deviations = [image[used].std() for image in images]
        assert_allclose(deviations, deviations[0], rtol=0.1)

    def test_one_by_one_is_the_same(self):
        _, images = line_integral_convolution(self.mesh, self.field, size=128, phase=[0.0, 0.3])
        _, alone = line_integral_convolution(self.mesh, self.field, size=128, phase=0.0)
        assert_array_equal(images[0], alone)


class TestRefusals:
    mesh = icosphere(0)
    field = np.ones((20, 3))

    def test_fields_that_do_not_fit(self):
        with pytest.raises(ParameterError, match=r"shape \(12, 3\)"):
            line_integral_convolution(self.mesh, np.ones((12, 3)))
        with pytest.raises(ParameterError, match="not finite"):
            line_integral_convolution(self.mesh, np.nan * self.field)

    @pytest.mark.parametrize("length", [0, -1, 2, np.nan])
    def test_lengths_out_of_range(self, length):
        with pytest.raises(ParameterError, match="length"):
            line_integral_convolution(self.mesh, self.field, length=length)

    def test_other_numbers(self):
        with pytest.raises(ParameterError, match="width"):
            line_integral_convolution(self.mesh, self.field, width=0)
        with pytest.raises(ParameterError, match="phase"):
            line_integral_convolution(self.mesh, self.field, phase=np.nan)
        with pytest.raises(ParameterError, match="seed"):
            line_integral_convolution(self.mesh, self.field, seed=0.5)
        with pytest.raises(ParameterError, match="size"):
            line_integral_convolution(self.mesh, self.field, size=0)
