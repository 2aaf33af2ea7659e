"""Registration of two surfaces: rotations of spheres, initial maps, and matches on B."""

import numpy as np
import pandas
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import abfm
from abfm import Correspondence, Parameters, PointMap, Registration, TriangleMesh, load, register
from abfm.errors import AbfmError, FunctionError, MeshError, ParameterError, ResultError
from abfm.io.exports import export_ply
from abfm.maps.spherical import SphereLayout
from abfm.matching import Cause
from abfm.matching.task import facts_of_file
from abfm.mesh.shapes import even_sphere
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.sphere_rotations import (
    SphereFunctions,
    rotation_by_functions,
    rotation_by_landmarks,
)
from abfm.registration.register import MEASURED_PARAMETERS, prepare
from tests.messages import check_message, raises
from tests.shapes import icosphere, with_loose_vertex

A, B = even_sphere(3000), icosphere(4)
TURN = Rotation.from_rotvec([0.4, -0.9, 0.3])
OPPOSITE = int((B.vertices @ B.vertices[0]).argmin())


def hills(directions, seed=0, count=300, width=0.15):
    """Return a rough function of directions (P, 3), which looks like a measured one."""
    rng = np.random.default_rng(seed)
    centres, heights = rng.normal(size=(count, 3)), rng.normal(size=count)
    centres /= np.linalg.norm(centres, axis=1)[:, None]
    return np.exp((directions @ centres.T - 1) / width**2) @ heights


def on_sphere(mesh, turn=None, **others):
    directions = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    rotated = directions if turn is None else turn.inv().apply(directions)
    return SphereFunctions(SphereLayout(mesh, directions), hills(rotated)[None], **others)


@pytest.mark.parametrize("seed", range(2))
def test_rotation_between_spheres_is_found(seed):
    turn = Rotation.random(rng=seed)
    found = rotation_by_functions(on_sphere(A), on_sphere(B, turn), np.ones(1))
    assert (found.rotation * turn.inv()).magnitude() < np.radians(0.5)
    assert found.correlation > 0.97
    assert found.runner_up < 0.8
    assert_allclose(found.degrees, np.degrees(found.rotation.magnitude()))


def test_sphere_is_not_rotated_without_a_gain():
    def heights(mesh, values):
        return SphereFunctions(SphereLayout(mesh, mesh.vertices), values[None])

    known = heights(B, B.vertices[:, 2])
    found = rotation_by_functions(heights(A, 1e160 * A.vertices[:, 2]), known, np.ones(1))
    assert found.degrees == 0
    assert found.correlation > 0.999
    assert found.runner_up > 0.9
    constant = rotation_by_functions(heights(A, np.full(3000, 0.1)), known, np.ones(1))
    assert constant.degrees == 0
    assert constant.correlation == 0


def test_opposite_sign_is_found():
    b = on_sphere(B, TURN)
    found = rotation_by_functions(on_sphere(A), SphereFunctions(b.layout, -b.functions), np.ones(1))
    assert (found.rotation * TURN.inv()).magnitude() < np.radians(0.5)
    assert found.correlation > 0.97
    prepared = prepare(A, B, A.vertices[:, 2], B.vertices @ [0.6, 0, 0.8])
    assert not any("sign of channel" in note for note in prepared.notes)
    assert_allclose(prepared.initial.points.positions[:, 2], B.vertices @ [0.6, 0, 0.8], atol=0.05)


def test_hidden_values_do_not_affect_the_rotation():
    b = on_sphere(B, TURN)
    hidden = B.vertices[:, 2] > 0.6
    b.functions[0, hidden] = 50
    found = rotation_by_functions(
        on_sphere(A), SphereFunctions(b.layout, b.functions, 1.0 - hidden), np.ones(1)
    )
    assert (found.rotation * TURN.inv()).magnitude() < np.radians(0.5)


def test_three_landmarks_determine_the_rotation():
    layouts = SphereLayout(A, A.vertices), SphereLayout(B, TURN.apply(B.vertices.copy()))
    on_a = layouts[0].locate(np.eye(3))
    on_b = layouts[1].locate(TURN.apply(np.eye(3)))
    found = rotation_by_landmarks(*layouts, Landmarks(on_a, on_b, np.ones(3), ("x", "y", "z")))
    assert (found.rotation * TURN.inv()).magnitude() < 1e-6


def flowed(mesh, directions, strength=0.12):
    """Return directions moved by a smooth map of the sphere."""
    moved = directions + strength * np.sin(3 * directions[:, [1, 2, 0]])
    return moved / np.linalg.norm(moved, axis=1)[:, None]


@pytest.fixture(scope="module")
def same():
    return Correspondence.through_sphere(A, B, A.vertices, B.vertices)


@pytest.fixture(scope="module")
def found():
    f = hills(A.vertices)
    g = hills(flowed(B, TURN.inv().apply(B.vertices.copy())))
    parameters = Parameters.of(**{**MEASURED_PARAMETERS.to_dict(), "sigma": 2})
    return register(A, B, f, 3 * g + 7, parameters=parameters)


def test_rotation_and_flow_recover_a_map(found):
    expected = flowed(B, TURN.inv().apply(B.vertices.copy()))
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    before = np.linalg.norm(found.initial.points.positions - expected, axis=1)
    after = np.linalg.norm(found.points.positions - expected, axis=1)
    assert np.median(after) < 0.35 * np.median(before)
    assert found.distortion().folded == 0
    assert found.round_trip().median < 0.01
    assert found.coverage() == 1
    assert found.verdict.kind in ("registered", "matched", "nearly")
    check_message(found.notes[0])


def test_transfer_agrees_with_the_match(found):
    transferred = found.transfer(hills(A.vertices))
    expected = found.match.push(
        found.initial.transfer(hills(A.vertices)), found.match.parameters.tau
    )
    assert np.abs(transferred - expected).mean() < 0.1 * expected.std()


def test_earlier_steps_of_files_have_less_distortion(found, tmp_path):
    found.save(tmp_path / "r.npz")
    again = abfm.load(tmp_path / "r.npz")
    assert again.notes == found.notes != ()
    step = again.at_step(0)
    assert step.distortion().log2_area.mean < found.distortion().log2_area.mean
    assert step.functions is again.functions
    found.match.save(tmp_path / "m.npz")
    with raises(ResultError):
        abfm.load(tmp_path / "m.npz", Registration)


def test_warning_of_the_initial_map_is_the_verdict(found, tmp_path):
    assert found.facts.outcome.is_good
    warned = Registration(found.initial, found.match, (), found.functions, ("it may be wrong",))
    warned.save(tmp_path / "r.npz")
    for each in (warned, warned.at_step(warned.match.step), load(tmp_path / "r.npz")):
        assert (each.verdict.kind, each.verdict.cause) == ("not reached", Cause.INITIAL_MAP)
        assert each.verdict.why == "it may be wrong"
        assert "it may be wrong" in each.facts.warnings
        assert each.facts.outcome == "not reached"
        assert each.facts.lines[1:] == ["it may be wrong"]  # without the same text as a warning
    facts = facts_of_file(tmp_path / "r.npz")
    assert facts.outcome == "not reached"
    assert "it may be wrong" in facts.warnings


@pytest.mark.parametrize(("scale", "limit"), [(1, "1"), (1.5, "1.2"), (8, "")])
def test_advised_limit_of_distortion_is_reachable(found, monkeypatch, scale, limit):
    """A flow need not undo the distortion of the initial map."""
    first = found.initial.distortion()
    monkeypatch.setattr(Correspondence, "distortion", lambda _: first.scaled(scale))
    monkeypatch.setattr(Registration, "distortion", lambda _: first.scaled(4))
    advice = Registration(found.initial, found.match, (), found.functions).facts.advice
    assert advice.partition("max_distortion ")[2].partition(";")[0] == limit


def test_headline_of_landmarks_names_the_doubtful_map():
    """Landmarks that a flow reaches on B do not confirm the initial map."""
    found = register(B, B, landmarks=[[0, 0]], initial="connectivity")
    assert "landmark less than" in found.facts.headline
    warned = Registration(found.initial, found.match, (), None, ("it may be wrong",)).facts
    assert warned.headline == warned.short_headline == "not reached (the initial map may be wrong)"


def test_facts_are_those_of_the_complete_map(found):
    numbers, target = found.facts.numbers, found.match.problem.functions
    transferred = found.points.pull_back(found.functions)
    assert numbers["map_residual"] == pytest.approx(target.residual(transferred.T))
    alone = found.initial.points.pull_back(found.functions)
    assert numbers["initial_residual"] == pytest.approx(target.residual(alone.T))
    assert numbers["worse_residual"] >= numbers["map_residual"]
    distortion = found.distortion()
    assert numbers["log2_area_95"] == distortion.log2_area.p95
    assert numbers["folded_faces"] == distortion.folded == 0
    assert numbers["flipped_by_vertices"] == found.flipped_by_vertices() == 0


def test_residual_of_the_complete_map_counts(found):
    """Functions of A with noise, which the match on B does not see, are not reached."""
    values = found.functions + 9 * np.random.default_rng(0).normal(size=found.functions.shape)
    rough = Registration(found.initial, found.match, (), values)
    assert rough.verdict.kind == "not reached"
    assert rough.verdict.cause is Cause.COMPLETE_MAP
    assert rough.facts.numbers["worse_residual"] == pytest.approx(rough.residual)


@pytest.mark.parametrize(
    ("noise", "kind"), [(0.0, "matched"), (0.1, "nearly"), (1.0, "not reached")]
)
def test_verdict_is_that_of_the_complete_map(noise, kind):
    heights = B.vertices[:, 2]
    match = abfm.match(B, heights, heights, Parameters.of(iterations=1, refine=0))
    assert match.verdict.kind == "matched"
    values = heights + noise * heights.std() * np.random.default_rng(0).normal(size=len(heights))
    same = Correspondence.of_same_faces(B, B)
    found = Registration(same, match, (), values[:, None])
    assert found.verdict.kind == found.facts.outcome == kind


def test_faces_flipped_by_vertices_are_counted():
    """In a sphere.reg file, exchanging two vertices flips the faces between them."""
    order = np.arange(len(B.vertices))
    first, second = B.faces[0][:2]
    order[[first, second]] = second, first
    swapped = Correspondence(PointMap.of_vertices(B, B, order), PointMap.of_vertices(B, B, order))
    images = B.vertices[order][B.faces]
    outward = np.linalg.det(images) > 0
    assert swapped.flipped_by_vertices() == (~outward).sum() > 0
    same = Correspondence(PointMap.of_vertices(B, B), PointMap.of_vertices(B, B))
    assert same.flipped_by_vertices() == 0


def test_measured_functions_except_constants_are_standardized(same):
    f, g = hills(A.vertices), 100 - 3 * hills(B.vertices)
    prepared = prepare(A, B, f, g, initial=same)
    areas = np.bincount(B.faces.ravel(), minlength=len(B.vertices))
    for values in (prepared.problem.source, prepared.problem.target):
        assert abs(np.average(values[:, 0], weights=areas)) < 0.1
        assert abs(np.sqrt(np.average(values[:, 0] ** 2, weights=areas)) - 1) < 0.1
    assert prepared.problem.parameters == MEASURED_PARAMETERS
    constant = prepare(A, B, np.full(3000, 0.1), g, initial=same).problem
    assert_allclose(constant.source, 0.1)


def test_functions_of_a_have_the_units_of_the_match(same):
    """Functions of A, transferred by area, are the source of the match on B."""
    f, g = (np.stack([hills(m.vertices), m.vertices[:, 2] + 2], 1) for m in (A, B))
    for ours, theirs in ((f, g), (3 * f + 7, -g), (f[:, 1], g[:, 1]), (f[:, 1], 5 * g[:, 1])):
        prepared = prepare(A, B, ours, theirs, initial=same, mask_b=B.vertices[:, 2] > -0.5)
        transferred = prepared.initial.transfer(prepared.functions, by="area")
        assert_allclose(transferred, prepared.problem.source, atol=1e-9)
    assert prepare(B, B, landmarks=[[0, 1]]).functions is None


def test_opposite_sign_is_changed_with_a_note(same):
    prepared = prepare(A, B, hills(A.vertices), -hills(B.vertices), initial=same)
    check_message(prepared.notes[0], 1)
    assert np.corrcoef(prepared.problem.source[:, 0], -hills(B.vertices))[0, 1] > 0.97
    rotated = prepare(A, B, hills(A.vertices), -hills(TURN.apply(B.vertices.copy())))
    assert np.corrcoef(rotated.problem.source[:, 0], rotated.problem.target[:, 0])[0, 1] > 0.97
    assert not prepare(A, B, hills(A.vertices), hills(B.vertices), initial=same).notes


def test_exact_functions_keep_their_values(same):
    prepared = prepare(A, B, "coordinate:x", "coordinate:x", initial=same)
    assert_allclose(prepared.problem.target[:, 0], B.vertices[:, 0])
    distant = prepare(A, B, "gaussian:vertex=7", "gaussian:vertex=900", initial=same).problem
    assert distant.source.min() >= 0
    assert distant.source.max() <= 1
    other = prepare(A, B, A.vertices[:, 0] * 9, "coordinate:x", initial=same).problem
    assert_allclose(np.ptp(other.source), np.ptp(other.target), rtol=0.01)
    assert prepared.problem.parameters == Parameters()


def test_channels_have_weights_and_masks_on_both_surfaces(same):
    f = ["coordinate:x", "coordinate:z"]
    mask_a, mask_b = A.vertices[:, 0] > -0.5, B.vertices[:, 1] > -0.5
    given = {"mask_a": mask_a, "mask_b": mask_b, "weights": [1, 2]}
    prepared = prepare(A, B, f, f, initial=same, **given)
    assert_allclose(prepared.problem.weights, [1, 2])
    mask = prepared.problem.mask
    assert (mask[B.vertices[:, 1] <= -0.5] == 0).all()
    assert (mask[B.vertices[:, 0] < -0.7] == 0).all()
    assert_allclose(mask[B.vertices.min(axis=1) > 0], 1)


@pytest.mark.parametrize("most", [0, -1, np.nan, np.inf, "1"])
def test_invalid_bounds_are_refused_first(most):
    with raises(ParameterError):
        register(A, B, "no function", "no function", max_distortion=most)


def test_no_flow_if_the_initial_map_exceeds_the_bound():
    stretched = TriangleMesh(B.vertices * [1, 1, 4], B.faces)
    landmarks, p = [[0, 20]], Parameters.of(iterations=5)
    found = register(stretched, B, landmarks=landmarks, initial="connectivity", parameters=p)
    bounded = register(
        stretched, B, landmarks=landmarks, initial="connectivity", parameters=p, max_distortion=0.5
    )
    assert_array_equal(bounded.points.positions, found.points.positions)
    share = 100 * found.initial.distortion().share_within(0.5)
    assert share < 90
    *others, note = bounded.notes
    check_message(note, "0.5", f"{share:.1f}%", 0)
    assert tuple(others) == found.notes


@pytest.mark.parametrize("vertices", [[0, 0, 0], [0, OPPOSITE, 0]])
@pytest.mark.parametrize("side", [0, 1])
def test_undetermined_rotation_is_omitted_with_a_note(vertices, side):
    sides = [vertices, [3, 5, 8]]
    pairs = np.stack(sides if side == 0 else sides[::-1], axis=1)
    prepared = prepare(B, B, landmarks=pairs, initial="sphere")
    assert_allclose(prepared.initial.points.positions, B.vertices, atol=1e-12)
    (note,) = prepared.notes
    check_message(note)


def test_landmarks_have_the_numbers_of_the_input():
    """Landmarks count rows of a pair of arrays, or rows of a mesh made from it."""
    pair = np.vstack([[[9.0, 9, 9]], B.vertices]), B.faces + 1
    rows = np.array([[0, 4], [30, 31], [90, 95]])
    made = TriangleMesh(*pair), TriangleMesh(*pair)
    for a, b, shift in ((pair, pair, [1, 1]), (pair, B, [1, 0]), (*made, [0, 0])):
        problem = prepare(a, b, landmarks=rows + shift, initial="connectivity").problem
        expected = problem.landmarks.targets(problem.mesh).positions
        assert_allclose(expected, B.vertices[rows[:, 1]], atol=1e-12)
    table = pandas.DataFrame({"Target": rows[:, 1], "source": rows[:, 0]})
    problem = prepare(B, B, landmarks=table, initial="connectivity").problem
    expected = problem.landmarks.targets(problem.mesh).positions
    assert_allclose(expected, B.vertices[rows[:, 1]], atol=1e-12)
    with raises(AbfmError, 0, "dropped"):
        prepare(pair, pair, landmarks=[[0, 1]], initial="connectivity")


def test_channels_of_weight_0_do_not_change_parameters():
    smooth, rough = B.vertices[:, 2], hills(B.vertices)
    both = np.stack([smooth, rough], axis=1)
    for weights, default in (([1, 0], Parameters()), ([1, 1], MEASURED_PARAMETERS)):
        assert prepare(B, B, both, both, weights=weights).problem.parameters == default


def test_mirrored_spheres_are_read_from_files(tmp_path):
    body_a, body_b = (
        TriangleMesh(m.vertices * (1 + 0.2 * m.vertices[:, :1]) * [1, 2, 1], m.faces)
        for m in (A, B)
    )
    names = [str(tmp_path / name) for name in ("a,left.ply", "b,left,2.ply")]
    mirrored = TriangleMesh(A.vertices * [-1, 1, 1], A.faces)
    for name, mesh in zip(names, (mirrored, B), strict=True):
        export_ply(name, mesh, {}, {})
    f, g = hills(A.vertices), hills(B.vertices)
    prepared = prepare(body_a, body_b, f, g, initial=f"sphere:mirror,{','.join(names)}")
    assert np.corrcoef(prepared.problem.source[:, 0], g)[0, 1] > 0.97


OF_OTHERS = Landmarks.of_vertices(B, A, [0], [0])


@pytest.mark.parametrize(
    ("change", "error", "named"),
    [
        ({"a": 3}, MeshError, ("a", "TriangleMesh")),
        ({"g": None}, FunctionError, ()),
        ({"f": np.ones(3)}, FunctionError, ()),
        ({"f": 3.0}, FunctionError, ()),
        ({"f": np.zeros((3000, 0))}, FunctionError, ()),
        ({"f": ["coordinate:x", "coordinate:y"]}, FunctionError, (2, 1)),
        ({"f": "cordinate:x"}, FunctionError, ()),
        ({"mask_a": -np.ones(3000)}, ParameterError, ("mask_a",)),
        ({"mask_b": np.zeros(2562)}, ParameterError, ("mask_b",)),
        ({"initial": "spher"}, ParameterError, ()),
        ({"initial": 3}, ParameterError, ()),
        ({"initial": "sphere:a.ply"}, ParameterError, (1,)),
        ({"initial": "connectivity"}, AbfmError, ("connectivity",)),
        ({"initial": PointMap.of_vertices(B, B)}, ParameterError, ()),
        ({"initial": "closest:left"}, ParameterError, ()),
        ({"initial": "spectral:left"}, ParameterError, ()),
        ({"initial": "file"}, ParameterError, ()),
        ({"initial": "connectivity:x"}, AbfmError, ()),
        ({"weights": [1, 2]}, ParameterError, ("(2,)", "(1,)", "weights")),
        ({"weights": 1.0, "initial": "sphere"}, ParameterError, ("weights",)),
        ({"landmarks": OF_OTHERS}, ParameterError, ()),
        ({"landmarks": (OF_OTHERS.b, OF_OTHERS.b)}, ParameterError, ()),
        ({"f": None, "g": None, "landmarks": [[0, 1]], "weights": [1]}, ParameterError, ()),
        ({"mask_a": A.vertices[:, 0] > 0.2, "mask_b": B.vertices[:, 0] < -0.2}, ParameterError, ()),
    ],
)
def test_invalid_arguments_are_refused(change, error, named, same):
    given = {"a": A, "b": B, "f": "coordinate:x", "g": "coordinate:x", "initial": same} | change
    if change.keys() & {"a"}:
        given.pop("initial")
    with raises(error, *named):
        prepare(**given)


def test_unknown_values_are_not_compared(same):
    f, g = hills(A.vertices), hills(B.vertices)
    f[A.vertices[:, 2] > 0.8], g[B.vertices[:, 2] < -0.8] = np.nan, np.inf
    problem = prepare(A, B, f, g, initial=same).problem
    assert (problem.mask[np.abs(B.vertices[:, 2]) > 0.9] == 0).all()
    assert_allclose(problem.mask[np.abs(B.vertices[:, 2]) < 0.7], 1)
    assert np.isfinite(problem.source).all()
    with raises(FunctionError):
        prepare(A, B, f * np.nan, g, initial=same)


def test_unknown_values_in_files_give_a_note(tmp_path, same):
    f, g = hills(A.vertices), hills(B.vertices)
    f[A.vertices[:, 2] > 0.8] = np.nan
    np.save(tmp_path / "f.npy", f)
    by_array = prepare(A, B, f, g, initial=same)
    by_text = prepare(A, B, f"file:{tmp_path / 'f.npy'}", g, initial=same)
    assert by_text.problem.digest == by_array.problem.digest
    count = np.count_nonzero(np.isnan(f))
    expected = f"functions of A are not finite at {count} of {len(f)} vertices"
    assert any(note.startswith(expected) for note in by_text.notes)
    assert not any(
        "finite" in note for note in prepare(A, B, hills(A.vertices), g, initial=same).notes
    )


def test_values_of_unused_vertices_are_ignored():
    loose = with_loose_vertex(B)
    values = np.arange(len(B.vertices) + 1.0)
    same = Correspondence.through_sphere(A, loose, A.vertices, B.vertices)
    prepared = prepare(A, loose, "coordinate:x", values, initial=same)
    assert len(prepared.problem.target) == len(B.vertices)
