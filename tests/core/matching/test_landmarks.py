import pickle

import numpy as np
import pytest

import abfm
from abfm.calculus.vector_fields import to_ambient
from abfm.errors import ResultError
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.io import results
from abfm.maps.surface_points import vertex_points
from abfm.matching import Cause
from abfm.matching.objective.regularizer import Regularizer
from tests.core.fields import bump
from tests.core.surfaces import SURFACES
from tests.core.verification import near
from tests.messages import check_message, raises
from tests.shapes import icosphere, torus, with_thin_triangles

SPHERE, SMALL = icosphere(3), icosphere(2)
ERROR_MAX = 0.005  # in sqrt(area)


def smooth_field(mesh, speed, seed):
    """Return noise that is smoothed by the norm of fields, (F, 3)."""
    unit, rng = mesh.normalized(), np.random.default_rng(seed)
    field = Regularizer(unit, 0.05, 2).inverse(rng.normal(size=(len(mesh.faces), 2)))
    field *= speed / np.linalg.norm(field, axis=1).max()
    return mesh.length_scale * to_ambient(unit, field)


def flowed(mesh, count, speed=0.3, seed=0):
    rng = np.random.default_rng(seed)
    start = vertex_points(mesh, rng.choice(len(mesh.vertices), count, replace=False))
    flow = ContinuousFlow(mesh, smooth_field(mesh, speed, seed), 1.0)
    return (start, flow.destinations(start)), flow


def assert_matched(found):
    assert found.verdict.kind == "matched"
    assert found.landmark_errors.max() <= ERROR_MAX
    assert found.folded == 0
    assert found.distortion().folded == 0


@pytest.fixture(scope="module")
def matched():
    pair, _ = flowed(SPHERE, 8)
    return abfm.match(abfm.Problem(SPHERE, None, None, landmarks=pair))


@pytest.mark.parametrize("name", ["torus", "genus two", "hemisphere"])
def test_landmarks_alone_are_matched(name):
    mesh = torus(24, 12) if name == "torus" else SURFACES[name]
    pair, _ = flowed(mesh, 12)
    found = abfm.match(abfm.Problem(mesh, None, None, landmarks=pair))
    assert_matched(found)
    assert found.problem.landmarks.initial_errors.max() > 0.1


def test_errors_are_those_of_flow_lines(matched):
    assert_matched(matched)
    marks = matched.problem.landmarks
    ends = ContinuousFlow(SPHERE, matched.velocity, 1.0).destinations(marks.points(SPHERE))
    straight = np.linalg.norm(ends.positions - marks.targets(SPHERE).positions, axis=1)
    near(matched.landmark_errors, straight / SPHERE.length_scale, 1e-4)
    assert matched.residual == pytest.approx(10 * matched.landmark_errors.max(), abs=0.005)
    assert matched.verified_residual == pytest.approx(10 * matched.landmark_errors.max())
    assert matched.initial_residual == pytest.approx(10 * marks.initial_errors.max())
    largest = 100 * matched.landmark_errors.max()
    check_message(matched.verdict.reason, 8, f"{largest:.2g}%")


def test_exchanged_and_distant_landmarks_match():
    opposite = int(np.argmin(SMALL.vertices @ SMALL.vertices[3]))
    for pairs in ([[0, 20], [20, 0]], [[3, opposite]]):
        found = abfm.match(abfm.Problem(SMALL, None, None, landmarks=pairs))
        assert_matched(found)


def test_functions_and_landmarks_match_together():
    pair, flow = flowed(SPHERE, 6, seed=2)
    f = bump(SPHERE, SPHERE.vertices[0], 0.25) + 0.6 * bump(SPHERE, SPHERE.vertices[90], 0.3)
    g = flow.origins().pull_back(f)
    iterations = []
    problem = abfm.Problem(SPHERE, f, g, landmarks=pair)
    found = abfm.match(problem, on_iteration=iterations.append)
    assert_matched(found)
    assert problem.functions.residual(found.advected.T) <= 0.05
    check_message(found.verdict.reason, 6, f"{100 * found.landmark_errors.max():.2g}%")
    assert all(list(now.term_energies) == ["closeness", "landmarks"] for now in iterations)
    assert all(sum(now.term_energies.values()) == now.mismatch_energy for now in iterations)
    alone = abfm.match(SPHERE, f, g)
    assert alone.landmark_errors is None
    errors = problem.landmarks.errors(alone.flow._lines.destinations(pair[0]))
    assert errors.max() > 2 * ERROR_MAX
    at_first = found.at_step(0)
    assert at_first.landmark_errors.max() > found.landmark_errors.max()


def test_landmark_errors_are_consistent(tmp_path):
    mesh = with_thin_triangles(SMALL)
    pairs = np.random.default_rng(3).choice(len(SMALL.vertices), (4, 2), replace=False)
    found = abfm.match(abfm.Problem(mesh, None, None, landmarks=pairs))
    worst = 10 * found.landmark_errors.max()
    assert found.residual == pytest.approx(worst, rel=1e-6)
    assert found.verified_residual == pytest.approx(worst, rel=1e-6)
    found.save(tmp_path / "m.npz")
    loaded = abfm.load(tmp_path / "m.npz")
    assert not loaded.load_warning
    assert loaded.residual == found.residual
    for step in range(len(found.path)):
        assert not found.at_step(step).load_warning


def test_coarser_mesh_leads_to_the_mesh_itself():
    pair, _ = flowed(SPHERE, 5, seed=3)
    p = abfm.Parameters.of(levels=2)
    found = abfm.match(abfm.Problem(SPHERE, None, None, p, landmarks=pair))
    assert_matched(found)
    assert found.velocity.shape == (1, len(SPHERE.faces), 3)


def test_start_continues_and_failures_have_advice(matched):
    problem = matched.problem
    short = abfm.match(problem.with_parameters(abfm.Parameters.of(iterations=2)))
    assert short.verdict.kind == "not reached"
    check_message(short.verdict.reason, 2)
    again = abfm.match(problem.starting_from(matched.velocity))
    assert_matched(again)
    assert len(again.energy_history) <= 3
    loose = abfm.Parameters.of(landmark_sigma=3.0, segments=1)
    failed = abfm.match(problem.with_parameters(loose))
    assert failed.verdict.kind == "not reached"
    assert failed.verdict.cause is Cause.LANDMARKS_NOT_REACHED
    assert failed.verdict.remedies[0].parameters == {"landmark_sigma": 1.0}
    assert failed.landmark_errors.max() > 10 * ERROR_MAX


def test_smaller_landmark_sigma_lowers_errors():
    pair, _ = flowed(SMALL, 4)
    errors = []
    for sigma in (1.0, 0.3, 0.1):
        p = abfm.Parameters.of(landmark_sigma=sigma, segments=1)
        found = abfm.match(abfm.Problem(SMALL, None, None, p, landmarks=pair))
        errors.append(found.landmark_errors)
    assert errors[0].max() > 2 * errors[1].max() > 4 * errors[2].max()


def test_landmarks_survive_files_and_pickling(matched, tmp_path):
    matched.save(tmp_path / "m.npz")
    loaded = abfm.load(tmp_path / "m.npz")
    assert not loaded.load_warning
    assert loaded.verdict == matched.verdict
    assert np.array_equal(loaded.landmark_errors, matched.landmark_errors)
    assert loaded.problem.digest == matched.problem.digest
    arrays = results.load_arrays(tmp_path / "m.npz")
    assert np.array_equal(arrays["landmark_errors"], matched.landmark_errors)
    matched.problem.save(tmp_path / "p.npz")
    for other in (abfm.load(tmp_path / "p.npz"), pickle.loads(pickle.dumps(matched.problem))):
        assert other.digest == matched.problem.digest
        assert other.landmarks.mesh is other.mesh.normalized()
        near(other.landmarks.initial_errors, matched.problem.landmarks.initial_errors, 0)


def test_incomplete_file_is_refused(matched, tmp_path):
    arrays = matched.problem.arrays()
    del arrays["landmark_faces"]
    results.save_arrays(tmp_path / "p.npz", arrays, results.PROBLEM)
    with raises(ResultError, "landmark_faces"):
        abfm.load(tmp_path / "p.npz")
    arrays = matched.problem.arrays()
    arrays["landmark_faces"] = arrays["landmark_faces"] + len(SPHERE.faces)
    results.save_arrays(tmp_path / "q.npz", arrays, results.PROBLEM)
    with raises(ResultError):
        abfm.load(tmp_path / "q.npz")


def test_digest_depends_on_landmarks_and_weights():
    f = np.linspace(0.0, 1.0, 162)
    plain = abfm.Problem(icosphere(2), f, f[::-1])
    digests = {
        plain.digest,
        plain.with_parameters(abfm.Parameters(landmark_sigma=0.5)).digest,
        abfm.Problem(icosphere(2), f, f[::-1], landmarks=[[0, 1]]).digest,
        abfm.Problem(icosphere(2), f, f[::-1], landmarks=[[0, 2]]).digest,
        abfm.Problem(icosphere(2), f, f[::-1], landmarks=[[0, 2]], landmark_weights=[2]).digest,
    }
    assert len(digests) == 5
    assert plain._with(landmarks=None).digest == plain.digest


def test_match_of_landmarks_is_deterministic(matched):
    again = abfm.match(matched.problem)
    assert np.array_equal(again.velocity, matched.velocity)
