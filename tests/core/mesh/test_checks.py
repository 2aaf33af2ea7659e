"""What a mesh must be: every defect is named, counted, shown by an example and comes with
advice.
"""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm.errors import FunctionError, MeshError
from abfm.mesh import TriangleMesh
from abfm.mesh.checks import flat_faces
from tests.shapes import disc, icosphere, moebius_arrays, square, tetrahedron

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
SHEET = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])


def side_by_side(*meshes):
    """Vertices and faces of several meshes, moved apart along x."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    vertices = [mesh.vertices + np.array([10.0 * k, 0, 0]) for k, mesh in enumerate(meshes)]
    return np.concatenate(vertices), np.concatenate(
        [m.faces + s for m, s in zip(meshes, starts, strict=True)]
    )


def with_vertex(vertex, row):
    sphere = icosphere(1)
    vertices = sphere.vertices.copy()
    vertices[vertex] = row
    return vertices, sphere.faces


def with_faces(*rows):
    sphere = icosphere(1)
    return sphere.vertices, np.concatenate([sphere.faces, rows])


REFUSED = {
    "no vertices": (np.zeros((0, 3)), np.zeros((0, 3), int), "no vertices"),
    "no faces": (TRIANGLE, np.zeros((0, 3), int), "no faces"),
    "flat vertices": (TRIANGLE[:, :2], [[0, 1, 2]], r"vertices has shape \(3, 2\).*\(V, 3\)"),
    "ragged vertices": ([[0, 0, 0], [1, 0]], [[0, 1, 2]], "rows of vertices differ in length"),
    "words as vertices": ([["a", "b", "c"]] * 3, [[0, 1, 2]], "vertices has shape .* type <U1"),
    "complex vertices": (TRIANGLE * 1j, [[0, 1, 2]], "type complex128"),
    "quads": (SHEET, [[0, 1, 3, 2]], r"faces has shape \(1, 4\).*split larger polygons"),
    "ragged faces": (SHEET, [[0, 1, 2], [0, 1, 2, 3]], "rows of faces differ in length"),
    "truth values as faces": (TRIANGLE, [[False, True, True]], "type bool"),
    "fractional index": (
        SHEET,
        [[0, 1, 3], [0, 2, 1.5]],
        r"1 face has .* no whole .* \(face 1: "
        r"\[0.0, 2.0, 1.5\]\)",
    ),
    "nan index": (TRIANGLE, [[0, 1, np.nan]], "no whole numbers"),
    "infinite index": (TRIANGLE, [[0, 1, np.inf]], "names vertex inf of 3"),
    "index too large": (
        TRIANGLE,
        [[0, 1, 2], [1, 2, 3]],
        "1 face names .*face 1, .* vertex 3 of 3 numbered from 0",
    ),
    "negative index": (TRIANGLE, [[0, 1, -1]], "names vertex -1 of 3"),
    "nan": (*with_vertex(7, np.nan), r"1 vertex has .* not finite \(vertex 7, .*\[nan, nan, nan\]"),
    "infinity": (*with_vertex(0, [0, np.inf, 0]), r"not finite \(vertex 0, .*\[0.0, inf, 0.0\]"),
    "overflow": (*with_vertex(3, [1e200, 0, 0]), r"reaches 1e\+200 \(vertex 3\).*rescale"),
    "underflow": (icosphere(1).vertices * 1e-90, icosphere(1).faces, "2e-90 wide.*rescale"),
    "vertex used twice": (
        *with_faces([3, 4, 3], [9, 9, 9]),
        "2 faces are degenerate.*face 80, .*vertices 3, 4, 3",
    ),
    "line": (
        np.array([[0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]]),
        [[0, 1, 2]],
        "1 face is degenerate: no area",
    ),
    "point": (np.ones((3, 3)), [[0, 1, 2]], "no area"),
    "line far away": (TRIANGLE * [1, 1e-12, 1] + 1e6, [[0, 1, 2]], "no area"),
    "same face": (*with_faces(icosphere(1).faces[5]), "1 face repeats .*faces 5 and 80"),
    "same face turned": (
        SHEET,
        [[0, 1, 2], [3, 2, 1], [1, 0, 2]],
        r"faces 0 and 2, counting from "
        r"0: vertices 1, 0, 2",
    ),
    "edge with three faces": (
        np.vstack([SHEET, [[0, 0, 1]]]),
        [[0, 1, 2], [1, 3, 2], [2, 1, 4]],
        r"1 edge has more than two faces \(vertices 1 and 2, .* faces 0, 1, "
        r"2\)",
    ),
    "Moebius strip": (*moebius_arrays(20), "not orientable.*40 of 40 faces"),
    "two spheres": (
        *side_by_side(icosphere(0), icosphere(1)),
        r"2 components.*80 of 100 faces; face 0, .*--largest-component "
        r".*largest_component=True",
    ),
}


@pytest.mark.parametrize(("vertices", "faces", "message"), REFUSED.values(), ids=REFUSED)
def test_refused(vertices, faces, message):
    with pytest.raises(MeshError, match=message) as caught:
        TriangleMesh(vertices, faces)
    assert "\n" not in str(caught.value)
    assert ": " in str(caught.value)  # the advice


def test_examples_count_as_the_input_does():
    """Neither dropped vertices nor a dropped component shift the indices that an error names."""
    vertices, faces = side_by_side(tetrahedron(), icosphere(1, radius=3))
    faces = np.concatenate([faces, [[9, 9, 9]]]) + 2
    vertices = np.concatenate([np.zeros((2, 3)), vertices])
    with pytest.raises(MeshError, match="face 84, counting from 0: vertices 11, 11, 11"):
        TriangleMesh(vertices, faces, largest_component=True)


def test_separate_faces_at_equal_positions_are_explained():
    sphere = icosphere(0)
    with pytest.raises(
        MeshError, match=r"20 components.*48 vertices repeat the position of another.*merging"
    ):
        TriangleMesh(sphere.vertices[sphere.faces].reshape(-1, 3), np.arange(60).reshape(-1, 3))


def test_largest_component_is_largest_by_area():
    many_small_faces = TriangleMesh(icosphere(2).vertices * 0.1, icosphere(2).faces)
    vertices, faces = side_by_side(many_small_faces, icosphere(0), tetrahedron())
    mesh = TriangleMesh(vertices, faces, largest_component=True)
    assert mesh.vertices.tolist() == vertices[-4:].tolist()
    assert mesh.vertex_ids.tolist() == [174, 175, 176, 177]
    assert mesh.face_ids.tolist() == [340, 341, 342, 343]
    assert mesh.messages == ("kept the largest of 3 components: 4 of 178 vertices, 4 of 344 faces",)


def test_unreferenced_vertices_are_dropped_even_if_not_finite():
    sphere = icosphere(1)
    vertices = np.insert(
        sphere.vertices, [0, 5, 42], [[np.nan, 0, 0], [1e300, 0, 0], [7, 7, 7]], axis=0
    )
    kept = np.delete(np.arange(45), [0, 6, 44])
    mesh = TriangleMesh(vertices, kept[sphere.faces])
    assert mesh.vertices.tolist() == sphere.vertices.tolist()
    assert mesh.faces.tolist() == sphere.faces.tolist()
    assert mesh.vertex_ids.tolist() == kept.tolist()
    assert mesh.file_vertex_count == 45
    assert mesh.messages == ("3 vertices that no face uses were dropped (for example vertex 0)",)


def test_local_vertex_and_restrict_count_as_the_file_does():
    sphere = icosphere(1)
    vertices = np.insert(sphere.vertices, 5, np.nan, axis=0)
    mesh = TriangleMesh(vertices, sphere.faces + (sphere.faces >= 5))
    assert [mesh.local_vertex(index) for index in (0, 4, 6, 42)] == [0, 4, 5, 41]
    with pytest.raises(FunctionError, match="vertex 5 was dropped"):
        mesh.local_vertex(5)
    for outside in (-1, 43):
        with pytest.raises(
            FunctionError, match=f"no vertex {outside}: .* 43 vertices, numbered 0 to 42"
        ):
            mesh.local_vertex(outside)
    assert mesh.restrict(np.arange(43)).tolist() == [*range(5), *range(6, 43)]
    assert mesh.restrict(np.ones((43, 2))).shape == (42, 2)
    assert mesh.restrict(np.arange(42)).tolist() == list(range(42))
    with pytest.raises(FunctionError, match=r"7 values .* 43 vertices \(42 of them kept\)"):
        mesh.restrict(np.ones(7))
    with pytest.raises(FunctionError, match=r"7 values .* 42 vertices:"):
        sphere.restrict(np.ones(7))


def test_pinched_vertex_is_reported():
    """Two discs that share their centre."""
    flat, lower = disc(2), disc(2).vertices - [0, 0, 1]
    faces = np.concatenate([flat.faces, np.where(flat.faces == 0, 0, flat.faces + 18)])
    mesh = TriangleMesh(np.concatenate([flat.vertices, lower[1:]]), faces)
    assert re.match(r"warning: 1 vertex is pinched.*vertex 0\)", mesh.messages[0])
    assert mesh.boundary_loop_count == 2
    assert mesh.genus == 0


def test_arrays_are_copied_and_locked():
    vertices, faces = TRIANGLE.copy(), np.array([[0, 1, 2]])
    mesh = TriangleMesh(vertices, faces)
    vertices[:], faces[:] = 0, 0
    assert mesh.vertices.tolist() == TRIANGLE.tolist()
    assert mesh.faces.tolist() == [[0, 1, 2]]
    for name in (
        "vertices",
        "faces",
        "vertex_ids",
        "edges",
        "face_edges",
        "edge_faces",
        "is_boundary_vertex",
    ):
        with pytest.raises(ValueError, match="read-only"):
            getattr(mesh, name)[0] = 0
    with pytest.raises(AttributeError, match="setting vertices"):
        mesh.vertices = TRIANGLE


@pytest.mark.parametrize("kind", [np.uint8, np.int32, np.uint64, np.float32, list])
def test_index_types(kind):
    faces = icosphere(0).faces
    given = faces.tolist() if kind is list else faces.astype(kind)
    assert (
        TriangleMesh(icosphere(0).vertices.astype(np.float32), given).faces.tolist()
        == faces.tolist()
    )


def test_normalized_keeps_everything_but_the_size():
    vertices, faces = side_by_side(square(4), tetrahedron())
    mesh = TriangleMesh(vertices, faces, largest_component=True, messages=["read from a file"])
    unit = mesh.normalized()
    assert unit is mesh.normalized()
    np.testing.assert_allclose(unit.vertices * mesh.length_scale, mesh.vertices, rtol=1e-14)
    corners = unit.vertices[unit.faces]
    area = (
        0.5
        * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        ).sum()
    )
    assert area == pytest.approx(1, rel=1e-14)
    assert unit.length_scale == 1
    for name in (
        "faces",
        "vertex_ids",
        "face_ids",
        "messages",
        "file_vertex_count",
        "edges",
        "face_edges",
    ):
        assert getattr(unit, name) is getattr(mesh, name)
    assert unit.cache == {}
    assert mesh.messages[0] == "read from a file"
    with pytest.raises(ValueError, match="read-only"):
        unit.vertices[0] = 0


@given(power=st.integers(-55, 55))
def test_acceptance_does_not_depend_on_the_unit(power):
    """A needle of aspect 1e-9 is accepted, one of 1e-13 is refused, in any unit of length."""
    for height, usable in ((1e-9, True), (1e-13, False)):
        vertices = TRIANGLE * [1, height, 1] * 10.0**power
        if usable:
            assert TriangleMesh(vertices, [[0, 1, 2]]).messages == ()
        else:
            with pytest.raises(MeshError, match="no area"):
                TriangleMesh(vertices, [[0, 1, 2]])


@given(power=st.integers(-12, 12), seed=st.integers(0, 2**32 - 1))
def test_what_is_flat_depends_on_neither_unit_nor_direction(power, seed):
    """Heights of 1e-11 and 1e-13 of the longest edge, on either side of the bound, with a short
    edge or without.
    """
    random = np.random.default_rng(seed)
    frame, _ = np.linalg.qr(random.normal(size=(3, 3)))
    for height, usable in ((1e-11, True), (1e-13, False)):
        for place in (0.3, 1.0 + 1e-5):
            triangle = np.array([[0.0, 0, 0], [1, 0, 0], [place, height, 0]]) * 10.0**power
            assert flat_faces(triangle @ frame, np.array([[0, 1, 2]])).tolist() == [not usable]


@given(power=st.integers(-12, 12), reach=st.floats(0, 1e6), seed=st.integers(0, 2**32 - 1))
def test_what_is_flat_does_not_depend_on_the_place_up_to_rounding(power, reach, seed):
    """A face with an edge of 1e-5 is no flat one as long as rounding leaves it its shape."""
    random = np.random.default_rng(seed)
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1e-5, 0]]) + reach * random.uniform(-1, 1, 3)
    assert not flat_faces(triangle * 10.0**power, np.array([[0, 1, 2]])).any()
    assert flat_faces(triangle * [1, 1e-14, 1] * 10.0**power, np.array([[0, 1, 2]])).all()


@pytest.mark.parametrize("power", [-12, -5, 0, 5, 12])
def test_a_mesh_far_away_is_used_with_a_warning(power):
    sphere = icosphere(2)
    near, far = (
        TriangleMesh((sphere.vertices + shift) * 10.0**power, sphere.faces) for shift in (1e6, 1e9)
    )
    assert near.messages == ()
    assert re.match(
        r"warning: the surface lies 5e\+08 times its width from the origin, .* by 1e-07 of",
        far.messages[0],
    )


def klein_bottle_faces(n):
    """Faces of a grid on the Klein bottle: sides are glued, one of them turned round."""
    index = [[i * n + j for j in range(n)] for i in range(n)]
    index = [[*row, row[0]] for row in index]
    index.append([index[0][(n - j) % n] for j in range(n + 1)])
    quads = [
        (index[i][j], index[i + 1][j], index[i + 1][j + 1], index[i][j + 1])
        for i in range(n)
        for j in range(n)
    ]
    return np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])


def test_a_klein_bottle_is_one_sided():
    faces = klein_bottle_faces(6)
    vertices = np.random.default_rng(0).normal(size=(36, 3))
    with pytest.raises(MeshError, match=r"not orientable.*72 of 72 faces"):
        TriangleMesh(vertices, faces)


def test_more_faces_than_pairs_of_vertices_allow_are_refused_before_edges_are_looked_for(
    monkeypatch,
):
    mesh = tetrahedron()
    monkeypatch.setattr("abfm.mesh.checks.edges_of_faces", None)
    with pytest.raises(
        MeshError, match="5 faces on 4 vertices have more sides than there are pairs"
    ):
        TriangleMesh(mesh.vertices, [*mesh.faces, [0, 1, 2]])


def test_the_smallest_surfaces():
    one, closed = TriangleMesh(TRIANGLE, [[0, 1, 2]]), tetrahedron()
    assert (one.is_closed, one.boundary_loop_count, one.genus) == (False, 1, 0)
    assert (closed.is_closed, closed.genus, len(closed.faces)) == (True, 0, 4)


def test_parts_that_touch_in_a_vertex_are_one_pinched_surface():
    first, second = tetrahedron(), tetrahedron()
    vertices = np.concatenate([first.vertices, second.vertices + 10])
    faces = np.concatenate([first.faces, np.where(second.faces == 0, 0, second.faces + 4)])
    mesh = TriangleMesh(vertices, faces)
    assert "1 vertex is pinched" in mesh.messages[-1]
    assert mesh.is_closed
