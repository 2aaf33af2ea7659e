"""Landmark files: vertices, coordinates, curves, and refused content."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from abfm.errors import AbfmError
from abfm.maps import vertex_points
from abfm.registration.initial import Landmarks, read_landmarks
from tests.messages import raises
from tests.shapes import ellipsoid, icosphere, square, with_loose_vertex

A, B = ellipsoid(2, 1, 2, 3), icosphere(2)
COUNT = len(A.vertices)


@pytest.fixture
def read(tmp_path):
    def reading(text, name="pairs.csv", a=A, b=B):
        path = tmp_path / name
        path.write_text(text)
        return read_landmarks(a, b, str(path))

    return reading


@pytest.mark.parametrize(
    "text",
    [
        "5,9\n0,161\n",
        "a,b\n5,9\n0,161\n",
        "# x\n\n5;9\n0;161",
        "5 9\n0 161",
        ",a,b\n0,5,9\n1,0,161\n",
        "vertex_b,vertex_a\n9,5\n161,0\n",
        "Target,Source\n9,5\n161,0\n",
    ],
)
def test_pairs_of_vertices_are_read(read, text):
    found = read(text)
    assert_allclose(found.a.positions, A.vertices[[5, 0]], atol=1e-12)
    assert_allclose(found.b.positions, B.vertices[[9, 161]], atol=1e-12)
    assert (len(found), found.names, found.weights.tolist()) == (2, ("0", "1"), [1, 1])


def test_columns_of_names_and_weights_are_read(read):
    found = read("name,left,right,Weight\nnose,5,9,2.5\n,7,8,\n")
    assert (found.names, found.weights.tolist()) == (("nose", "1"), [2.5, 1])
    assert_allclose(found.b.positions, B.vertices[[9, 8]], atol=1e-12)


def test_vertex_numbers_are_those_of_the_files(read):
    """Vertices count from 1 in .vts files, and include unused vertices of the mesh file."""
    assert_allclose(read("1 162\n", "pairs.vts").b.positions, B.vertices[[161]], atol=1e-12)
    loose = with_loose_vertex(A)
    assert_allclose(read("6,6\n", a=loose).a.positions, A.vertices[[5]], atol=1e-12)
    with raises(AbfmError, 1, 5):
        read("5,6\n", a=loose)


def test_coordinates_are_projected_onto_the_surfaces(read):
    points = 1.02 * np.hstack([A.vertices[[3, 8]], B.vertices[[4, 5]]])
    found = read("\n".join(",".join(map(repr, row)) for row in points.tolist()))
    assert_allclose(found.b.positions, B.vertices[[4, 5]], atol=0.01)
    assert_allclose(found.a.positions, A.vertices[[3, 8]], atol=0.03)
    text = "\n".join(";".join(map(repr, row)) for row in points.tolist()).replace(".", ",")
    for separated in (text, text.replace(";", "\t"), text.replace(";", " ")):  # decimal commas
        assert_allclose(read(separated).b.positions, found.b.positions, atol=1e-12)
    mixed = points.reshape(2, 2, 3).transpose(0, 2, 1)[:, ::-1, ::-1].reshape(2, 6)
    named = ["z_b,z_a,y_b,y_a,x_b,x_a", *(",".join(map(repr, row)) for row in mixed.tolist())]
    assert_allclose(read("\n".join(named)).b.positions, found.b.positions, atol=1e-12)
    with raises(AbfmError, 12, "decimal"):
        read(text.replace(";", ","))
    points[1, 3:] *= 2
    with raises(AbfmError, 2):
        read("\n".join(",".join(map(repr, row)) for row in points.tolist()))


def line(x, y):
    return f"{x!r},{y!r},0"


def test_curves_are_divided_by_arc_length(read):
    flat, rows = square(8), []
    for x, y in ((0.1, 0.2), (0.4, 0.4), (0.15, None), (0.9, 0.8), (0.95, None)):
        rows.append(f"{line(x, 0.5)},{line(0.3, y) if y is not None else ',,'},rim")
    rows[1], rows[2] = rows[2].replace("0.15", "0.2"), rows[1]
    found = read("\n".join(rows), a=flat, b=flat)
    assert found.names == tuple(f"rim {k}" for k in range(5))
    assert_allclose(found.a.positions[:, 0], np.linspace(0.1, 0.95, 5), atol=1e-9)
    assert_allclose(found.b.positions[:, 1], np.linspace(0.2, 0.8, 5), atol=1e-9)
    assert_allclose(found.a.positions[:, 1:], [[0.5, 0]] * 5, atol=1e-9)


def test_curves_with_few_points_stay_on_the_surface(read):
    sphere = icosphere(4)
    ends = [np.array(p, dtype=float) for p in ([1, 0, 0], [0.6, 0.8, 0], [0, 1, 0])]
    vertices = [int(np.linalg.norm(sphere.vertices - p, axis=1).argmin()) for p in ends]
    text = "a,b,curve,weight\n" + "\n".join(f"{v},{v},arc,3" for v in vertices) + "\n40,41,,5\n"
    found = read(text, a=sphere, b=sphere)
    arc = found.a.positions[1:]
    assert found.names == ("3", "arc 0", "arc 1", "arc 2")
    assert found.weights.tolist() == [5, 3, 3, 3]
    angles = np.arccos(np.clip((arc[1:] * arc[:-1]).sum(axis=1), -1, 1))
    assert angles[0] == pytest.approx(angles[1], rel=0.01)
    assert angles.sum() == pytest.approx(np.pi / 2, rel=0.02)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ()),
        ("a,b\n", ()),
        ("1\n2\n", (1, 2, 6)),
        ("1,2,3\n", (3,)),
        ("1,2\n3\n", (2, 1)),
        ("1,2\nx,3\n", ("x", 2, "A")),
        ("1,2\n3,nan\n", ("nan", 2, "B")),
        ("1,2\n3,\n", (2, "B")),
        ("1,2\n3.5,4\n", (2, "3.5", "A")),
        (f"1,2\n{COUNT},4\n", (2, COUNT, "A")),
        ("1,2\n-1,4\n", (2, -1, "A")),
        ("1,2\n1,4\n", (1, 2, "A")),
        ("1,2\n4,2\n", (1, 2, "B")),
        ("a,b,weight\n1,2,0\n", (0, "weight")),
        ("a,b,weight\n1,2,heavy\n", ("heavy", 1, "weight")),
        ("1,2,rim\n", ("rim", 1, "A", 2)),
        ("1,2,rim\n1,3,rim\n", ("rim", "A")),
        ("1,2,rim\n5,,rim\n", ("rim", 1, "B")),
        ("1,2,rim\n,,rim\n", (2,)),
    ],
)
def test_errors_name_the_row(read, text, named):
    with raises(AbfmError, "pairs.csv", *named):
        read(text)


def test_other_and_missing_files_are_refused(read, tmp_path):
    with raises(AbfmError, ".csv"):
        read("1,2", "pairs.json")
    with raises(AbfmError):
        read_landmarks(A, B, str(tmp_path / "none.csv"))


@settings(max_examples=200)
@given(text=st.text(alphabet="0123456789.,;-e\t\n \"'#nax", max_size=40))
def test_any_text_is_read_or_refused(read, text):
    with suppress(AbfmError):
        found = read(text)
        assert len(found) == len(found.names) >= 1


def test_landmarks_from_vertices_and_points():
    found = Landmarks.of_vertices(A, B, [1, 2], [3, 4])
    assert_allclose(found.a.positions, A.vertices[[1, 2]])
    one, two = vertex_points(A, [1]), vertex_points(B, [1, 2])
    with raises(AbfmError, 1, 2):
        Landmarks(one, two, np.ones(1), ("x",))
    with raises(AbfmError):
        Landmarks.of_vertices(A, B, np.zeros(0, int), np.zeros(0, int))
    with raises(AbfmError, 1, 900):
        Landmarks.of_vertices(A, B, [1, 900], [3, 4])


@given(
    vertices=st.lists(st.integers(0, COUNT - 1), min_size=1, max_size=6, unique=True),
    weight=st.floats(1e-6, 1e6),
    names=st.lists(st.text("abc ,\"';é", min_size=1, max_size=4), min_size=6, max_size=6),
)
def test_saved_landmarks_round_trip(tmp_path, vertices, weight, names):
    given = Landmarks.of_vertices(A, B, vertices, vertices[::-1])
    stripped = tuple(name.strip() or "x" for name in names[: len(vertices)])
    given = Landmarks(given.a, given.b, weight * given.weights, stripped)
    given.save(tmp_path / "pairs.csv")
    found = read_landmarks(A, B, str(tmp_path / "pairs.csv"))
    assert_allclose(found.a.positions, given.a.positions, atol=1e-12)
    assert_allclose(found.b.positions, given.b.positions, atol=1e-12)
    assert found.weights.tolist() == given.weights.tolist()
    assert found.names == given.names
