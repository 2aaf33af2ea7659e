"""Map files: vertices, points in faces, pairs of vertices, and refused content."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import AbfmError
from abfm.mesh import TriangleMesh
from abfm.registration.initial import Landmarks, map_from_file
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere, with_loose_vertex

A, B = ellipsoid(2, 1, 2, 3), icosphere(1)
COUNT, FEW = len(A.vertices), len(B.vertices)
RNG = np.random.default_rng(0)
LIST = RNG.permutation(COUNT)[:FEW]


def saved(path, array):
    np.save(path, array) if path.suffix == ".npy" else np.savetxt(path, array, fmt="%.9g")
    return str(path)


@pytest.mark.parametrize("suffix", ["npy", "csv", "txt", "vts", "map"])
@pytest.mark.parametrize("first", [0, 1])
def test_vertex_maps_are_read_from_every_format(tmp_path, suffix, first):
    some = np.append(LIST[:-1], 0 if first == 0 else COUNT - 1)
    found = map_from_file(A, B, saved(tmp_path / f"m.{suffix}", some + first))
    assert (found.domain, found.codomain) == (B, A)
    assert_array_equal(found.positions, A.vertices[some])


@pytest.mark.parametrize(("suffix", "first"), [("vts", 1), ("txt", 0), ("map", 0)])
def test_ambiguous_first_number_depends_on_the_format(tmp_path, suffix, first):
    numbers = np.clip(LIST, 1, COUNT - 1)
    found = map_from_file(A, B, saved(tmp_path / f"m.{suffix}", numbers))
    assert_array_equal(found.positions, A.vertices[numbers - first])


def test_numbers_are_those_of_the_mesh_files(tmp_path):
    a, b = with_loose_vertex(A), with_loose_vertex(B)
    numbers = np.insert(a.vertex_ids[LIST], 5, 5)
    found = map_from_file(a, b, saved(tmp_path / "m.txt", numbers))
    assert_array_equal(found.positions, A.vertices[LIST])
    numbers[9] = 5
    with raises(AbfmError, 1, 42, 9, 5):
        map_from_file(a, b, saved(tmp_path / "m.txt", numbers))
    with raises(AbfmError, 41, 43):
        map_from_file(a, b, saved(tmp_path / "m.txt", numbers[:41]))


@pytest.mark.parametrize("first", [0, 1])
def test_rounded_weights_are_normalized(tmp_path, first):
    faces = np.append(RNG.integers(0, len(A.faces), FEW - 1), 0 if first == 0 else 319)
    weights = RNG.dirichlet(np.ones(3), FEW)
    table = np.column_stack([faces + first, weights.round(4)])
    found = map_from_file(A, B, saved(tmp_path / "m.csv", table))
    assert_array_equal(found.faces, faces)
    assert_allclose(found.barycentric, weights, atol=2e-4)
    assert_allclose(found.barycentric.sum(axis=1), 1, atol=1e-12)


def test_pairs_are_landmarks_or_a_complete_map(tmp_path):
    some = np.column_stack([LIST, RNG.permutation(FEW)])
    for name in ("m.npy", "m.txt"):
        found = map_from_file(A, B, saved(tmp_path / name, some))
        assert_allclose(found.positions[some[:, 1]], A.vertices[LIST], atol=1e-12)
        found = map_from_file(A, B, saved(tmp_path / name, some[:7]))
        assert isinstance(found, Landmarks)
        assert_allclose(found.a.positions, A.vertices[LIST[:7]], atol=1e-12)
        assert_allclose(found.b.positions, B.vertices[some[:7, 1]], atol=1e-12)


@pytest.mark.parametrize(("name", "first"), [("m.npy", 0), ("m.csv", 0), ("m.vts", 1)])
def test_vertices_may_share_an_image(tmp_path, name, first):
    pairs = np.column_stack([LIST // 2, RNG.permutation(FEW)])
    found = map_from_file(A, B, saved(tmp_path / name, pairs + first))
    assert_allclose(found.positions[pairs[:, 1]], A.vertices[LIST // 2], atol=1e-12)


def table(column, value):
    good = np.tile([1.0, 0.2, 0.3, 0.5], (FEW, 1))
    good[3, column] = value
    return good


@pytest.mark.parametrize(
    ("array", "named"),
    [
        (np.zeros((FEW, 3)), (3, 1, 2, 4)),
        (np.zeros((FEW - 1, 4)), (41, 42)),
        (table(0, len(A.faces) + 1), (1, 42, 3, 321)),
        (table(0, 0.5), (3, "0.5")),
        (table(0, np.nan), (3,)),
        (table(1, 0.3), (1, 42, 3, "0.3", "0.5")),
        (table(2, np.nan), (3, "0.2", "0.5")),
        (np.array([[0.5, 1], [1, 2]]), (1,)),
        (np.array([[0, 1], [1, 99]]), (99,)),
        (np.full(FEW, COUNT + 1), (42,)),
        (np.full(FEW, np.inf), (42,)),
    ],
)
def test_invalid_maps_are_refused(tmp_path, array, named):
    path = saved(tmp_path / "m.npy", array)
    with raises(AbfmError, *named):
        map_from_file(A, B, path)


def test_weights_of_flipped_faces_are_refused(tmp_path):
    faces = A.faces.copy()
    faces[7] = faces[7, ::-1]
    flipped = TriangleMesh(A.vertices, faces)
    assert flipped.has_flipped_faces
    assert not A.has_flipped_faces
    with raises(AbfmError, "flipped"):
        map_from_file(flipped, B, saved(tmp_path / "m.txt", table(0, 1)))


@settings(max_examples=100)
@given(rows=st.lists(st.floats(width=32), min_size=1, max_size=50), columns=st.integers(1, 5))
def test_any_numbers_are_read_or_refused(tmp_path, rows, columns):
    path = saved(tmp_path / "m.npy", np.resize(rows, (FEW, columns)))
    try:
        found = map_from_file(A, B, path)
    except AbfmError:
        return
    assert len(found.points.faces if hasattr(found, "points") else found) == FEW
