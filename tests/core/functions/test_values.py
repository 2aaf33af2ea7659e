import numpy as np
import potpourri3d
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from abfm.assets import asset_path
from abfm.calculus.channels import extend
from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.geodesics import geodesic_distance
from abfm.calculus.operators import cotangent_laplacian, vertex_areas
from abfm.errors import FunctionError
from abfm.functions import function
from abfm.functions.local_shape import gaussian_curvature, mean_curvature, mixed_areas
from abfm.mesh import TriangleMesh, load_mesh
from tests import shapes
from tests.messages import raises
from tests.shapes import hemisphere, icosphere, open_cylinder, square, tetrahedron, torus


@pytest.mark.parametrize(("subdivisions", "error"), [(3, 0.051), (4, 0.030), (5, 0.020)])
def test_geodesic_distance_on_the_sphere_is_an_angle(subdivisions, error):
    mesh = icosphere(subdivisions, radius=3.0)
    d = geodesic_distance(mesh, [7])
    exact = 3 * np.arccos(np.clip(mesh.vertices @ mesh.vertices[7] / 9, -1, 1))
    assert d[7] == 0
    assert np.abs(d - exact).max() < 3 * error


def test_geodesic_function_is_exact_on_a_rhombus():
    """Distances in a plane rhombus are exact, whereas the heat method gives 1.514 and 2.717."""
    corners = [[0.0, 1, 0], [3, 0, 0], [0, -1, 0], [-3, 0, 0]]
    rhombus = TriangleMesh(corners, [[0, 2, 1], [0, 3, 2]])
    d = function(rhombus, "geodesic:vertex=2")
    assert_allclose(d, [2, 10**0.5, 0, 10**0.5], rtol=1e-15)


def test_geodesic_function_is_exact():
    errors = []
    for subdivisions in (2, 3, 4):
        mesh = icosphere(subdivisions)
        d = function(mesh, "geodesic:vertex=7")
        errors.append(np.abs(d - np.arccos(np.clip(mesh.vertices @ mesh.vertices[7], -1, 1))).max())
    assert np.all(np.divide(errors[:-1], errors[1:]) > 3.9)
    assert errors[-1] < 0.0021
    human = load_mesh(asset_path("human_A.off"))
    ends = [3, 500, 1000]
    found = np.array([function(human, f"geodesic:vertex={vertex}") for vertex in ends])
    assert_allclose(found[:, ends], found[:, ends].T, rtol=1e-12)


def test_geodesic_function_uses_the_heat_method_if_needed():
    """Large meshes, pinched vertices and thin triangles (endless if exact) use the heat method."""
    flat = square(24)
    thin = TriangleMesh(flat.vertices * [1, 1e-5, 1], flat.faces)
    for mesh in (icosphere(5), thin, pinched_sphere()[0]):
        assert_array_equal(function(mesh, "geodesic:vertex=7"), geodesic_distance(mesh, [7]))


def test_geodesic_distance_approximates_shortest_paths():
    mesh = load_mesh(asset_path("human_A.off"))
    targets = np.arange(20, len(mesh.vertices), 60)
    paths = potpourri3d.EdgeFlipGeodesicSolver(mesh.vertices, mesh.faces)
    lines = [paths.find_geodesic_path(10, int(target)) for target in targets]
    lengths = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines]
    assert_allclose(geodesic_distance(mesh, [10])[targets], lengths, atol=0.04 * mesh.length_scale)


def test_geodesic_distance_is_to_the_nearest_vertex():
    mesh = icosphere(3)
    distances = [function(mesh, f"geodesic:vertex={vertex}") for vertex in (3, 50, 200)]
    nearest = function(mesh, "geodesic:vertex=3,50,200")
    assert_allclose(nearest, np.min(distances, axis=0), atol=1e-12)
    x, y, z = 1.2 * mesh.vertices[50]
    assert_array_equal(function(mesh, f"geodesic:x={x!s},y={y!s},z={z!s}"), distances[1])
    # vertex numbers may be floats, as in files
    found = geodesic_distance(mesh, np.array([3.0, 7.0]))
    assert_array_equal(found, geodesic_distance(mesh, [3, 7]))


@pytest.mark.parametrize("source", [-1, 42, 3.5, np.nan])
def test_invalid_sources_are_refused(source):
    with raises(FunctionError, "sources", source, 0, 41):
        geodesic_distance(icosphere(1), [3, source])
    with raises(FunctionError, "sources"):
        geodesic_distance(icosphere(1), [])


def test_geodesic_distance_crosses_pinched_vertices():
    flat = square(24)
    corner = function(flat, "geodesic:vertex=0")
    assert_allclose(corner, np.linalg.norm(flat.vertices - flat.vertices[0], axis=1), atol=1e-12)
    pinched, pinch = pinched_sphere()
    assert np.ptp(function(pinched, f"geodesic:vertex={pinch}")) > 1


def pinched_sphere():
    """Return a sphere whose poles are glued in the centre, and the vertex where they meet."""
    sphere = icosphere(3)
    north, south = int(np.argmax(sphere.vertices[:, 2])), int(np.argmin(sphere.vertices[:, 2]))
    vertices = sphere.vertices.copy()
    vertices[north] = 0
    faces = np.where(sphere.faces == south, north, sphere.faces)
    mesh = TriangleMesh(vertices, faces)
    return mesh, int(np.flatnonzero(mesh.vertex_ids == north)[0])


def test_vertex_numbers_are_those_of_the_file():
    mesh = shapes.with_loose_vertex(icosphere(2))
    expected = function(icosphere(2), "gaussian:vertex=9")
    assert_array_equal(function(mesh, "gaussian:vertex=10"), expected)
    with pytest.raises(FunctionError):
        function(mesh, "gaussian:vertex=5")


def test_gaussian_on_the_sphere_has_its_width():
    mesh = icosphere(5, radius=2.0)
    angle = np.arccos(np.clip(mesh.vertices @ mesh.vertices[0] / 4, -1, 1))
    d = angle / np.sqrt(4 * np.pi)  # fraction of sqrt(area), whatever the radius
    narrow = function(mesh, "gaussian:vertex=0,width=0.12")
    assert_allclose(narrow, np.exp(-(d**2) / (2 * 0.12**2)), atol=0.02)
    deep = function(mesh, "gaussian:vertex=0,height=-3")
    assert_allclose(deep, -3 * np.exp(-(d**2) / 0.02), atol=0.06)
    mesh = icosphere(3, radius=2.0)
    d = np.linalg.norm(mesh.vertices - mesh.vertices[3], axis=1) / mesh.length_scale
    found = function(mesh, "gaussian:vertex=3,width=0.2,metric=euclidean")
    assert_allclose(found, np.exp(-(d**2) / 0.08), rtol=1e-12)


@pytest.mark.parametrize("width", ["1e-300", "1e300", "5e-324"])
def test_extreme_widths_stay_finite(width):
    f = function(icosphere(2), f"gaussian:vertex=3,width={width}")
    assert f[3] == 1
    assert f.min() >= 0


def test_indicator_of_a_disc_has_the_area_of_the_cap():
    mesh = icosphere(5)
    f = function(mesh, "indicator:vertex=11,radius=0.2")
    angle = 0.2 * np.sqrt(4 * np.pi)
    assert set(f) == {0, 1}
    assert_allclose(vertex_areas(mesh) @ f, 2 * np.pi * (1 - np.cos(angle)), rtol=0.03)


def test_indicator_is_one_in_half_spaces_and_slabs():
    mesh = icosphere(3, radius=2.0)
    y = mesh.vertices[:, 1]
    assert_array_equal(function(mesh, "indicator:axis=y,above=0.2"), y > 0.2)
    assert_array_equal(function(mesh, "indicator:axis=y,below=-1"), y < -1)
    assert_array_equal(function(mesh, "indicator:axis=y,above=-1,below=0.2"), (y > -1) & (y < 0.2))
    assert_array_equal(function(mesh, "coordinate:y"), y)


@pytest.mark.parametrize(("curvature", "power"), [(gaussian_curvature, -2), (mean_curvature, -1)])
def test_curvature_of_the_sphere_converges_with_order_2(curvature, power):
    errors = [np.abs(curvature(icosphere(s, radius=3.0)) - 3.0**power).max() for s in (3, 4)]
    assert errors[1] < 0.002 * 3.0**power
    assert np.log2(errors[0] / errors[1]) > 1.9


def test_curvature_of_the_torus_is_accurate():
    mesh = torus(96, 48, R=1.0, r=0.4)
    v = np.tile(2 * np.pi * np.arange(48) / 48, 96)
    gaussian = np.cos(v) / (0.4 * (1 + 0.4 * np.cos(v)))
    mean = (1 + 0.8 * np.cos(v)) / (0.8 * (1 + 0.4 * np.cos(v)))
    assert_allclose(function(mesh, "curvature:gaussian"), gaussian, atol=0.04)
    assert_allclose(function(mesh, "curvature:mean"), mean, atol=0.03)


def test_curvature_at_a_boundary_is_extended():
    cylinder = open_cylinder(40, 10, radius=2.0)
    assert_allclose(function(cylinder, "curvature:mean"), 1 / 4, rtol=1e-3)
    assert_allclose(function(cylinder, "curvature:gaussian"), 0, atol=1e-10)
    assert_allclose(function(hemisphere(12), "curvature:gaussian"), 1, rtol=0.02)
    with raises(FunctionError):
        function(TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), "curvature:mean")


@pytest.mark.parametrize("name", ["eight", "human_A", "fandisk"])
def test_gauss_bonnet_holds_and_mixed_areas_add_up(name):
    mesh = load_mesh(asset_path(f"{name}.off"))
    areas = mixed_areas(mesh)
    assert_allclose(areas.sum(), mesh.length_scale**2, rtol=1e-12)
    assert areas.min() > 0
    total = 2 * np.pi * mesh.euler_characteristic
    assert_allclose(areas @ gaussian_curvature(mesh), total, rtol=1e-9)


def cone_mean(length, widest):
    """Return the robust mean of Shapira et al. of rays up to an angle from the axis."""
    angles = np.arccos(1 - 0.5 * (np.arange(30) + 0.5) / 30)
    angles = angles[angles < widest]
    kept = np.abs(length(angles) - np.median(length(angles))) <= length(angles).std()
    return float(np.average(length(angles)[kept], weights=1 / angles[kept]))


def test_shape_diameter_is_the_thickness():
    # beyond 45 degrees, hits are within 90 degrees of the normal
    exact = cone_mean(lambda angle: 2 * 3.0 * np.cos(angle), np.pi / 4)
    assert_allclose(exact / 3, 1.717, atol=1e-3)
    assert_allclose(function(icosphere(4, radius=3.0), "shape-diameter"), exact, rtol=0.02)
    box = trimesh.creation.box(extents=[4.0, 4.0, 0.2]).subdivide_to_size(0.3)
    box.merge_vertices()  # older versions of the library do not merge them
    mesh = TriangleMesh(box.vertices, box.faces)
    middle = np.abs(mesh.vertices[:, :2]).max(axis=1) < 1.5
    exact = cone_mean(lambda angle: 0.2 / np.cos(angle), np.pi)
    assert middle.sum() > 50
    assert_allclose(function(mesh, "shape-diameter")[middle], exact, rtol=1e-5)


def test_shape_diameter_needs_a_ray_that_hits_the_surface():
    f = function(open_cylinder(30, 10, height=1.0), "shape-diameter")
    assert f.min() > 1
    assert f.max() < 3
    pinched, _ = pinched_sphere()
    assert np.isfinite(function(pinched, "shape-diameter")).all()
    with raises(FunctionError):
        function(square(4), "shape-diameter")


def test_extension_keeps_known_values_and_averages_the_rest():
    mesh = icosphere(2)
    known = np.zeros(len(mesh.vertices), dtype=bool)
    known[[3, 77, 120]] = True
    values = np.where(known, mesh.vertices[:, 2], np.nan)
    filled = extend(mesh, values, known)
    assert_array_equal(filled[known], values[known])
    i, j = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T
    neighbours = np.bincount(i, filled[j]) / np.bincount(i)
    assert_allclose(filled[~known], neighbours[~known], atol=1e-12)


MODES = np.arange(12)  # cos(pi n x), the eigenfunctions of the interval [0, 1]


def test_eigenvalues_of_the_sphere_converge():
    exact = np.repeat([0, 2, 6, 12], [1, 3, 5, 7])
    errors = [np.abs(eigenbasis(icosphere(s, radius=2.0), 16)[0] * 4 - exact).max() for s in (3, 4)]
    assert errors[1] < 0.1
    assert np.log2(errors[0] / errors[1]) > 1.9


@pytest.mark.parametrize(
    "mesh", [icosphere(3), torus(30, 15), hemisphere(8), tetrahedron()], ids=str
)
def test_eigenbasis_solves_the_generalised_problem(mesh):
    k = min(40, len(mesh.vertices))
    values, functions = eigenbasis(mesh, k)
    mass = vertex_areas(mesh)
    assert values.shape == (k,)
    assert (np.diff(values) >= 0).all()
    assert_allclose(functions.T @ (mass[:, None] * functions), np.eye(k), atol=1e-10)
    residual = cotangent_laplacian(mesh) @ functions - mass[:, None] * functions * values
    assert np.abs(residual).max() < 1e-9 * values[-1]


def test_smoothed_function_decays_by_its_eigenvalue():
    """One implicit step of the heat equation divides z on the unit sphere by 1 + 2 length^2."""
    mesh = icosphere(3)
    length = 0.1 * mesh.length_scale
    found = function(mesh, "smoothed:0.1(coordinate:z)")
    assert_allclose(found, mesh.vertices[:, 2] / (1 + 2 * length**2), atol=2e-3)
    assert_allclose(function(mesh, "smoothed:0.1(expression:3)"), 3, rtol=1e-12)


def test_smoothing_ignores_missing_values(tmp_path):
    mesh = icosphere(2)
    values = np.where(np.arange(162) < 9, np.nan, 3.0)
    np.save(tmp_path / "v.npy", values)
    found = function(mesh, f"smoothed:0.1(file:{tmp_path}/v.npy)", allow_missing=True)
    assert_allclose(found, values, rtol=1e-12)


def test_eigenfunctions_are_scaled_and_signed():
    mesh = TriangleMesh(square(20).vertices * [1.5, 1, 1], square(20).faces)
    assert_array_equal(function(mesh, "eigenfunction:0"), 1)
    f = function(mesh, "eigenfunction:1")
    assert np.abs(f).max() == 1
    exact = np.cos(np.pi * mesh.vertices[:, 0] / 1.5)
    assert_allclose(f * np.sign(f @ exact), exact, atol=0.02)
    for index in range(1, 12):
        assert vertex_areas(mesh) @ function(mesh, f"eigenfunction:{index}") ** 3 > -1e-6


def test_first_large_value_of_an_eigenfunction_is_positive():
    x, y = np.meshgrid(np.linspace(-1, 1, 15), np.linspace(-0.4, 0.4, 7), indexing="ij")
    corner = (np.arange(14)[:, None] * 7 + np.arange(6)).reshape(-1, 1)
    faces = np.concatenate([corner + np.array(steps) for steps in ([0, 7, 8], [0, 8, 1])])
    mesh = TriangleMesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), faces)
    exact = -np.sin(np.pi * mesh.vertices[:, 0] / 2)
    assert_allclose(function(mesh, "eigenfunction:1"), exact, atol=0.05)


def test_results_do_not_depend_on_the_cache():
    fresh, used = torus(24, 12), torus(24, 12)
    eigenbasis(used.normalized(), 60)
    eigenbasis(used.normalized(), 3)
    for spec in ("eigenfunction:7", "hks", "wks"):
        assert_array_equal(function(fresh, spec), function(used, spec))
    few, many = (eigenbasis(used.normalized(), k)[1] for k in (3, 32))
    assert_array_equal(few, many[:, :3])


def test_eigenbasis_is_read_only_and_bounded():
    mesh = icosphere(1)
    with pytest.raises(ValueError, match="read-only"):
        eigenbasis(mesh, 3)[1][0] = 0
    for k in (0, 43):
        with raises(FunctionError, 42, 1):
            eigenbasis(mesh, k)
    with raises(FunctionError, 1, 1024):
        function(icosphere(4), "eigenfunction:1024")


@pytest.mark.parametrize("spec", ["hks:time=0.05", "hks", "wks:energy=3", "wks:energy=4"])
def test_signatures_are_one_on_the_sphere(spec):
    assert_allclose(function(icosphere(4, radius=5.0), spec), 1, atol=0.02)


@pytest.mark.parametrize("spec", ["hks", "wks", "wks:energy=-50", "wks:energy=50,width=0.01"])
def test_signatures_integrate_to_one(spec):
    mesh = torus(30, 15, R=10.0, r=4.0)
    assert_allclose(vertex_areas(mesh.normalized()) @ function(mesh, spec), 1, rtol=1e-9)


def squared_modes(x):
    """Return squares of the orthonormal Neumann eigenfunctions of [0, 1], (12, n)."""
    return np.where(MODES > 0, 2, 1)[:, None] * np.cos(np.pi * MODES[:, None] * x) ** 2


def test_signatures_of_the_square_are_exact():
    mesh = square(40)
    weights = np.exp(-(np.pi**2) * MODES**2 * 0.02)
    x, y, _ = mesh.vertices.T
    exact = (weights @ squared_modes(x)) * (weights @ squared_modes(y)) / weights.sum() ** 2
    assert_allclose(function(mesh, "hks:time=0.02"), exact, rtol=0.02)
    eigenvalues = np.pi**2 * (MODES[:, None] ** 2 + MODES**2)
    eigenvalues[0, 0] = np.nan
    weights = np.nan_to_num(np.exp(-((4.0 - np.log(eigenvalues)) ** 2) / (2 * 0.3**2)))
    exact = np.einsum("ab,an,bn->n", weights, squared_modes(x), squared_modes(y)) / weights.sum()
    assert_allclose(function(mesh, "wks:energy=4,width=0.3"), exact, rtol=0.05)


def test_signatures_use_at_most_all_eigenpairs():
    for spec in ("hks:eigenpairs=1000", "wks:eigenpairs=1000"):
        assert_allclose(function(tetrahedron(), spec), 1, atol=1e-9)
