"""Checks of meshes, their error messages with examples and advice, and topology."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm.assets import asset_path
from abfm.errors import FunctionError, MeshError
from abfm.mesh import TriangleMesh, load_mesh
from abfm.mesh.face_sizes import flat_faces
from abfm.mesh.topology import edges_of_faces
from tests import shapes
from tests.messages import check_message, check_names, raises
from tests.shapes import disc, hemisphere, icosphere, open_cylinder, square, tetrahedron, torus

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
SHEET = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
SPHERE = icosphere(1)


def side_by_side(*meshes):
    """Return the vertices and faces of several meshes, placed next to each other along x."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    vertices = [mesh.vertices + np.array([10.0 * k, 0, 0]) for k, mesh in enumerate(meshes)]
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return np.concatenate(vertices), np.concatenate(faces)


def glued(first, second, vertices):
    """Return two meshes with a common vertex 0; the second one has the given vertices."""
    faces = np.where(second.faces == 0, 0, second.faces + len(first.vertices) - 1)
    return np.concatenate([first.vertices, vertices[1:]]), np.concatenate([first.faces, faces])


def with_vertex(vertex, row):
    vertices = SPHERE.vertices.copy()
    vertices[vertex] = row
    return vertices, SPHERE.faces


def with_faces(*rows):
    return SPHERE.vertices, np.concatenate([SPHERE.faces, rows])


def klein_bottle(n):
    """Return a grid on the Klein bottle at random positions; one pair of sides is reversed."""
    index = [[*range(i * n, i * n + n), i * n] for i in range(n)]
    index.append([index[0][(n - j) % n] for j in range(n + 1)])
    index = np.array(index)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    return np.random.default_rng(0).normal(size=(n * n, 3)), faces


ONE_FACE = [[0, 1, 2]]
REFUSED = {
    "no vertices": (np.zeros((0, 3)), np.zeros((0, 3), int), ()),
    "no faces": (TRIANGLE, np.zeros((0, 3), int), ()),
    "flat vertices": (TRIANGLE[:, :2], ONE_FACE, ("(3, 2)", "(V, 3)")),
    "ragged vertices": ([[0, 0, 0], [1, 0]], ONE_FACE, ()),
    "words as vertices": ([["a", "b", "c"]] * 3, ONE_FACE, ("<U1",)),
    "complex vertices": (TRIANGLE * 1j, ONE_FACE, ("complex128",)),
    "quads": (SHEET, [[0, 1, 3, 2]], ("(1, 4)",)),
    "ragged faces": (SHEET, [[0, 1, 2], [0, 1, 2, 3]], ()),
    "truth values as faces": (TRIANGLE, [[False, True, True]], ("bool",)),
    "fractional index": (*(SHEET, [[0, 1, 3], [0, 2, 1.5]]), (1, "[0.0, 2.0, 1.5]")),
    "nan index": (TRIANGLE, [[0, 1, np.nan]], ()),
    "infinite index": (TRIANGLE, [[0, 1, np.inf]], ("inf", 3)),
    "index too large": (*(TRIANGLE, [[0, 1, 2], [1, 2, 3]]), (1, 3, 0)),
    "indices from 1": (SPHERE.vertices, SPHERE.faces + 1, ("subtract 1",)),
    "negative index": (TRIANGLE, [[0, 1, -1]], (-1, 3)),
    "nan": (*with_vertex(7, np.nan), (7, "[nan, nan, nan]")),
    "infinity": (*with_vertex(0, [0, np.inf, 0]), (0, "[0.0, inf, 0.0]")),
    "overflow": (*with_vertex(3, [1e200, 0, 0]), ("1e+200", 3)),
    "underflow": (SPHERE.vertices * 1e-90, SPHERE.faces, ("2e-90",)),
    "vertex used twice": (*with_faces([3, 4, 3], [9, 9, 9]), (2, 80, 3, 4)),
    "line": ([[0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]], ONE_FACE, (1,)),
    "point": (np.ones((3, 3)), ONE_FACE, ()),
    "line far away": (TRIANGLE * [1, 1e-12, 1] + 1e6, ONE_FACE, ()),
    "same face": (*with_faces(SPHERE.faces[5]), (1, 5, 80)),
    "same face flipped": (*(SHEET, [[0, 1, 2], [3, 2, 1], [1, 0, 2]]), (0, 2, 1)),
    "edge with three faces": (
        *(np.vstack([SHEET, [[0, 0, 1]]]), [[0, 1, 2], [1, 3, 2], [2, 1, 4]]),
        (1, 2, 0),
    ),
    "Moebius strip": (*shapes.moebius_arrays(20), (40,)),
    "Klein bottle": (*klein_bottle(6), (72,)),
    "two spheres": (
        *side_by_side(icosphere(0), SPHERE),
        (2, 80, 100, 0, "--largest-component", "largest_component=True"),
    ),
    "separate faces at equal positions": (
        *(icosphere(0).vertices[icosphere(0).faces].reshape(-1, 3), np.arange(60).reshape(-1, 3)),
        (20, 1, 12, 60, "--merge", "merge=True"),
    ),
}


@pytest.mark.parametrize(("vertices", "faces", "named"), REFUSED.values(), ids=REFUSED)
def test_invalid_mesh_is_refused(vertices, faces, named):
    with raises(MeshError, *named) as caught:
        TriangleMesh(vertices, faces)
    assert "\n" not in str(caught.value)
    assert re.search(r"; expected|\. [A-Z]", str(caught.value))  # an expectation or an advice
    for remedy in caught.value.remedies:
        kept = TriangleMesh(vertices, faces, **remedy.options)
        check_names(remedy.keeps, len(kept.vertices), len(kept.faces))


def test_errors_use_numbers_of_the_input():
    vertices, faces = side_by_side(tetrahedron(), icosphere(1, radius=3))
    faces = np.concatenate([faces, [[9, 9, 9]]]) + 2
    vertices = np.concatenate([np.zeros((2, 3)), vertices])
    with raises(MeshError, 84, 0, 11):
        TriangleMesh(vertices, faces, largest_component=True)


def test_largest_component_has_largest_area():
    many_small_faces = TriangleMesh(icosphere(2).vertices * 0.1, icosphere(2).faces)
    vertices, faces = side_by_side(many_small_faces, icosphere(0), tetrahedron())
    mesh = TriangleMesh(vertices, faces, largest_component=True)
    assert mesh.vertices.tolist() == vertices[-4:].tolist()
    assert mesh.vertex_ids.tolist() == [174, 175, 176, 177]
    assert mesh.face_ids.tolist() == [340, 341, 342, 343]
    (message,) = mesh.messages
    check_message(message, 3, 4, 178, 344)


def test_unused_vertices_are_dropped():
    unused = [[np.nan, 0, 0], [1e300, 0, 0], [7, 7, 7]]
    kept = np.delete(np.arange(45), [0, 6, 44])
    mesh = TriangleMesh(np.insert(SPHERE.vertices, [0, 5, 42], unused, axis=0), kept[SPHERE.faces])
    assert mesh.vertices.tolist() == SPHERE.vertices.tolist()
    assert mesh.faces.tolist() == SPHERE.faces.tolist()
    assert mesh.vertex_ids.tolist() == kept.tolist()
    assert mesh.file_vertex_count == 45
    (message,) = mesh.messages
    check_message(message, 3, 0)


def test_vertices_are_numbered_as_in_the_file():
    mesh = shapes.with_loose_vertex(SPHERE)
    assert [mesh.local_vertex(index) for index in (0, 4, 6, 42)] == [0, 4, 5, 41]
    with raises(FunctionError, 5):
        mesh.local_vertex(5)
    for outside in (-1, 43):
        with raises(FunctionError, outside, 43, 0, 42):
            mesh.local_vertex(outside)
    assert mesh.restrict(np.arange(43)).tolist() == [*range(5), *range(6, 43)]
    assert mesh.restrict(np.ones((43, 2))).shape == (42, 2)
    assert mesh.restrict(np.arange(42)).tolist() == list(range(42))
    with raises(FunctionError, 7, 43, 42):
        mesh.restrict(np.ones(7))
    with raises(FunctionError, 7, 42):
        SPHERE.restrict(np.ones(7))


def test_pinched_vertices_are_reported():
    """Two discs, tetrahedra or tori with a common vertex form one surface, with a message."""
    mesh = TriangleMesh(*glued(disc(2), disc(2), disc(2).vertices - [0, 0, 1]))
    check_message(mesh.messages[0], 1, 0)
    assert len(mesh.boundary_loops) == 2
    assert mesh.genus == 0
    mesh = TriangleMesh(*glued(tetrahedron(), tetrahedron(), tetrahedron().vertices + 10))
    check_message(mesh.messages[-1], 1)
    assert mesh.is_closed
    one = torus(6, 5)
    assert TriangleMesh(*glued(one, one, one.vertices + np.array([0, 0, 3]))).genus == 2


def test_arrays_are_copied_and_read_only():
    vertices, faces = TRIANGLE.copy(), np.array(ONE_FACE)
    mesh = TriangleMesh(vertices, faces)
    vertices[:], faces[:] = 0, 0
    assert mesh.vertices.tolist() == TRIANGLE.tolist()
    assert mesh.faces.tolist() == ONE_FACE
    names = ("vertices", "faces", "vertex_ids", "edges", "face_edges", "edge_faces")
    for name in (*names, "is_boundary_vertex"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(mesh, name)[0] = 0
    with pytest.raises(AttributeError, match="setting vertices"):
        mesh.vertices = TRIANGLE


@pytest.mark.parametrize("kind", [np.uint8, np.int32, np.uint64, np.float32, list])
def test_faces_may_have_any_integer_type(kind):
    faces = SPHERE.faces.tolist() if kind is list else SPHERE.faces.astype(kind)
    mesh = TriangleMesh(SPHERE.vertices.astype(np.float32), faces)
    assert mesh.faces.tolist() == SPHERE.faces.tolist()


def test_normalized_mesh_differs_only_in_scale():
    vertices, faces = side_by_side(square(4), tetrahedron())
    mesh = TriangleMesh(vertices, faces, largest_component=True, messages=["read from a file"])
    unit = mesh.normalized()
    assert unit is mesh.normalized()
    np.testing.assert_allclose(unit.vertices * mesh.length_scale, mesh.vertices, rtol=1e-14)
    a, b, c = np.moveaxis(unit.vertices[unit.faces], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert area == pytest.approx(1, rel=1e-14)
    assert unit.length_scale == 1
    names = ("faces", "vertex_ids", "face_ids", "messages", "file_vertex_count")
    for name in (*names, "edges", "face_edges"):
        assert getattr(unit, name) is getattr(mesh, name)
    assert unit.cache == {}
    check_message(mesh.messages[0])
    with pytest.raises(ValueError, match="read-only"):
        unit.vertices[0] = 0


@given(power=st.integers(-55, 55))
def test_sliver_check_is_scale_invariant(power):
    sliver, flat = (TRIANGLE * [1, height, 1] * 10.0**power for height in (1e-9, 1e-13))
    assert TriangleMesh(sliver, ONE_FACE).messages == ()
    with raises(MeshError):
        TriangleMesh(flat, ONE_FACE)


@given(power=st.integers(-12, 12), seed=st.integers(0, 2**32 - 1))
def test_flat_faces_are_scale_and_rotation_invariant(power, seed):
    """A face with a height of 1e-11 times its longest edge is usable; with 1e-13 it is flat."""
    frame, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    for height, usable in ((1e-11, True), (1e-13, False)):
        for place in (0.3, 1.0 + 1e-5):
            triangle = np.array([[0.0, 0, 0], [1, 0, 0], [place, height, 0]]) * 10.0**power
            assert flat_faces(triangle @ frame, np.array(ONE_FACE)).tolist() == [not usable]


@given(power=st.integers(-12, 12), reach=st.floats(0, 1e6), seed=st.integers(0, 2**32 - 1))
def test_flat_faces_are_translation_invariant(power, reach, seed):
    """A face with an edge of 1e-5 is not flat at offsets of up to 1e6 times its longest edge."""
    random = np.random.default_rng(seed)
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1e-5, 0]]) + reach * random.uniform(-1, 1, 3)
    assert not flat_faces(triangle * 10.0**power, np.array(ONE_FACE)).any()
    assert flat_faces(triangle * [1, 1e-14, 1] * 10.0**power, np.array(ONE_FACE)).all()


@pytest.mark.parametrize("power", [-12, -5, 0, 5, 12])
def test_large_offset_causes_a_warning(power):
    vertices, faces = icosphere(2).vertices, icosphere(2).faces
    near, far = (TriangleMesh((vertices + shift) * 10.0**power, faces) for shift in (1e6, 1e9))
    assert near.messages == ()
    warning = r"warning: the surface lies 5e\+08 times its width from the origin. .* by 1e-07 of"
    assert re.match(warning, far.messages[0])


def test_too_many_faces_are_refused_early(monkeypatch):
    mesh = tetrahedron()
    monkeypatch.setattr("abfm.mesh.checks.edges_of_faces", None)
    monkeypatch.setattr("abfm.mesh.checks.FACES_MAX", 0)
    with raises(MeshError, 5, 4):
        TriangleMesh(mesh.vertices, [*mesh.faces, [0, 1, 2]])


def flipped(faces, which):
    return np.where(np.asarray(which)[:, None], faces[:, ::-1], faces)


def same_up_to_rotation(faces, others):
    pairs = zip(faces, others, strict=True)
    return all(any(np.array_equal(np.roll(a, k), b) for k in range(3)) for a, b in pairs)


def volume(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return np.einsum("fx,fx->", a, np.cross(b, c)) / 6


def drawn_flips(data, shape):
    count = len(shape.faces)
    return np.array(data.draw(st.lists(st.booleans(), min_size=count, max_size=count)))


@pytest.mark.parametrize("shape", [SPHERE, torus(6, 5)], ids=str)
@given(data=st.data())
def test_closed_surfaces_become_outward(shape, data):
    flips = drawn_flips(data, shape)
    mesh = TriangleMesh(shape.vertices, flipped(shape.faces, flips))
    if all(flips):
        assert mesh.messages == ()
        assert same_up_to_rotation(mesh.faces, shape.faces[:, ::-1])
    else:
        assert same_up_to_rotation(mesh.faces, shape.faces)
        assert len(mesh.messages) == any(flips)


@pytest.mark.parametrize("shape", [disc(3), square(4), open_cylinder(6, 3)], ids=str)
@given(data=st.data())
def test_open_surfaces_keep_the_majority_orientation(shape, data):
    flips = drawn_flips(data, shape)
    mesh = TriangleMesh(shape.vertices, flipped(shape.faces, flips))
    count = flips.sum()
    if 2 * count != len(flips):
        majority = shape.faces if 2 * count < len(flips) else shape.faces[:, ::-1]
        assert same_up_to_rotation(mesh.faces, majority)
        count = min(count, len(flips) - count)
    assert len(mesh.messages) == (count > 0)
    assert all(message.startswith(f"{count} face") for message in mesh.messages)


def test_consistent_inward_faces_are_kept():
    mesh = TriangleMesh(SPHERE.vertices, SPHERE.faces[:, ::-1])
    assert mesh.messages == ()
    assert volume(mesh) < 0
    mesh = TriangleMesh(SPHERE.vertices + 100, flipped(SPHERE.faces, np.arange(80) != 3))
    (message,) = mesh.messages
    check_message(message, 79, 0)
    assert volume(mesh) > 0


def test_pinched_pieces_are_oriented_separately():
    """A sphere pinched to a disc becomes outward, and the disc keeps its majority."""
    flat = disc(2)
    vertices, faces = glued(SPHERE, flat, flat.vertices - flat.vertices[0] + SPHERE.vertices[0])
    which = np.concatenate([np.arange(80) > 2, np.arange(24) == 5])
    mesh = TriangleMesh(vertices, flipped(faces, which))
    assert same_up_to_rotation(mesh.faces, faces)
    check_message(mesh.messages[0], 78)
    assert "pinched" in mesh.messages[1]


@given(flips=st.lists(st.booleans(), min_size=30, max_size=30))
def test_moebius_strip_is_refused_for_any_orientation(flips):
    vertices, faces = shapes.moebius_arrays(15)
    with raises(MeshError):
        TriangleMesh(vertices, flipped(faces, flips))


def test_inside_out_is_detected():
    for mesh in (icosphere(2), torus(12, 8), open_cylinder(12, 4)):
        vertices = mesh.vertices + np.array([7.0, -3.0, 2.0])
        sides = [TriangleMesh(vertices, faces) for faces in (mesh.faces, mesh.faces[:, ::-1])]
        assert sides[0].is_inside_out != sides[1].is_inside_out
    assert not icosphere(2).is_inside_out
    for mesh in (disc(3), square(4)):
        assert not mesh.is_inside_out
        assert not TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]).is_inside_out


SHAPES = {  # mesh, genus, boundary loops, boundary edges
    "sphere": (icosphere(2), 0, 0, 0),
    "ellipsoid": (shapes.ellipsoid(1, 1, 2, 3), 0, 0, 0),
    "tetrahedron": (tetrahedron(), 0, 0, 0),
    "torus": (torus(7, 5), 1, 0, 0),
    "square": (square(5), 0, 1, 20),
    "disc": (disc(3), 0, 1, 18),
    "hemisphere": (hemisphere(4), 0, 1, 24),
    "cylinder": (open_cylinder(9, 4), 0, 2, 18),
    "triangle": (TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), 0, 1, 3),
    "eight": (load_mesh(asset_path("eight.off")), 2, 0, 0),
    "human": (load_mesh(asset_path("human_A.off")), 0, 0, 0),
    "fandisk": (load_mesh(asset_path("fandisk.off")), 0, 0, 0),
}


@pytest.mark.parametrize(("mesh", "genus", "loops", "edges"), SHAPES.values(), ids=SHAPES)
def test_genus_and_boundary_of_shapes_are_known(mesh, genus, loops, edges):
    assert mesh.messages == ()
    assert mesh.genus == genus
    assert len(mesh.boundary_loops) == loops
    assert mesh.is_boundary_edge.sum() == mesh.is_boundary_vertex.sum() == edges
    assert mesh.is_closed == (edges == 0)
    assert mesh.euler_characteristic == 2 - 2 * genus - loops


SMALL_MESHES = [mesh for mesh, *_ in SHAPES.values() if mesh.file_vertex_count < 500]


@pytest.mark.parametrize("mesh", SMALL_MESHES, ids=str)
def test_edges_match_corners_and_faces(mesh):
    # with so large vertex numbers, keys of edges need another sort
    found, opposite = edges_of_faces(mesh.faces, 2**31)
    np.testing.assert_array_equal(found, mesh.edges)
    np.testing.assert_array_equal(opposite, mesh.face_edges)
    assert np.all(mesh.edges[:, 0] < mesh.edges[:, 1])
    for corner in range(3):
        others = np.sort(np.delete(mesh.faces, corner, axis=1), axis=1)
        np.testing.assert_array_equal(others, mesh.edges[mesh.face_edges[:, corner]])
    for edge, faces in enumerate(mesh.edge_faces):
        owners = np.flatnonzero((mesh.face_edges == edge).any(axis=1)).tolist()
        assert faces.tolist() == [*owners, -1][:2]


def test_area_of_shapes_converges():
    assert square(7).length_scale == pytest.approx(1, rel=1e-14)
    errors = [abs(hemisphere(n).length_scale ** 2 / (2 * np.pi) - 1) for n in (8, 16)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
    errors = [abs(torus(2 * n, n).length_scale ** 2 / (4 * np.pi**2 * 0.4) - 1) for n in (16, 32)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
