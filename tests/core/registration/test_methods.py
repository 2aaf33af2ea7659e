"""Initial maps by words, where landmarks come in, and torn maps that are made continuous."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm import PointMap, TriangleMesh, register
from abfm.errors import AbfmError, FunctionError, ParameterError
from abfm.maps.spherical import SphereLayout
from abfm.maps.surface_points import SurfacePoints
from abfm.mesh.shapes import even_sphere, five_limbs
from abfm.registration.initial import METHODS
from abfm.registration.initial.landmark_pairs import Landmarks
from abfm.registration.initial.map_input import MapInput
from abfm.registration.initial.methods import initial_map
from abfm.registration.register import prepare
from tests.mesh_writers import off_text, write
from tests.messages import check_message, raises
from tests.shapes import icosphere, torus

BALL, OTHER = icosphere(2), even_sphere(300)
BODY = five_limbs(200)


def pairs(count=4, seed=0):
    """Directions on one sphere, and where a twist about z has them on the other."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    x, y, z = directions.T
    turn = 0.4 * z
    cosine, sine = np.cos(turn), np.sin(turn)
    twisted = np.stack([x * cosine - y * sine, x * sine + y * cosine, z], axis=1)
    on_a = SphereLayout(OTHER, OTHER.vertices).locate(directions)
    on_b = SphereLayout(BALL, BALL.vertices).locate(twisted)
    return on_a, on_b


def test_landmarks_alone_come_to_where_they_belong_and_files_keep_it(tmp_path):
    on_a, on_b = pairs()
    found = register(OTHER, BALL, initial="sphere", landmarks=(on_a, on_b))
    assert found.landmark_errors.max() < 0.005
    check_message(found.verdict.reason)
    assert found.distortion().folded == 0
    off = found.transfer_points(on_a).distances_from(on_b.positions) / BALL.length_scale
    assert_allclose(off, found.landmark_errors, atol=2e-3)
    found.save(tmp_path / "r.npz")
    again = abfm.load(tmp_path / "r.npz")
    assert_allclose(again.landmark_errors, found.landmark_errors, atol=1e-9)


def test_spheres_of_files_fit_surfaces_that_were_merged_or_cut(tmp_path):
    """A file with the spheres of both hemispheres, a vertex for each corner of a face."""
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


def test_landmarks_are_vertices_or_points_beside_functions_or_alone():
    vertices = np.array([[0, 5], [20, 30], [100, 80]])
    alone = prepare(OTHER, BALL, landmarks=vertices, initial="sphere").problem.landmarks
    assert_allclose(alone.points(BALL.normalized()).positions.shape, (3, 3))
    beside = prepare(
        OTHER, BALL, "coordinate:x", "coordinate:x", landmarks=vertices, initial="sphere"
    ).problem
    assert len(beside.landmarks) == 3
    assert_allclose(beside.target[:, 0], BALL.vertices[:, 0])


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
def test_landmarks_that_do_not_fit_are_refused(given, error, named):
    with raises(error, *named):
        prepare(OTHER, BALL, **given)


def moved(mesh):
    """The same body elsewhere, larger, with other vertex numbers; where each vertex came from."""
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    place = np.argsort(order)
    return TriangleMesh(3 * mesh.vertices[order] + [5, 0, 0], place[mesh.faces]), order


@pytest.mark.parametrize("word", ["closest", "closest:rigid", "spectral", "embedding", "landmarks"])
def test_every_way_finds_the_same_body_elsewhere(word):
    other, order = moved(BODY)
    scale = 1 if word == "closest:rigid" else 3
    other = TriangleMesh(other.vertices * (scale / 3), other.faces)
    marks = np.array([[order[k], k] for k in (3, 77, 120, 190)])
    f = np.cos(BODY.vertices @ np.random.default_rng(1).normal(size=(3, 3)) * 2)
    prepared = prepare(BODY, other, f, f[order], initial=word, landmarks=marks)
    given = prepared.initial
    assert bool(prepared.warnings) == (word == "embedding")  # which distorts limbs
    gaps = np.linalg.norm(given.points.positions - BODY.vertices[order], axis=1)
    assert np.median(gaps) < (0.25 if word == "embedding" else 0.02) * BODY.length_scale
    assert given.distortion().folded == 0


def test_a_torn_map_is_made_continuous_and_told_unless_there_are_handles(tmp_path):
    rng = np.random.default_rng(0)
    torn = np.arange(len(BODY.vertices))
    swapped = rng.choice(len(torn), 30, replace=False)
    torn[swapped] = rng.permutation(torn[swapped])
    np.savetxt(tmp_path / "map.txt", torn, fmt="%d")
    found = initial_map(f"file:{tmp_path}/map.txt", MapInput(BODY, BODY))
    check_message(found.notes[0])
    assert found.correspondence.distortion().folded == 0
    assert found.correspondence.coverage() == 1
    ring = torus(16, 10)
    mixed = np.roll(np.arange(len(ring.vertices)), 1)
    mixed[:40] = rng.permutation(mixed[:40])
    np.savetxt(tmp_path / "ring.txt", mixed, fmt="%d")
    kept = initial_map(f"file:{tmp_path}/ring.txt", MapInput(ring, ring))
    check_message(kept.notes[0])
    assert_array_equal(kept.correspondence.to_vertices(), mixed)
    # what is given as a map stays as it is
    own = PointMap.of_vertices(BODY, BODY, torn)
    assert initial_map(own, MapInput(BODY, BODY)).correspondence.points is own


def test_a_map_far_from_an_isometry_says_so():
    stretched = TriangleMesh(BODY.vertices * [1, 2.5, 1], BODY.faces)
    assert initial_map("spectral", MapInput(BODY, stretched)).warnings


def test_a_map_that_distorts_shapes_has_a_warning():
    """A map that was searched, unlike one that is given."""
    long = TriangleMesh(BALL.vertices * [1, 1, 12], BALL.faces)
    closest = initial_map("closest", MapInput(OTHER, long))
    assert closest.correspondence.distortion().log2_shape.mean > 1.2
    assert len(closest.warnings) == 1
    assert not initial_map(closest.correspondence, MapInput(OTHER, long)).warnings
    assert not initial_map("closest", MapInput(OTHER, BALL)).warnings


def test_an_ambiguous_rotation_has_a_warning():
    """Any turn about z carries z to itself."""
    heights = BALL.vertices[:, 2], OTHER.vertices[:, 2]
    found = prepare(BALL, OTHER, *heights, initial="sphere")
    assert len(found.warnings) == 1
    assert not any("rotation" in note for note in found.notes)
    marks = np.stack([[3, 5, 8]] * 2, axis=1)
    assert not initial_map("sphere", MapInput(BALL, BALL, landmarks=_marks(marks))).warnings


def _marks(pairs):
    return Landmarks.of_vertices(BALL, BALL, pairs[:, 0], pairs[:, 1])


def test_without_a_word_it_is_chosen_by_what_there_is():
    f = ("coordinate:x",) * 2
    assert prepare(BODY, BODY, *f).initial.points.interior_map is not None
    rings = prepare(torus(10, 6), torus(9, 6), *f)
    assert rings.notes[0].startswith("initial map: ")
    assert "embedding" not in [each.name for each in rings.initial.candidates]  # in a sphere


def test_each_word_is_known_by_its_form():
    assert len({word.name for word in METHODS}) == len(METHODS)
    for word in METHODS:
        assert word.form.startswith(word.name)
        assert word.about


def test_points_of_another_surface_are_no_landmarks():
    on_a, _ = pairs()
    far = SurfacePoints(BODY, np.array([len(BODY.faces) - 1]), np.eye(3)[:1])
    with raises(ParameterError):
        prepare(OTHER, BALL, landmarks=(far, on_a[np.array([0])]), initial="sphere")
