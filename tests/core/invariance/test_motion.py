"""Invariance under motion, scaling and renumbering of meshes, with relative tolerances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import abfm
from abfm import calculus as op
from abfm.baselines import HeatKernel, optimal_transport
from abfm.flow import flow_lines
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.functions import families
from abfm.maps.surface_points import SurfacePoints, vertex_points
from tests.core.fields import bump, wavy_field
from tests.core.invariance.moves import MESHES, MOVES, Move, examples, face
from tests.shapes import disc, icosphere, open_cylinder, square

pytestmark = pytest.mark.filterwarnings("error")

# for differences of coordinates: eps times 10 sqrt(area), over edges of 0.05 sqrt(area), is 5e-14
ROUNDING = 1e-11
SOLVES = 1e-9  # for linear systems, with a condition below 1e4 on these meshes
SPECTRAL = 1e-7  # for eigenfunctions: rounding divided by gaps between eigenvalues
BY_NAME = st.sampled_from(sorted(MESHES))


def assert_alike(found, expected, tolerance):
    assert np.shape(found) == np.shape(expected)
    assert np.isfinite(found).all()
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max() + 1e-300


@examples(12)
@given(name=BY_NAME, move=MOVES)
def test_operators_and_fields_move_with_the_mesh(name, move):
    mesh, other = MESHES[name], move.mesh(MESHES[name])
    x, y, _ = mesh.vertices.T / mesh.length_scale
    f, v, u = np.sin(3 * x) + y, wavy_field(mesh, 1), wavy_field(mesh, 2)
    h, w, q = move.function(mesh, f), move.field(mesh, v), move.field(mesh, u)
    assert_alike(op.vertex_areas(other), move.function(mesh, op.vertex_areas(mesh), 2), ROUNDING)
    assert_alike(op.face_areas(other), move.on_faces(mesh, op.face_areas(mesh), 2), ROUNDING)
    lengths, moved_lengths = (np.sort(op.edge_lengths(m)) for m in (mesh, other))
    assert_alike(moved_lengths, move.scale * lengths, ROUNDING)
    for operator, by, moved_by, power in (
        (op.gradient, (f, h), move.field, -1),
        (op.divergence, (v, w), move.function, 0),
        (op.curl, (v, w), move.function, 0),
        (op.cotangent_laplacian, (f, h), move.function, 0),
        (op.hodge_laplacian, (v, w), move.field, 1),
    ):
        before, after = (
            operator(m) @ (x if x.ndim == 1 else op.to_frame(m, x).ravel())
            for m, x in zip((mesh, other), by, strict=True)
        )
        if moved_by == move.field:
            before = op.to_ambient(mesh, before.reshape(-1, 2))
            after = op.to_ambient(other, after.reshape(-1, 2))
        assert_alike(after, moved_by(mesh, before, power), ROUNDING)
    bracket, pushed = op.lie_bracket_of(mesh, v, u), op.pushforward(mesh, v, u, 0.1)
    assert_alike(op.lie_bracket_of(other, w, q), move.field(mesh, bracket), ROUNDING)
    assert_alike(op.pushforward(other, w, q, 0.1), move.field(mesh, pushed), SOLVES)
    largest = np.abs(w).max()  # if exactly zero, a part consists of rounding errors
    parts, expected_parts = op.helmholtz_hodge(other, w), op.helmholtz_hodge(mesh, v)
    for part, expected in zip(parts, expected_parts, strict=True):
        assert np.abs(part - move.field(mesh, expected)).max() <= SOLVES * largest


@examples(8)
@given(name=BY_NAME, move=MOVES)
def test_flows_move_with_the_mesh(name, move):
    mesh, other = MESHES[name], move.mesh(MESHES[name])
    f, v = bump(mesh, mesh.vertices[3], 0.3), 0.2 * wavy_field(mesh, 1)
    h, w = move.function(mesh, f), move.field(mesh, v)
    size, (old, old_faces) = mesh.length_scale * move.scale, move.numbers(mesh)
    times = [0.5, 1.0, -0.7, 0.3]
    for method in ("nonlinear", "linearised"):
        before, after = (
            abfm.Flow(m, x, 1.0, method).push(g, times) for m, x, g in ((mesh, v, f), (other, w, h))
        )
        assert_alike(after, before[:, old], SOLVES)

    def check(walk):
        """Assert that a flow line ends at corresponding points of both meshes."""
        before, after = walk(mesh, v), walk(other, w)
        assert np.abs(after - move.places(mesh, before)[old]).max() <= SOLVES * size

    check(lambda m, x: ContinuousFlow(m, x, 1.0).destinations().positions)
    check(lambda m, x: ContinuousFlow(m, x, 1.0).origins().positions)
    check(lambda m, x: ends_of(flow_lines(m, x, vertex_points(m), 1.0)))
    cases = (mesh, f, v), (other, h, w)
    checks = [abfm.matching.verify(abfm.Problem(m, x, x), y) for m, x, y in cases]
    for which in ("flow_lines", "subdivided", "resolution", "folded", "flipped"):
        one, other_one = (getattr(each, which) for each in checks)
        assert other_one == pytest.approx(one, rel=SOLVES, abs=SOLVES)
    ends = [
        ends_of(flow_lines(m, x, SurfacePoints(m, faces, np.full((1, 3), 1 / 3)), 1.0))
        for m, x, faces in ((mesh, v, np.array([5])), (other, w, np.flatnonzero(old_faces == 5)))
    ]
    assert np.linalg.norm(ends[1] - move.places(mesh, ends[0])) <= SOLVES * size


def ends_of(lines):
    return np.array([line.positions[-1] for line in lines])


@examples(6)
@given(name=BY_NAME, move=MOVES)
def test_distances_and_eigenfunctions_move_with_the_mesh(name, move):
    mesh, other = MESHES[name], move.mesh(MESHES[name])
    old = move.numbers(mesh)[0]
    place = int(np.flatnonzero(old == 7)[0])
    distances = move.function(mesh, op.geodesic_distance(mesh, 7), 1)
    assert_alike(op.geodesic_distance(other, place), distances, SPECTRAL)
    f, g = bump(mesh, mesh.vertices[3], 0.3), bump(mesh, mesh.vertices[30], 0.3)
    heated = [HeatKernel(m, 0.2, 4)(x) for m, x in ((mesh, f), (other, move.function(mesh, f)))]
    assert_alike(heated[1], move.function(mesh, heated[0]), SOLVES)
    moved = optimal_transport(other, move.function(mesh, f), move.function(mesh, g), 0.4)
    # limited by the tolerance of the iterative solver
    assert_alike(moved, move.function(mesh, optimal_transport(mesh, f, g, 0.4)), 1e-4)
    values, functions = op.eigenbasis(mesh, 12)
    again, others = op.eigenbasis(other, 12)
    assert_alike(again, values / move.scale**2, SPECTRAL)
    is_separate = np.diff(values) > 1e-3 * values[-1]
    for k in np.flatnonzero(np.append(True, is_separate) & np.append(is_separate, False)):
        phi, areas = functions[:, k], op.vertex_areas(mesh)
        sign = np.sign(others[:, k] @ move.function(mesh, phi))
        skewed = abs(areas @ phi**3) > 1e-3 * (areas @ abs(phi) ** 3)
        assert sign > 0 or not skewed
        assert_alike(sign * others[:, k], move.function(mesh, phi, -1), 1e-5)


@given(move=MOVES)
@examples(3)
def test_eigenspaces_move_with_the_mesh(move):
    """On a sphere the first three eigenfunctions are arbitrary, their sum of squares is not."""
    mesh = icosphere(2)
    spanned = [(op.eigenbasis(m, 4)[1][:, 1:] ** 2).sum(axis=1) for m in (mesh, move.mesh(mesh))]
    assert_alike(spanned[1], move.function(mesh, spanned[0], -2), SPECTRAL)


POWERS = {
    "gaussian:vertex={a},width=0.2": (0, SPECTRAL),
    "gaussian:vertex={a},metric=euclidean": (0, ROUNDING),
    "eigenfunction:4": (0, SPECTRAL),
    "hks": (0, SPECTRAL),
    "wks": (0, SPECTRAL),
    "curvature:gaussian": (-2, ROUNDING),
    "curvature:mean": (-1, ROUNDING),
    "geodesic:vertex={a},{b}": (1, SPECTRAL),
    "shape-diameter": (1, ROUNDING),
    "indicator:vertex={a},radius=0.2": (0, 0.0),
    "permuted:mirror(geodesic:vertex={a})": (1, SPECTRAL),
    "scaled:2(geodesic:vertex={a})": (1, SPECTRAL),
    "smoothed:0.1(geodesic:vertex={a})": (1, SPECTRAL),
    "circular:part=sine(gaussian:vertex={a},width=0.2)": (0, SPECTRAL),
}
FACE = face(1)
# these families depend on the axes of space or on the rows of a file
IN_SPACE = {"coordinate", "expression", "file"}


def test_every_family_is_tested():
    assert {spec.partition(":")[0] for spec in POWERS} | IN_SPACE == {
        family.family for family in families()
    }


@pytest.mark.parametrize("spec", POWERS)
def test_functions_are_deterministic(spec):
    found, again = (abfm.function(face(1), spec.format(a=12, b=31)) for _ in range(2))
    assert np.array_equal(found, again)


@pytest.mark.parametrize("spec", POWERS)
@examples(4)
@given(move=MOVES)
def test_functions_move_with_the_mesh(spec, move):
    mesh = FACE if "permuted" in spec else MESHES["potato"]
    power, tolerance = POWERS[spec]
    a, b = (int(np.flatnonzero(move.numbers(mesh)[0] == vertex)[0]) for vertex in (12, 31))
    found, expected = abfm.function(move.mesh(mesh), spec.format(a=a, b=b)), spec.format(a=12, b=31)
    assert_alike(found, move.function(mesh, abfm.function(mesh, expected), power), tolerance)


@pytest.mark.parametrize(
    "mesh", [square(6), disc(4), open_cylinder(12, 4)], ids=["square", "disc", "cylinder"]
)
@examples(8)
@given(move=MOVES, far=st.sampled_from([1.0, 1e3, 1e6]))
def test_flat_surfaces_have_curvature_0(mesh, move, far):
    shift = tuple(far * x for x in move.shift)
    other = Move(move.turn, move.scale, shift, move.seed).mesh(mesh)
    assert not abfm.function(other, "curvature:gaussian").any()
    is_flat = np.ptp(mesh.vertices[:, 2]) == 0
    assert is_flat == (not abfm.function(other, "curvature:mean").any())


@pytest.mark.parametrize(
    "mesh", [icosphere(1), icosphere(2), MESHES["torus"], open_cylinder(12, 4)]
)
@examples(4)
@given(move=MOVES)
def test_shape_diameter_moves_with_a_mesh_of_equal_edges(mesh, move):
    found, expected = (abfm.function(m, "shape-diameter") for m in (move.mesh(mesh), mesh))
    assert_alike(found, move.function(mesh, expected, 1), SOLVES)


@pytest.mark.parametrize(
    "changes",
    [{}, {"preconditioner": "none", "refine": 0}, {"method": "linearised", "refine": 0}],
    ids=str,
)
@examples(3)
@given(name=BY_NAME, move=MOVES)
def test_matches_move_with_the_mesh(changes, name, move):
    """Matches have few iterations, because rounding errors grow with each one."""
    mesh, other = MESHES[name], move.mesh(MESHES[name])
    f, g = bump(mesh, mesh.vertices[3], 0.3), bump(mesh, mesh.vertices[20], 0.3)
    parameters = abfm.Parameters.of(iterations=4, **changes)
    expected = abfm.match(mesh, f, g, parameters)
    found = abfm.match(other, move.function(mesh, f), move.function(mesh, g), parameters)
    assert_alike(found.velocity[0], move.field(mesh, expected.velocity[0]), SOLVES)
    assert_alike(found.energy_history, expected.energy_history, SOLVES)
    assert found.residual == pytest.approx(expected.residual, rel=SOLVES)
    assert found.verified_residual == pytest.approx(expected.verified_residual, rel=SOLVES)
    assert found.verdict.kind == expected.verdict.kind
