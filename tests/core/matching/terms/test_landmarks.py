from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import abfm
from abfm.calculus.operators import face_frames
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import AbfmError, ParameterError
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.levels import Transfer
from abfm.matching.terms.landmarks import landmarks_of, residual_of_errors
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import coarsened
from abfm.workers.control import controlled
from tests.core.fields import bump, rotation_field, wavy_field
from tests.core.surfaces import SURFACES, moved
from tests.core.verification import near, taylor_order
from tests.messages import raises
from tests.shapes import icosphere

SPHERE = icosphere(3)
PAIRS = np.array([[0, 17], [40, 300], [77, 78], [200, 500]])
UNIT = SPHERE.normalized()


def fields(mesh, count, seed, speed=0.2):
    return to_frame(mesh, np.stack([speed * wavy_field(mesh, seed + n) for n in range(count)]))


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("name", ["ellipsoid", "torus", "genus two", "hemisphere", "cylinder"])
def test_derivative_of_landmark_energy_is_exact(name, count):
    mesh = SURFACES[name].normalized()
    term = landmarks_of(mesh, PAIRS[:3] % len(mesh.vertices), [1.0, 0.5, 2.0])

    def evaluate(x):
        found = term.misfit(x, 1.2, 0.3)
        return found.energy, found.differentiate()

    x, step = fields(mesh, count, 1), 1e-5 * fields(mesh, count, 30)
    assert taylor_order(evaluate, x, step) > 1.9
    found = term.misfit(x, 1.2, 0.3)
    assert found.energy == pytest.approx(float(term.weights @ found.errors**2) / (2 * 0.09))
    curvature = term.curvature(x, 1.2, 0.3)
    gradient = curvature.jacobian.T @ (curvature.weights * curvature.residuals)
    assert_allclose(gradient.reshape(x.shape), found.differentiate(), atol=1e-12)


def test_derivative_with_functions_is_exact():
    f, g = (bump(SPHERE, SPHERE.vertices[i], 0.2) for i in (0, 30))
    p = abfm.Parameters(sigma=0.2, landmark_sigma=0.1)
    problem = abfm.Problem(SPHERE, f, g, p, landmarks=PAIRS)
    energy = MatchingEnergy(problem)
    field, step = (to_ambient(UNIT, fields(UNIT, 1, seed)) for seed in (2, 40))
    assert taylor_order(energy, field, 1e-4 * step) > 1.9
    found = energy.objective(0.2).evaluate(to_frame(UNIT, field))
    assert energy.term_names == ("closeness", "landmarks")
    assert found.energy == pytest.approx(found.regularity + sum(found.term_energies))
    functions_only = MatchingEnergy(abfm.Problem(SPHERE, f, g, problem.parameters))
    without = functions_only.objective(0.2).evaluate(to_frame(UNIT, field))
    assert found.term_energies[0] == without.term_energies[0]
    misfit = problem.landmarks.misfit(to_frame(UNIT, field), 1.0, 0.1)
    assert_allclose(found.gradient, without.gradient + misfit.differentiate(), atol=1e-12)
    of_functions = problem.functions.residual(found.advected)
    assert energy.residual_at(found) == max(of_functions, residual_of_errors(misfit.errors))


def test_rotation_moves_landmarks_to_known_points():
    turn = Rotation.from_rotvec([0, 0, 0.7]).as_matrix()
    ends = abfm.maps.project_onto_surface(SPHERE, SPHERE.vertices[PAIRS[:, 0]] @ turn.T)
    term = landmarks_of(SPHERE, (vertex_points(SPHERE, PAIRS[:, 0]), ends), None)
    x = to_frame(UNIT, rotation_field(UNIT, [0, 0, 0.7]))[None]
    assert term.misfit(x, 1.0, 1.0).errors.max() < 2e-3
    away = np.linalg.norm(SPHERE.vertices[PAIRS[:, 0], :2], axis=1) / SPHERE.length_scale
    assert_allclose(term.initial_errors, 0.7 * away, rtol=0.05, atol=0.01)
    assert term.misfit(x, 1.0, 0.1).energy < 1e-3 * term.misfit(0 * x, 1.0, 0.1).energy


def test_gradient_without_motion_points_to_targets():
    """The gradient of half the squared distance is minus the logarithm map, at any distance."""
    term = landmarks_of(UNIT, PAIRS, None)
    rest = np.zeros((1, len(UNIT.faces), 2))
    curvature = term.curvature(rest, 1.0, 1.0)
    away = curvature.residuals.reshape(-1, 2)
    assert_allclose(np.linalg.norm(away, axis=1), term.initial_errors, rtol=0.1)
    frames = face_frames(UNIT)[term.faces[:, 0]]
    away = np.einsum("lk,lkx->lx", away, frames)
    here, there = (UNIT.vertices[column] for column in PAIRS.T)
    along = there - here * (np.einsum("lx,lx->l", here, there) / (here**2).sum(axis=1))[:, None]
    products = np.einsum("lx,lx->l", away, along)
    sizes = np.linalg.norm(away, axis=1) * np.linalg.norm(along, axis=1)
    assert (products < -0.97 * sizes).all()


@pytest.mark.parametrize("scale", [1e-6, 1e9])
def test_errors_are_invariant_to_motion_and_unit(scale):
    rotation = Rotation.from_rotvec([0.4, -0.2, 1.0]).as_matrix()
    mesh = SURFACES["torus"]
    other = moved(mesh, rotation, scale)
    pairs = PAIRS % len(mesh.vertices)
    one, two = (landmarks_of(each, pairs, None) for each in (mesh, other))
    x = fields(mesh.normalized(), 2, 3)
    field = to_ambient(mesh.normalized(), x) @ rotation.T
    y = to_frame(other.normalized(), field)
    assert_allclose(two.misfit(y, 1.0, 1.0).errors, one.misfit(x, 1.0, 1.0).errors, rtol=1e-6)


def test_landmarks_on_other_meshes_are_the_same_points():
    rng = np.random.default_rng(1)
    pair = tuple(
        SurfacePoints(SPHERE, rng.integers(1280, size=4), rng.dirichlet(np.ones(3), 4))
        for _ in range(2)
    )
    problem = abfm.Problem(SPHERE, None, None, landmarks=pair, landmark_weights=[1, 2, 0, 3])
    fine = problem.subdivided()
    assert fine.landmarks.mesh is fine.mesh.normalized()
    for there, here in zip(
        (fine.landmarks.points(fine.mesh), fine.landmarks.targets(fine.mesh)), pair, strict=True
    ):
        near(there.positions, here.positions, 1e-12)
    coarse = coarsened(UNIT, 160)
    found = abfm.Problem(UNIT, None, None, landmarks=PAIRS).restricted(Transfer(coarse, UNIT))
    assert found.landmarks.mesh is found.mesh.normalized()
    near(found.landmarks.points(coarse).positions, UNIT.vertices[PAIRS[:, 0]], 0.03)
    assert np.array_equal(fine.landmarks.weights, [1, 2, 0, 3])


def test_landmark_of_weight_zero_is_ignored():
    term = landmarks_of(SPHERE, PAIRS, [1, 0, 0, 0])
    alone = landmarks_of(SPHERE, PAIRS[:1], None)
    x = fields(UNIT, 1, 4)
    one, other = (each.misfit(x, 1.0, 0.1) for each in (term, alone))
    assert one.energy == pytest.approx(other.energy)
    assert_allclose(one.differentiate(), other.differentiate(), atol=1e-12)


ON_OTHER = vertex_points(icosphere(1), [0, 1])


@pytest.mark.parametrize(
    ("given", "weights", "named"),
    [
        ([0, 1], None, ("(2,)", 2)),
        ([[0, 642]], None, (642, 0, 641)),
        ([[0, -1]], None, (-1,)),
        ([[0, 1.5]], None, ("1.5",)),
        ([[0, np.nan]], None, ()),
        (np.zeros((0, 2)), None, ()),
        ("ab", None, ()),
        ((ON_OTHER, ON_OTHER), None, (80,)),
        ((vertex_points(SPHERE, [0]), [1]), None, ("SurfacePoints",)),
        ((vertex_points(SPHERE, [0]), vertex_points(SPHERE, [0, 1])), None, (1, 2)),
        ((vertex_points(SPHERE, [0]),), None, (1,)),
        (PAIRS, [1, 2], ("(2,)", "(4,)")),
        (PAIRS, [1, -2, 1, 1], ()),
        (PAIRS, [0, 0, 0, 0], ()),
        (PAIRS, [1, np.inf, 1, 1], ()),
        (PAIRS, [1e-40, 0, 0, 0], ()),
        (None, [1, 2], ("landmark_weights",)),
    ],
)
def test_invalid_landmarks_are_refused(given, weights, named):
    f = SPHERE.vertices[:, 0]
    with raises(AbfmError, *named):
        abfm.Problem(SPHERE, f, f, landmarks=given, landmark_weights=weights)


def test_vertex_numbers_refer_to_the_given_mesh():
    """A pair of arrays also counts vertices without faces; a mesh counts its own rows."""
    pair = np.vstack([[[9.0, 9, 9]], SPHERE.vertices]), SPHERE.faces + 1
    expected = abfm.Problem(SPHERE, None, None, landmarks=PAIRS).landmarks
    for mesh, given in ((pair, PAIRS + 1), (TriangleMesh(*pair), PAIRS)):
        found = abfm.Problem(mesh, None, None, landmarks=given).landmarks
        assert_allclose(found.initial_errors, expected.initial_errors)
    with raises(ParameterError, 0):
        abfm.Problem(pair, None, None, landmarks=PAIRS)


def test_functions_are_required_without_landmarks():
    with pytest.raises(AbfmError):
        abfm.Problem(SPHERE, None, None)
    with pytest.raises(AbfmError):
        abfm.Problem(SPHERE, SPHERE.vertices[:, 0], None, landmarks=PAIRS)
    with raises(ParameterError, "landmark_sigma", 0):
        abfm.Parameters(landmark_sigma=0)
    assert replace(abfm.Parameters(), landmark_sigma=0.2).landmark_sigma == 0.2


def test_too_long_flow_lines_have_infinite_energy():
    energy = MatchingEnergy(abfm.Problem(SPHERE, None, None, landmarks=PAIRS))
    x = 1e6 * fields(UNIT, 1, 1)
    assert energy.objective(0.1).evaluate(x).energy == np.inf
    assert energy.residual_of(x, energy.terms.sources) == np.inf


def test_landmarks_of_a_scaled_mesh_are_accepted():
    large = TriangleMesh(10 * SPHERE.vertices, SPHERE.faces)
    pair = vertex_points(SPHERE, PAIRS[:, 0]), vertex_points(SPHERE, PAIRS[:, 1])
    one, other = landmarks_of(large, pair, None), landmarks_of(large, PAIRS, None)
    assert_allclose(one.initial_errors, other.initial_errors)


def test_functions_of_weight_zero_are_only_advected():
    f, g = (bump(SPHERE, SPHERE.vertices[i], 0.2) for i in (0, 30))
    alone = abfm.match(abfm.Problem(SPHERE, None, None, landmarks=PAIRS[:2]))
    together = abfm.match(abfm.Problem(SPHERE, f, g, weights=[0.0], landmarks=PAIRS[:2]))
    assert together.problem.is_of_landmarks
    assert_allclose(together.velocity, alone.velocity)
    assert (together.verdict, together.residual) == (alone.verdict, alone.residual)
    assert_allclose(together.advected[:, 0], together.advect(1.0), atol=1e-12)
    assert np.linalg.norm(together.advected[:, 0] - f) > 0.1 * np.linalg.norm(f)
    with raises(ParameterError, "weights"):
        abfm.Problem(SPHERE, f, g, weights=[0.0])


def test_files_store_functions_of_weight_zero(tmp_path):
    f = bump(SPHERE, SPHERE.vertices[0], 0.2)
    problem = abfm.Problem(SPHERE, f, f, weights=[0.0], landmarks=PAIRS)
    problem.save(tmp_path / "p.npz")
    again = abfm.load(tmp_path / "p.npz")
    assert (again.digest, again.is_of_landmarks) == (problem.digest, True)


@pytest.mark.parametrize("iterations", [1, 3])
def test_cancelled_match_in_controlled_thread_has_a_field(iterations):
    """A match obeys the control of its thread, as in a process that is cancelled from outside."""
    control = abfm.workers.Control()

    def cancel(now):
        if now.iteration == iterations:
            control.cancel(skip_checks=True)

    with controlled(control):
        found = abfm.match(abfm.Problem(SPHERE, None, None, landmarks=PAIRS), on_iteration=cancel)
    assert found.stop_reason == "cancelled"
    assert found.velocity.any()
    assert found.landmark_errors.max() < found.problem.landmarks.initial_errors.max()
