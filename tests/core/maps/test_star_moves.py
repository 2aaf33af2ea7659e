import numpy as np
import pytest
from numpy.testing import assert_allclose

from abfm.maps import sphere_embedding
from abfm.maps.image_relaxation import Codomain, Image, relax, relocate
from abfm.maps.sphere_embedding import Embedding, build_surface, sweep
from abfm.maps.spherical import Faces
from abfm.maps.star_moves import add_product, allocate_workspace, shape, step_to_minimum, volume
from abfm.mesh.shapes import geodesic_sphere, two_armed


def product(x):
    """Return ``D phi(V)`` with D quadratic, V linear and ``phi(V) = 1 + 3 / V^2``."""
    return (2 + x[0] + 3 * x[0] ** 2 + x[0] * x[1] + 2 * x[1] ** 2) * (
        1 + 3 / (1.5 + 0.4 * x[0] - 0.7 * x[1]) ** 2
    )


def test_derivatives_of_a_product_are_exact():
    model, inverse = np.zeros(5), 3 / 1.5**2
    phi = 1 + inverse, -2 * inverse, 6 * inverse
    add_product(model, (2.0, 1.0, 0.0), (6.0, 1.0, 4.0), (0.4 / 1.5, -0.7 / 1.5), phi)
    direction = np.array([0.6, 0.8])
    first = model[:2] @ direction
    second = direction @ np.array([[model[2], model[3]], [model[3], model[4]]]) @ direction
    errors = [
        abs(product(h * direction) - product(0 * direction) - h * first - h**2 / 2 * second)
        for h in (0.02, 0.01, 0.005)
    ]
    assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 3, atol=0.1)


def test_step_of_a_convex_model_reaches_its_minimum():
    hessian, gradient = np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([0.5, -2.0])
    step = step_to_minimum(np.array([*gradient, 3.0, 1.0, 2.0]))
    assert_allclose(hessian @ step, -gradient, atol=1e-14)


@pytest.mark.parametrize("bend", [(-3.0, 0.5, 1.0), (-3.0, 0.5, -1.0), (0.0, 2.0, 0.0)])
def test_step_of_any_model_descends(bend):
    gradient = np.array([0.5, -2.0])
    assert gradient @ step_to_minimum(np.array([*gradient, *bend])) < 0


def test_shape_gives_the_dirichlet_energy():
    """The identity has an energy of twice the area, within 3%: sides are lengthened by 1%."""
    corners = np.array([[0.0, 0, 0], [1, 0.2, 0], [0.3, 0.9, 0.4]])
    *weights, area = shape(*corners)
    sides = np.roll(corners, -1, axis=0) - np.roll(corners, 1, axis=0)
    assert_allclose(weights @ (sides**2).sum(axis=1), 2 * area, rtol=0.03)
    exact = np.linalg.norm(np.cross(corners[1], corners[2])) / 2
    assert_allclose(area, exact, rtol=0.03)


def test_volume_of_a_small_face_is_twice_its_area():
    a, b, c = np.array([[1.0, 0, 0], [1, 1e-4, 0], [1, 0, 2e-4]])
    assert_allclose(volume(a, b, c), 2e-8, rtol=1e-12)
    assert_allclose(volume(a, c, b), -2e-8, rtol=1e-12)


def stretches(points, images, faces):
    """Return the symmetric Dirichlet energy of a map of faces in space, integrated over area."""

    def square(p):
        first, second = p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]
        rows = [[(x * y).sum(axis=1) for y in (first, second)] for x in (first, second)]
        return np.moveaxis(np.array(rows), 2, 0)

    before, after = square(points), square(images)
    squares = np.einsum("fij,fji->f", np.linalg.inv(before), after)
    inverse_squares = np.einsum("fij,fji->f", np.linalg.inv(after), before)
    return float(((squares + inverse_squares) * np.sqrt(np.linalg.det(before)) / 2).sum())


def test_sweeps_decrease_the_energy():
    mesh = geodesic_sphere(6)
    noise = np.random.default_rng(0).normal(scale=0.04, size=mesh.vertices.shape)
    sphere = mesh.vertices + noise
    sphere /= np.linalg.norm(sphere, axis=1)[:, None]
    count = len(sphere)
    state = Embedding(mesh.vertices.copy(), build_surface(mesh.faces.copy(), count), sphere)
    energies = [stretches(mesh.vertices, sphere, mesh.faces)]
    for _ in range(4):
        sweep(state, np.arange(count), allocate_workspace(count))
        energies.append(stretches(mesh.vertices, sphere, mesh.faces))
    assert (np.diff(energies) < 0).all()
    assert energies[-1] < 1.02 * stretches(mesh.vertices, mesh.vertices, mesh.faces)


def test_image_relaxes_to_an_isometry():
    """A surface rotated by 0.05 rad on its own sphere embedding relaxes back to its vertices."""
    mesh = two_armed(2).normalized()
    embedding, count = sphere_embedding(mesh), len(mesh.vertices)
    turn = np.array([[np.cos(0.05), -np.sin(0.05), 0], [np.sin(0.05), np.cos(0.05), 0], [0, 0, 1]])
    # kernels are compiled for writable arrays, and meshes are read-only
    points, corners = mesh.vertices.copy(), mesh.faces.copy()
    sphere, surface = embedding @ turn, build_surface(corners, count)
    layout = Faces(corners, surface.twins.reshape(-1, 3), embedding.copy(), 1.0)
    faces, places = np.zeros(count, dtype=np.int64), np.zeros((count, 3))
    weights = np.full(count, 1e2 / count)
    state = Embedding(points, surface, sphere)
    image = Image(state, Codomain(layout, points), faces, places, points, weights)
    relocate(image)
    start = np.linalg.norm(image.places - mesh.vertices, axis=1).mean()
    for _ in range(60):
        relax(image, allocate_workspace(count))
    assert np.linalg.det(sphere[mesh.faces]).min() > 0
    assert np.linalg.norm(image.places - mesh.vertices, axis=1).mean() < 0.1 * start
    least = stretches(mesh.vertices, mesh.vertices, mesh.faces)
    assert stretches(mesh.vertices, image.places, mesh.faces) < 1.02 * least
