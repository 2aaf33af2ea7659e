"""Fields as operators, Helmholtz-Hodge parts, and the smoothest commuting fields."""

import numpy as np
import pytest
from scipy import linalg
from scipy.sparse.linalg import expm_multiply
from scipy.spatial.transform import Rotation

from abfm.calculus import operators as op
from abfm.calculus import vector_fields as vf
from abfm.errors import ParameterError
from abfm.mesh import TriangleMesh
from tests.core import surfaces
from tests.core.calculus import torus_calculus as exact
from tests.core.fields import rotation_field, tangent, wavy_field
from tests.core.verification import near
from tests.messages import raises
from tests.shapes import disc, ellipsoid, icosphere, torus


def random_frame_field(mesh, seed=0):
    return np.random.default_rng(seed).normal(size=(len(mesh.faces), 2))


def close(actual, expected, scale=1.0):
    near(actual, expected, 1e-12 * scale)


def test_frame_coefficients_represent_tangential_parts(mesh):
    fields = np.random.default_rng(0).normal(size=(3, len(mesh.faces), 3))
    coefficients = vf.to_frame(mesh, fields)
    for field, part in zip(fields, coefficients, strict=True):
        close(vf.to_ambient(mesh, part), tangent(mesh, field))
        close(np.linalg.norm(part, axis=1), np.linalg.norm(tangent(mesh, field), axis=1))
    close(vf.to_frame(mesh, vf.to_ambient(mesh, coefficients)), coefficients)
    close(vf.to_frame(mesh, op.face_normals(mesh)), 0)


def test_derivative_equals_its_definition(mesh):
    """``D_v f`` is the area-weighted mean of ``<v, grad f>`` over the faces at a vertex."""
    v, f = random_frame_field(mesh), surfaces.random_function(mesh)
    slope = vf.to_ambient(mesh, (op.gradient(mesh) @ f).reshape(-1, 2))
    on_faces = (vf.to_ambient(mesh, v) * slope).sum(axis=1)
    weighted, weight = np.zeros((2, len(mesh.vertices)))
    np.add.at(weighted, mesh.faces, (op.face_areas(mesh) * on_faces)[:, None])
    np.add.at(weight, mesh.faces, op.face_areas(mesh)[:, None])
    found, dual = vf.directional_derivative(mesh, v) @ f, vf.dual_directional_derivative(mesh, f)
    close(found, weighted / weight, abs(on_faces).max())
    close(dual @ v.ravel(), found, abs(found).max())
    h = np.random.default_rng(1).normal(size=len(mesh.faces))
    slope = (op.gradient(mesh) @ (op.averaging(mesh) @ h)).reshape(-1, 2)
    found = vf.face_directional_derivative(mesh, v) @ h
    close(found, (v * slope).sum(axis=1), abs(op.gradient(mesh)).max())


def test_symmetric_part_is_the_divergence(mesh):
    """The symmetric part of ``D_v`` times vertex areas has entries at vertices and edges only.

    They are a third and a twelfth of ``grad^T M v``, with gradients of vertices and edges.
    """
    v = random_frame_field(mesh)
    matrix = (op.vertex_areas(mesh)[:, None] * vf.directional_derivative(mesh, v)).toarray()
    symmetric = (matrix + matrix.T) / 2
    momentum = op.field_mass(mesh) @ v.ravel()
    expected = np.diag(op.gradient(mesh).T @ momentum / 3)
    start, end = mesh.edges.T
    expected[start, end] = expected[end, start] = op.edge_gradient(mesh).T @ momentum / 12
    close(symmetric, expected, abs(matrix).max())


@pytest.mark.parametrize("name", surfaces.SURFACES)
def test_divergence_free_fields_preserve_integral_and_norm(name):
    mesh = surfaces.SURFACES[name]
    turned = op.hodge_gradients(mesh)[1]
    potential = np.random.default_rng(0).normal(size=turned.shape[1])
    v = (turned @ potential).reshape(-1, 2)
    areas, derivative = op.vertex_areas(mesh), vf.directional_derivative(mesh, v)
    matrix = (areas[:, None] * derivative).toarray()
    close(matrix, -matrix.T, max(abs(matrix).max(), 1e-300))
    f = surfaces.random_function(mesh)
    speed = max(abs(derivative).sum(axis=1).max(), 1.0)
    advected = expm_multiply(-derivative / speed, f)
    assert areas @ advected == pytest.approx(areas @ f, abs=1e-12)
    assert areas @ advected**2 == pytest.approx(areas @ f**2, rel=1e-12)


def test_rotation_of_the_sphere_rotates_linear_functions():
    """For the rotation about x, ``D_v z = (e_x cross p)_z = y``, with order above 1.5."""
    errors = []
    for mesh in map(icosphere, (2, 3, 4)):
        rotation = vf.to_frame(mesh, rotation_field(mesh, [1, 0, 0]))
        derivative = vf.directional_derivative(mesh, rotation)
        turned = derivative @ mesh.vertices[:, 2]
        errors.append(surfaces.relative_error(mesh, turned, mesh.vertices[:, 1]))
    assert errors[-1] < 4e-3
    assert surfaces.last_order(errors) > 1.5


def test_product_rule_has_order_two():
    errors = []
    for mesh in exact.refined(4):
        v = exact.face_field(mesh, lambda u, v: np.cos(u) * np.sin(v), lambda u, v: np.sin(u + v))
        derivative = vf.directional_derivative(mesh, vf.to_frame(mesh, v))
        f, g = np.sin(mesh.vertices @ [2.0, 1.0, 0.5]), np.cos(mesh.vertices @ [1.0, -1.0, 2.0])
        expected = f * (derivative @ g) + g * (derivative @ f)
        errors.append(surfaces.relative_error(mesh, derivative @ (f * g), expected))
    assert surfaces.last_order(errors) == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize(
    ("field", "named"),
    [
        (np.zeros((3, 3)), ("v", "(3, 3)", "(4, 3)")),
        (np.zeros((4, 2)), ("(4, 3)",)),
        (np.full((4, 3), np.nan), ("v",)),
    ],
)
def test_invalid_fields_are_refused(field, named):
    for call in (vf.helmholtz_hodge, lambda mesh, v: vf.check_field(mesh, v, "v")):
        with raises(ParameterError, *named):
            call(surfaces.SURFACES["tetrahedron"], field)


def random_field(mesh, seed=0):
    return tangent(mesh, np.random.default_rng(seed).normal(size=(len(mesh.faces), 3)))


def test_hodge_parts_are_orthogonal_projections(mesh):
    v, mass = random_field(mesh), op.field_mass(mesh)
    parts = vf.helmholtz_hodge(mesh, v)
    near(sum(parts), v, 1e-14)
    for i, part in enumerate(parts):
        inner = op.face_areas(mesh) @ (part * parts[i - 1]).sum(axis=1)
        assert abs(inner) < 1e-13 * surfaces.norm(mesh, v) ** 2
        for j, again in enumerate(vf.helmholtz_hodge(mesh, part)):
            near(again, part if i == j else 0, 1e-12)
    of_a, of_b = (
        [abs(basis.T @ (mass @ vf.to_frame(mesh, p).ravel())).max(initial=0) for p in parts]
        for basis in op.hodge_gradients(mesh)
    )
    assert max(of_a[1], of_a[2], of_b[0], of_b[2]) < 1e-12 * surfaces.norm(mesh, v)
    lifted = vf.helmholtz_hodge(mesh, v + 3 * op.face_normals(mesh))
    np.testing.assert_allclose(lifted, parts, atol=1e-12)
    assert not np.any(vf.helmholtz_hodge(mesh, np.zeros_like(v)))


@pytest.mark.parametrize("name", surfaces.SURFACES)
def test_harmonic_parts_span_one_dimension_per_loop(name):
    mesh = surfaces.SURFACES[name]
    parts = [vf.helmholtz_hodge(mesh, random_field(mesh, seed))[2].ravel() for seed in range(6)]
    sizes = np.linalg.svd(np.array(parts), compute_uv=False)
    assert (sizes > 1e-9 * np.sqrt(len(mesh.faces))).sum() == surfaces.LOOPS.get(name, 0)


def test_gradient_and_rotation_are_separated_on_the_sphere():
    errors = []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        slope = tangent(mesh, np.broadcast_to([1.0, 2, 3], (len(mesh.faces), 3)))
        spin = rotation_field(mesh, [3, 1, 2])
        *found, harmonic = vf.helmholtz_hodge(mesh, slope + spin)
        assert surfaces.norm(mesh, harmonic) < 1e-13 * surfaces.norm(mesh, spin)
        pairs = zip(found, (slope, spin), strict=True)
        errors.append([surfaces.relative_error(mesh, part, answer) for part, answer in pairs])
    assert errors[-1][0] < 3e-3
    assert (surfaces.last_order(errors) > 0.9).all()


def test_harmonic_fields_of_the_torus_converge():
    """The fields ``ring^-2 d/du`` and ``ring^-1 d/dv`` converge to zero divergence and curl."""
    errors = []
    for mesh in exact.refined(3):
        of_u, of_v = lambda u, v: exact.ring(v) ** -2, lambda u, v: 2 / exact.ring(v)
        harmonic = exact.face_field(mesh, of_u, of_v)
        found = vf.helmholtz_hodge(mesh, harmonic)[2]
        errors.append(surfaces.relative_error(mesh, found, harmonic))
    assert surfaces.last_order(errors) > 0.9


def test_gradient_takes_the_flux_through_the_boundary():
    """On a disc, a constant field is a gradient; a rotation has only a divergence-free part."""
    mesh = disc(8)
    constant = np.broadcast_to([1.0, 0.5, 0], (len(mesh.faces), 3))
    np.testing.assert_allclose(vf.helmholtz_hodge(mesh, constant)[0], constant, atol=1e-12)
    errors = []
    for n in (8, 16, 32):
        spin = rotation_field(disc(n), [0, 0, 1])
        errors.append(surfaces.relative_error(disc(n), vf.helmholtz_hodge(disc(n), spin)[1], spin))
    assert surfaces.last_order(errors) > 0.9


def test_pinched_surfaces_are_decomposed():
    one = surfaces.SURFACES["ellipsoid"]
    count, tip = len(one.vertices), int(np.argmax(one.vertices[:, 0]))
    vertices = np.concatenate([one.vertices, 2 * one.vertices[tip] - one.vertices])
    mirrored = np.where(one.faces == tip, tip, one.faces + count)[:, ::-1]
    mesh = TriangleMesh(vertices, np.concatenate([one.faces, mirrored]))
    assert any("pinched" in message for message in mesh.messages)
    v = random_field(mesh)
    parts = vf.helmholtz_hodge(mesh, v)
    near(sum(parts), v, 1e-14)
    assert surfaces.norm(mesh, parts[2]) < 1e-13 * surfaces.norm(mesh, v)


def up_to_scale(mesh, found, answer):
    """Return the relative error of a field that is known up to a factor."""
    found, answer = found / surfaces.norm(mesh, found), answer / surfaces.norm(mesh, answer)
    return min(surfaces.relative_error(mesh, sign * found, answer) for sign in (1, -1))


def roughness(mesh, u):
    """Return the Hodge energy of a field times the area, over its squared L2 norm."""
    c, area = vf.to_frame(mesh, u).ravel(), op.face_areas(mesh).sum()
    return area * (c @ (op.hodge_laplacian(mesh) @ c)) / (c @ (op.field_mass(mesh) @ c))


def test_torus_rotation_commutes_with_a_harmonic_field():
    """The field that commutes with the rotation runs around the tube."""
    errors, brackets = [], []
    for mesh in exact.refined(3, 16):
        v = rotation_field(mesh, [0, 0, 1])
        (u,) = vf.commuting_fields(mesh, v)
        answer = exact.face_field(mesh, lambda u, v: 0 * u, lambda u, v: 1 / exact.ring(v))
        errors.append(up_to_scale(mesh, u, answer))
        brackets.append(vf.relative_bracket(mesh, v, u))
    assert errors[-1] < 0.06
    assert surfaces.last_order(errors) > 0.75
    assert surfaces.last_order(brackets) > 0.85


def test_sphere_rotation_commutes_with_an_axial_gradient():
    errors, brackets = [], []
    for level in (2, 3, 4):
        mesh = icosphere(level)
        v = rotation_field(mesh, [0, 0, 1])
        found = vf.commuting_fields(mesh, v, 2)
        along = tangent(mesh, np.tile([0.0, 0, 1], (len(mesh.faces), 1)))
        errors.append(up_to_scale(mesh, found[0], along))
        brackets.append(vf.relative_bracket(mesh, v, found[0]))
        others = vf.commuting_fields(mesh, v, 5, weight=0)
        assert max(vf.relative_bracket(mesh, v, u) for u in others) > 10 * brackets[-1]
    assert errors[-1] < 0.05
    assert surfaces.last_order(brackets) > 0.4  # on icospheres, see test_lie_bracket


def test_smoother_fields_that_do_not_commute_are_rejected():
    """On a flat spheroid, the chosen field is rougher than the smoothest one, but commutes better.

    The smoothest fields rotate about horizontal axes or point along them.
    """
    mesh = ellipsoid(3, 1.2, 1.2, 0.6)
    v = rotation_field(mesh, [0, 0, 1])
    (smoothest,), (u,) = vf.commuting_fields(mesh, v, weight=0), vf.commuting_fields(mesh, v)
    assert roughness(mesh, smoothest) < 0.9 * roughness(mesh, u)
    assert vf.relative_bracket(mesh, v, u) < 0.2 * vf.relative_bracket(mesh, v, smoothest)
    around = op.face_areas(mesh) @ (u * rotation_field(mesh, [0, 0, 1])).sum(axis=1)
    assert abs(around) < 1e-9 * surfaces.norm(mesh, u) * surfaces.norm(mesh, v)


def test_multiples_by_stream_functions_commute():
    """The field that commutes with the rotated gradient ``v`` of ``f`` is a multiple ``h(f) v``."""
    brackets = []
    for level in (2, 3):
        mesh = ellipsoid(level, 1.0, 0.7, 1.6)
        f = mesh.vertices[:, 2] * np.exp(0.2 * mesh.vertices[:, 0])
        v = vf.to_ambient(mesh, (op.rotation(mesh) @ (op.gradient(mesh) @ f)).reshape(-1, 2))
        (u,) = vf.commuting_fields(mesh, v, weight=1000)
        aligned = abs((u * v).sum(axis=1)) @ op.face_areas(mesh)
        speeds = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) @ op.face_areas(mesh)
        brackets.append(vf.relative_bracket(mesh, v, u))
    assert aligned > 0.95 * speeds
    assert surfaces.last_order(brackets) > 0.4


@pytest.mark.parametrize("name", ["ellipsoid", "torus", "genus two", "square", "cylinder"])
def test_commuting_fields_agree_with_a_dense_eigensolver(name):
    """The dense problem uses an orthonormal basis of the complement of the given field."""
    mesh = surfaces.SURFACES[name]
    v, mass = wavy_field(mesh, 1), op.field_mass(mesh).toarray()
    c, weight = vf.to_frame(mesh, v), 7.0 / surfaces.norm(mesh, v) ** 2 * op.face_areas(mesh).sum()
    ad, momentum = vf.lie_bracket(mesh, c).toarray(), mass @ c.ravel()
    energy = op.hodge_laplacian(mesh).toarray() + weight * ad.T @ mass @ ad
    basis = linalg.null_space(momentum[None])
    values, vectors = linalg.eigh(basis.T @ energy @ basis, basis.T @ mass @ basis)
    found = vf.commuting_fields(mesh, v, 2, weight=7.0)
    for value, u in zip(values, found, strict=False):
        w = vf.to_frame(mesh, u).ravel()
        of_bracket = weight * surfaces.norm(mesh, vf.lie_bracket_of(mesh, v, u)) ** 2
        of_u = w @ (op.hodge_laplacian(mesh) @ w) + of_bracket
        assert of_u / surfaces.norm(mesh, u) ** 2 == pytest.approx(value, rel=1e-7)
        assert abs(w @ momentum) < 1e-8 * surfaces.norm(mesh, u) * surfaces.norm(mesh, v)
        assert surfaces.norm(mesh, u) == pytest.approx(surfaces.norm(mesh, v), rel=1e-9)
    if values[1] > 1.01 * values[0]:
        lowest = vf.to_frame(mesh, found[0]).ravel() / surfaces.norm(mesh, found[0])
        assert abs(lowest @ mass @ basis @ vectors[:, 0]) == pytest.approx(1, abs=1e-6)


def test_commuting_fields_follow_changes_of_the_mesh():
    mesh = ellipsoid(2, 1.0, 0.7, 1.6)
    v = wavy_field(mesh, 1)
    (u,) = vf.commuting_fields(mesh, v)
    turn = Rotation.from_euler("xyz", [0.3, -1.2, 2.0]).as_matrix()
    other, _, faces = surfaces.renumbered(mesh, 3)
    for found, expected in (
        (vf.commuting_fields(surfaces.moved(mesh, turn), v @ turn.T), u @ turn.T),
        (vf.commuting_fields(surfaces.moved(mesh, np.eye(3), 8.0), 8 * v) / 8, u),
        (vf.commuting_fields(mesh, 1e-4 * v) * 1e4, u),
        (vf.commuting_fields(other, v[faces]), u[faces]),
    ):
        near(found[0], expected, 1e-6 * abs(u).max())
    np.testing.assert_array_equal(vf.commuting_fields(mesh, v)[0], u)
    tilted = v + 3 * op.face_normals(mesh)
    np.testing.assert_allclose(vf.commuting_fields(mesh, tilted)[0], u, atol=1e-6)
    assert vf.relative_bracket(mesh, tilted, v + tilted) < 1e-12


def test_larger_weights_give_smaller_brackets():
    mesh = torus(24, 12)
    v = wavy_field(mesh, 2)
    found = [vf.commuting_fields(mesh, v, weight=weight)[0] for weight in (0, 1, 10, 100)]
    assert (np.diff([vf.relative_bracket(mesh, v, u) for u in found]) < 0).all()
    assert (np.diff([roughness(mesh, u) for u in found]) > 0).all()


@pytest.mark.parametrize(
    ("v", "options", "named"),
    [
        (np.zeros((24, 3)), {}, ()),
        (np.ones((23, 3)), {}, ()),
        (np.full((24, 3), np.nan), {}, ()),
        (np.ones((24, 3)), {"count": 0}, (1, 24)),
        (np.ones((24, 3)), {"count": 25}, (1, 24)),
        (np.ones((24, 3)), {"weight": -1.0}, (0,)),
        (np.ones((24, 3)), {"weight": float("nan")}, (0,)),
    ],
)
def test_invalid_input_of_commuting_fields_is_refused(v, options, named):
    with raises(ParameterError, *named):
        vf.commuting_fields(disc(2), v, **options)
    if not v.any():
        with raises(ParameterError, *named):
            vf.relative_bracket(disc(2), wavy_field(disc(2), 1), v)
