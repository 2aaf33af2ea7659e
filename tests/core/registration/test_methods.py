"""Methods for initial maps, landmarks in them, and repair of discontinuous maps."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm import PointMap, TriangleMesh, register
from abfm.errors import AbfmError, FunctionError, ParameterError
from abfm.maps.spherical import SphereLayout
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh.shapes import even_sphere, five_limbs
from abfm.registration.correspondence import Candidate
from abfm.registration.initial import METHODS
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.map_input import MapInput
from abfm.registration.initial.methods import _choice_notes, initial_map
from abfm.registration.register import prepare
from abfm.registration.report import initial_details
from tests.mesh_writers import off_text, write
from tests.messages import check_message, check_names, raises
from tests.shapes import icosphere, torus

BALL, EVEN_BALL = icosphere(2), even_sphere(300)
BODY = five_limbs(200)


def pairs(count=4, seed=0):
    """Return points on one sphere and their images by a twist about z on the other."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    x, y, z = directions.T
    turn = 0.4 * z
    cosine, sine = np.cos(turn), np.sin(turn)
    twisted = np.stack([x * cosine - y * sine, x * sine + y * cosine, z], axis=1)
    on_a = SphereLayout(EVEN_BALL, EVEN_BALL.vertices).locate(directions)
    on_b = SphereLayout(BALL, BALL.vertices).locate(twisted)
    return on_a, on_b


def test_landmarks_alone_determine_a_registration(tmp_path):
    on_a, on_b = pairs()
    found = register(EVEN_BALL, BALL, initial="sphere", landmarks=(on_a, on_b))
    assert found.landmark_errors.max() < 0.005
    assert np.isnan(found.residual)
    assert found.verified_residual < 0.05
    check_message(found.verdict.reason)
    assert found.distortion().folded == 0
    off = found.transfer_points(on_a).distances_from(on_b.positions) / BALL.length_scale
    assert_allclose(off, found.landmark_errors, atol=2e-3)
    found.save(tmp_path / "r.npz")
    again = abfm.load(tmp_path / "r.npz")
    assert_allclose(again.landmark_errors, found.landmark_errors, atol=1e-9)


def test_spheres_in_files_fit_repaired_surfaces(tmp_path):
    """A file of spheres may have both hemispheres, and one vertex for each corner of a face."""
    corners = BALL.vertices[BALL.faces.ravel()]
    faces = np.arange(2 * BALL.faces.size).reshape(-1, 3)
    bumpy = corners * (2 + corners[:, [2]])
    surfaces = np.concatenate([bumpy + np.array([x, 0, 0]) for x in (-4, 4)])
    mesh = TriangleMesh(surfaces, faces, merge=True, hemisphere="R")
    spheres = write(tmp_path, "s.off", off_text(np.concatenate([corners, corners]), faces))
    found = initial_map(f"sphere:{spheres},{spheres}", MapInput(mesh, mesh, None, None))
    assert_allclose(found.correspondence.points.positions, mesh.vertices, atol=1e-6)
    small = write(tmp_path, "t.off", off_text(corners, faces[: len(BALL.faces)]))
    with raises(ParameterError, 960, 1920):
        initial_map(f"sphere:{small},{spheres}", MapInput(mesh, mesh, None, None))


def test_landmarks_need_no_functions():
    vertices = np.array([[0, 5], [20, 30], [100, 80]])
    alone = prepare(EVEN_BALL, BALL, landmarks=vertices, initial="sphere").problem.landmarks
    assert_allclose(alone.points(BALL.normalized()).positions.shape, (3, 3))
    functions = ["coordinate:x"] * 2
    problem = prepare(EVEN_BALL, BALL, *functions, landmarks=vertices, initial="sphere").problem
    assert len(problem.landmarks) == 3
    assert_allclose(problem.target[:, 0], BALL.vertices[:, 0])


@pytest.mark.parametrize(
    ("given", "error", "named"),
    [
        ({}, FunctionError, ()),
        ({"landmarks": [[0, 1, 2]]}, ParameterError, ()),
        ({"landmarks": [[0, 10**6]]}, AbfmError, (0, 161)),
        ({"landmarks": [[0, 1]], "initial": "landmarks"}, AbfmError, (3,)),
        ({"f": "coordinate:x", "g": "coordinate:x", "initial": "landmarks"}, AbfmError, ()),
    ],
)
def test_invalid_landmarks_are_refused(given, error, named):
    with raises(error, *named):
        prepare(EVEN_BALL, BALL, **given)


def moved(mesh):
    """Return the body moved, scaled and renumbered, and the old number of each vertex."""
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    place = np.argsort(order)
    return TriangleMesh(3 * mesh.vertices[order] + [5, 0, 0], place[mesh.faces]), order


@pytest.mark.parametrize(
    "method", ["closest", "closest:rigid", "spectral", "embedding", "landmarks"]
)
def test_every_method_finds_a_moved_body(method):
    other, order = moved(BODY)
    scale = 1 if method == "closest:rigid" else 3
    other = TriangleMesh(other.vertices * (scale / 3), other.faces)
    landmarks = np.array([[order[k], k] for k in (3, 77, 120, 190)])
    f = np.cos(BODY.vertices @ np.random.default_rng(1).normal(size=(3, 3)) * 2)
    prepared = prepare(BODY, other, f, f[order], initial=method, landmarks=landmarks)
    given = prepared.initial
    assert bool(prepared.warnings) == (method == "embedding")  # embeddings distort limbs
    gaps = np.linalg.norm(given.points.positions - BODY.vertices[order], axis=1)
    assert np.median(gaps) < (0.25 if method == "embedding" else 0.02) * BODY.length_scale
    assert given.distortion().folded == 0


def test_discontinuous_maps_are_repaired_with_a_note(tmp_path):
    """Maps from files are repaired, except on surfaces with handles; a `PointMap` is kept."""
    rng = np.random.default_rng(0)
    vertices = np.arange(len(BODY.vertices))
    swapped = rng.choice(len(vertices), 30, replace=False)
    vertices[swapped] = rng.permutation(vertices[swapped])
    np.savetxt(tmp_path / "map.txt", vertices, fmt="%d")
    found = initial_map(f"file:{tmp_path}/map.txt", MapInput(BODY, BODY))
    check_message(found.notes[0])
    assert found.correspondence.distortion().folded == 0
    assert found.correspondence.coverage() == 1
    ring = torus(16, 10)
    mixed = np.roll(np.arange(len(ring.vertices)), 1)
    mixed[:40] = rng.permutation(mixed[:40])
    np.savetxt(tmp_path / "ring.txt", mixed, fmt="%d")
    unchanged = initial_map(f"file:{tmp_path}/ring.txt", MapInput(ring, ring))
    check_message(unchanged.notes[0])
    assert_array_equal(unchanged.correspondence.to_vertices(), mixed)
    given = PointMap.of_vertices(BODY, BODY, vertices)
    assert initial_map(given, MapInput(BODY, BODY)).correspondence.points is given


def test_stretched_body_gives_a_warning():
    stretched = TriangleMesh(BODY.vertices * [1, 2.5, 1], BODY.faces)
    assert initial_map("spectral", MapInput(BODY, stretched)).warnings


def test_distorted_maps_give_a_warning():
    long = TriangleMesh(BALL.vertices * [1, 1, 12], BALL.faces)
    closest = initial_map("closest", MapInput(EVEN_BALL, long))
    assert closest.correspondence.distortion().log2_shape.mean > 1.2
    assert len(closest.warnings) == 1
    assert not initial_map(closest.correspondence, MapInput(EVEN_BALL, long)).warnings
    assert not initial_map("closest", MapInput(EVEN_BALL, BALL)).warnings


def test_ambiguous_rotations_give_a_warning():
    """All rotations about z map the function z to itself, so the map is ambiguous."""
    heights = BALL.vertices[:, 2], EVEN_BALL.vertices[:, 2]
    found = prepare(BALL, EVEN_BALL, *heights, initial="sphere")
    assert len(found.warnings) == 1
    assert not any("rotation" in note for note in found.notes)
    landmarks = Landmarks.of_vertices(BALL, BALL, [3, 5, 8], [3, 5, 8])
    assert not initial_map("sphere", MapInput(BALL, BALL, landmarks=landmarks)).warnings


def test_default_method_depends_on_the_input():
    f = ("coordinate:x",) * 2
    assert prepare(BODY, BODY, *f).initial.points.interior_map is not None
    rings = prepare(torus(10, 6), torus(9, 6), *f)
    assert rings.notes[0].startswith("initial map: ")
    assert "embedding" not in [each.name for each in rings.initial.candidates]  # tori have none


def test_methods_have_distinct_names():
    assert len({method.name for method in METHODS}) == len(METHODS)
    for method in METHODS:
        assert method.form.startswith(method.name)
        assert method.about


def test_landmarks_on_other_surfaces_are_refused():
    on_a, _ = pairs()
    other = SurfacePoints(BODY, np.array([len(BODY.faces) - 1]), np.eye(3)[:1])
    with raises(ParameterError):
        prepare(EVEN_BALL, BALL, landmarks=(other, on_a[np.array([0])]), initial="sphere")


def test_notes_name_the_chosen_map():
    rolled, order = moved(BODY)
    pairs = np.array([[order[k], k] for k in (3, 77, 120, 190)])
    landmarks = Landmarks.of_vertices(BODY, rolled, pairs[:, 0], pairs[:, 1])
    found = initial_map("landmarks", MapInput(BODY, rolled, landmarks=landmarks))
    check_message(found.notes[0], "landmarks", found.correspondence.candidates[0].name)
    tied = Candidate("spectral", 4.12), Candidate("matching", 4.11)
    check_names(*_choice_notes("auto", tied), "spectral, cost 4.12", "more accurate")
    stretched = TriangleMesh(BODY.vertices * [1, 1, 1.1], BODY.faces)
    for method in ("auto", "connectivity"):
        same = initial_map(method, MapInput(BODY, stretched))
        assert initial_details(same.correspondence)["initial"] == "connectivity"
