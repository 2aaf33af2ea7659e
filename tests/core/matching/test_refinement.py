"""Problems, fields and matches on midpoint subdivisions of a mesh."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm import AbfmError, Flow, Parameters, Problem, function, load, match
from abfm.calculus import face_areas
from abfm.flow import ContinuousFlow, flow_lines
from abfm.maps import SurfacePoints
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh.subdivision import interpolated, mean_of_children, refined, to_children, to_parents
from tests.core.fields import bump, rotation_field, wavy_field
from tests.messages import raises
from tests.shapes import icosphere, square, with_loose_vertex

BALL = icosphere(2)
SPECS = "gaussian:vertex=3,width=0.2", "gaussian:vertex=20,width=0.2"


def random_points(mesh, count=200):
    random = np.random.default_rng(1)
    faces = random.integers(len(mesh.faces), size=count)
    return SurfacePoints(mesh, faces, random.dirichlet([0.3] * 3, count))


@pytest.mark.parametrize("k", [0, 1, 3])
def test_points_on_subdivisions_round_trip(k):
    points = random_points(BALL)
    there = to_children(points.faces, points.barycentric, k)
    assert_allclose(SurfacePoints(refined(BALL, k), *there).positions, points.positions, atol=1e-13)
    faces, weights = to_parents(*there, k)
    assert_array_equal(faces, points.faces)
    assert_allclose(weights, points.barycentric, atol=1e-12)
    linear = BALL.vertices @ [1.0, 2, 3]
    on_fine = SurfacePoints(refined(BALL, k), *there).pull_back(interpolated(BALL, linear, k))
    assert_allclose(on_fine, points.pull_back(linear), atol=1e-12)


def test_mean_of_children_is_weighted_by_area():
    """The mean inverts copying to child faces, and is its adjoint in L2."""
    field = wavy_field(BALL, 0)
    assert_allclose(mean_of_children(np.repeat(field, 16, axis=0)[None], len(field))[0], field)
    fine, random = refined(BALL, 2), np.random.default_rng(0).normal(size=(1, 16 * len(field), 3))
    weighted = face_areas(fine)[:, None] * random[0]
    by_areas = weighted.reshape(-1, 16, 3).sum(axis=1) / face_areas(BALL)[:, None]
    mean = mean_of_children(random, len(field))[0]
    assert_allclose(mean, by_areas, atol=1e-12)
    copied = np.vdot(weighted, np.repeat(field, 16, axis=0))
    assert copied == pytest.approx(np.vdot(face_areas(BALL)[:, None] * mean, field))


@pytest.mark.parametrize("method", ["nonlinear", "linearised"])
@pytest.mark.parametrize("k", [1, 2])
def test_flow_of_finer_fields_uses_the_finer_mesh(k, method):
    fine, count = refined(BALL, k), len(BALL.vertices)
    fields = np.stack([0.1 * wavy_field(fine, seed) for seed in (0, 1)])
    here, there = Flow(BALL, fields, 2.0, method), Flow(fine, fields, 2.0, method)
    f = np.random.default_rng(0).normal(size=(count, 2))
    times = [-0.5, 0.3, 1.5, 3.0]
    pushed = there.push(interpolated(BALL, f, k), times)
    assert_array_equal(here.push(f, times), pushed[:, :count])
    assert here.velocity.shape == (2, len(BALL.faces), 3)
    assert_array_equal(here.fine_velocity, fields)
    assert here.functional_map(5).shape == (5, 5)
    assert here.point_map().codomain is BALL
    assert len(here.distortion().area) == len(BALL.faces)
    lines, finer = ContinuousFlow(BALL, fields, 2.0), ContinuousFlow(fine, fields, 2.0)
    for name in ("origins", "destinations"):
        points = getattr(lines, name)()
        assert points.mesh is BALL
        expected = getattr(finer, name)().positions[:count]
        assert_allclose(points.positions, expected, atol=1e-9)


def test_flow_lines_of_finer_fields_use_the_finer_mesh():
    fine, points = refined(BALL, 1), random_points(BALL, 5)
    field = wavy_field(fine, 2)
    there = SurfacePoints(fine, *to_children(points.faces, points.barycentric))
    for line, other in zip(
        flow_lines(BALL, field, points, 0.5), flow_lines(fine, field, there, 0.5), strict=True
    ):
        assert_allclose(line.positions, other.positions, atol=1e-12)
        positions = SurfacePoints(BALL, line.faces, line.barycentric).positions
        assert_allclose(positions, line.positions, atol=1e-12)


@pytest.mark.parametrize("faces", [1, 319, 2 * 320, 3 * 320])
def test_fields_with_a_wrong_number_of_faces_are_refused(faces):
    with raises(AbfmError, "velocity", faces, 320, 1280):
        Flow(BALL, np.zeros((faces, 3)))


def test_refined_problem_extends_the_problem():
    random = np.random.default_rng(0)
    f, g = random.normal(size=(2, len(BALL.vertices), 2))
    start, mask = wavy_field(BALL, 0)[None], random.uniform(0, 1, len(BALL.vertices))
    given = Problem(BALL, f, g, mask=mask, weights=[1, 2], start=start)
    once, twice = given.subdivided(), given.refined(2)
    assert once is given.refined(1)
    assert given.refined(0) is given
    assert twice.digest == once.subdivided().digest
    for k, problem in ((1, once), (2, twice)):
        assert problem.mesh is refined(BALL, k)
        assert_array_equal(problem.source, interpolated(BALL, f, k))
        assert_array_equal(problem.target[: len(f)], g)
        assert_array_equal(problem.mask[: len(f)], mask)
        assert_array_equal(problem.weights, given.weights)
        assert problem.functions.function_size == given.functions.function_size
        assert problem.start.shape == (1, 4**k * len(BALL.faces), 3)
    assert_array_equal(once.mask[len(f) :], mask[BALL.edges].min(axis=1))


def test_other_data_terms_are_interpolated():
    f, g, mask = np.random.default_rng(0).uniform(size=(3, len(BALL.vertices)))
    given = Problem(BALL, f, g, terms=[FunctionTerm(BALL.normalized(), g, f, mask)])
    _, term = given.refined(2).terms
    for values, expected in ((term.source[0], g), (term.target[0], f), (term.mask, mask)):
        assert_allclose(values, interpolated(BALL, expected, 2), rtol=1e-12)
    assert term.mesh is refined(BALL, 2).normalized()


def test_refined_start_is_more_accurate_than_copies():
    for k in (0, 1):
        ball = refined(icosphere(3), k)
        axis, mesh = [0.3, 0.5, 1], refined(ball, 1)
        problem = Problem(ball, ball.vertices[:, 0], ball.vertices[:, 1])
        there = problem.starting_from(rotation_field(ball, axis)).subdivided().start[0]
        exact = rotation_field(mesh, axis)
        copied = np.repeat(rotation_field(ball, axis), 4, axis=0)
        assert np.abs(there - exact).max() < 0.35 * np.abs(copied - exact).max()


def test_finer_start_is_used_on_its_own_mesh():
    """A start on a subdivision is used there; on the mesh itself, its mean over child faces."""
    finer = wavy_field(refined(BALL, 2), 3)[None]
    given = Problem(BALL, *np.eye(2, len(BALL.vertices)), start=finer)
    assert_array_equal(given.start, mean_of_children(finer, len(BALL.faces)))
    assert_array_equal(given.refined(2).start, finer)
    assert given.refined(2).refined(1).start.shape == (1, 64 * len(BALL.faces), 3)
    with raises(AbfmError, "start"):
        Problem(BALL, *np.eye(2, len(BALL.vertices)), start=finer[:, 1:])


def test_specs_are_evaluated_on_finer_meshes(tmp_path):
    np.save(tmp_path / "v.npy", values := np.arange(len(BALL.vertices), dtype=float))
    from_file = f"file:{tmp_path / 'v.npy'}"
    evaluated = ["gaussian:vertex=3,width=0.2", "coordinate:x + geodesic:vertex=7"]
    others = [from_file, f"{from_file} + coordinate:x", "curvature:mean", "eigenfunction:7"]
    problem = Problem(BALL, evaluated[0], [1.0] * len(values))
    fine = refined(BALL, 1)
    for k in (1, 2):
        expected = function(refined(BALL, k), evaluated[0])
        assert_array_equal(problem.refined(k).source[:, 0], expected)
    several = Problem(BALL, [*evaluated, *others], [*evaluated, *others]).subdivided()
    for channel, spec in enumerate(evaluated):
        assert_array_equal(several.source[:, channel], function(fine, spec))
    for channel, spec in enumerate(others, len(evaluated)):
        expected = interpolated(BALL, function(BALL, spec))
        assert np.allclose(several.source[:, channel], expected) or spec == "eigenfunction:7"
    other_values = Problem(BALL, -function(BALL, evaluated[0]), values)
    other_values = other_values.with_specs([evaluated[0]], [""])
    assert_array_equal(
        other_values.subdivided().source[:, 0],
        interpolated(BALL, -function(BALL, evaluated[0])),
        "values that differ from those of the spec",
    )


def test_vertex_numbers_include_loose_vertices():
    mesh = with_loose_vertex(BALL)
    fine = Problem(mesh, *SPECS).subdivided()
    assert_array_equal(fine.source[:, 0], function(fine.mesh, SPECS[0]))
    assert fine.source[:, 0].argmax() == Problem(mesh, *SPECS).source[:, 0].argmax()


def test_specs_are_part_of_digest_files_and_copies(tmp_path):
    plain = Problem(BALL, *(function(BALL, spec) for spec in SPECS))
    named = Problem(BALL, *SPECS)
    assert named.digest != plain.digest == plain.with_specs([""], [""]).digest
    assert named.digest == plain.with_specs([SPECS[0]], [SPECS[1]]).digest
    named.save(tmp_path / "p.npz")
    copies = load(tmp_path / "p.npz"), pickle.loads(pickle.dumps(named))
    for copy in copies:
        assert (copy.digest, copy.specs) == (named.digest, named.specs)
        assert copy.subdivided().digest == named.subdivided().digest
    assert not any(map(any, named.with_specs(["file:\x07.npy"], [""]).specs))
    with raises(AbfmError, 2, 1):
        plain.with_specs(SPECS, SPECS)


@pytest.fixture(scope="module")
def fine_match():
    """Return a match that was computed on the subdivision, as a match of the mesh."""
    problem = Problem(BALL, *SPECS, Parameters.of(iterations=20, refine=0))
    found, count = match(problem.subdivided()), len(BALL.vertices)
    return replace(found, problem=problem, advected=found.advected[:count], path=())


def test_refined_match_is_verified_on_the_finer_mesh(fine_match):
    """Fields and checks are those of the finer mesh; velocity and values refer to the mesh."""
    found, count = fine_match, len(BALL.vertices)
    assert (found.refined, found.fine.refined) == (1, 0)
    assert found.velocity.shape == (1, len(BALL.faces), 3)
    assert found.fine.mesh is refined(BALL, 1)
    assert_array_equal(found.fine.velocity, found.fine_velocity)
    assert_allclose(found.advect(1.0), found.advected[:, 0], atol=1e-7)
    assert found.advect([0.5, 1]).shape == (2, count)
    assert_array_equal(found.verify().flow_lines, found.fine.verify().flow_lines)
    residual = found.fine.problem.functions.residual(found.fine.advected.T)
    assert residual == pytest.approx(found.residual, rel=1e-6)
    again = match(found.problem.starting_from(found.start_for(Parameters())).subdivided())
    assert again.residual <= found.residual * (1 + 1e-9)


def test_files_store_the_finer_field_and_its_mean(fine_match, tmp_path):
    path = tmp_path / "m.npz"
    fine_match.save(path)
    with np.load(path) as file:
        assert file["velocity"].shape == (1, len(BALL.faces), 3)
        assert file["fine_velocity"].shape == (1, 4 * len(BALL.faces), 3)
    loaded = load(path)
    assert_array_equal(loaded.fine_velocity, fine_match.fine_velocity)
    assert loaded.problem.digest == fine_match.problem.digest
    assert loaded.path[0].velocity is loaded.fine_velocity
    plain = match(square(4), *np.eye(2, 25), Parameters.of(iterations=2, refine=0))
    plain.save(path)
    with np.load(path) as file:
        assert "fine_velocity" not in file
    assert abfm.load(path).fine is not None


def test_step_of_another_level_is_a_match_there(fine_match):
    coarse = match(fine_match.problem)
    both = replace(coarse, path=(*fine_match.path, coarse.path[coarse.step]), step=1)
    earlier = both.at_step(0)
    assert (earlier.refined, earlier.residual) == (1, fine_match.residual)
    assert_allclose(earlier.advected, fine_match.advected, atol=1e-7)


def test_finer_mesh_has_less_dispersion():
    ball = icosphere(3)
    errors = []
    for k in (0, 1, 2):
        flow = Flow(ball, rotation_field(refined(ball, k), [0, 0, 0.5]))
        turn = np.array([[np.cos(0.5), np.sin(0.5), 0], [-np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
        centre = np.array([1.0, 0, 0])
        problem = Problem(ball, bump(ball, centre, 0.1), bump(ball, turn.T @ centre, 0.1))
        advected = flow.push(problem.source)
        errors.append(problem.functions.residual(advected.T))
    assert errors[1] < 0.75 * errors[0]
    assert errors[2] < errors[1]
